"""How passages show in the frames of their stay: S/N, length and light of each trail."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from simulator.scene.reflection import LightCurve
from simulator.survey.flight import Flight, Instants
from simulator.survey.passages import Passages, light_of

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FRAMES_EACH: Final = 24
"""Most frames of its stay in which a passage is looked at. They are spread evenly; each then stands for several."""

CURVE_SPREAD: Final = 1.0  # of the logarithm of the period about 2 s, as `scene.sources: light_curves` draws it (assumed)


@dataclass(frozen=True, kw_only=True, eq=False)
class Looks:
    """Frames in which passages leave light (k,): whose, S/N, length, V of the mean light of the trail, how much of a frame's

    noise, and how many frames of the stay this one stands for. open_s : of the exposure after the epoch. cut : by the field's
    edge. frames (n,) : of each passage's stay.
    """

    passage: Indices
    snr: Array
    length_px: Array
    mag: Array
    noise_e: Array
    stands_for: Array
    open_s: Array
    cut: NDArray[np.bool_]
    frames: Indices


def looks_of(
    flight: Flight,
    at: Instants,
    p: Passages,
    rng: np.random.Generator,
    only: tuple[int | Indices, int | Indices] | None = None,
    *,
    turns: bool = True,
) -> Looks:
    """How passages show in the frames of their stay, or in those from one to another; rng : for how they turn, if they do."""
    window, camera, period = flight.window, flight.camera, 1.0 / flight.options.frame_rate_hz
    exposure, base = camera.exposure_s, at.time_s[p.instant]
    place, moves = at.in_camera(p.instant, p.position_km, p.velocity_km_s)
    shift = 1e-6 * flight.carrier.shutter.line_time_us * 0.5 * (camera.shape[0] - 1)
    first = np.ceil((base + p.enter_s - exposure - shift) / period).astype(np.int64)
    last = np.floor((base + p.leave_s - shift) / period).astype(np.int64)
    if only is not None:
        first, last = np.maximum(first, only[0]), np.minimum(last, only[1])
    frames = np.maximum(last - first + 1, 0)
    shown = np.minimum(frames, FRAMES_EACH)
    whose = np.repeat(np.arange(len(frames)), shown)
    within = np.arange(len(whose)) - np.repeat(np.cumsum(shown) - shown, shown)
    number = first[whose] + np.floor((within + 0.5) * frames[whose] / shown[whose]).astype(np.int64)
    open_s = number * period
    begin = np.maximum(open_s + shift - base[whose], p.enter_s[whose])
    end = np.minimum(open_s + shift + exposure - base[whose], p.leave_s[whose])
    lit = np.maximum(end - begin, 0.0)
    middle = 0.5 * (begin + end)
    there = place[whose] + moves[whose] * middle[:, None]
    distance = np.linalg.norm(there, axis=1)
    across = moves[whose] - np.sum(moves[whose] * there, axis=1, keepdims=True) * there / distance[:, None] ** 2
    rate = np.linalg.norm(across, axis=1) / distance
    row, col = camera.projection.to_pixels(there)
    flux = light_of(flight, at, p.instant, p.size_m, p.surfaces, p.position_km)[whose] * (p.range_km[whose] / distance) ** 2
    if turns:
        flux *= turning(flight, len(p.size_m), whose, base[whose] + begin, base[whose] + np.maximum(end, begin + 1e-6), rng)
    lit_share = np.nan_to_num(camera.illumination_at(row, col), nan=0.0)
    noise_e2 = at.noise_e2[p.instant][whose] - (1.0 - lit_share) * at.sky_e[p.instant][whose]
    length_px = rate * lit * window.focal_px
    share = flight.energy.of(length_px, row, col, camera.defocus_px(distance)) * at.star_share[p.instant][whose]
    snr = flux * lit_share * window.flux_e_s * lit * np.sqrt(share / noise_e2)
    with np.errstate(divide="ignore"):
        mag = -2.5 * np.log10(flux)
    return Looks(
        passage=whose, snr=np.where(lit > 0.0, snr, 0.0), length_px=length_px, mag=mag,
        noise_e=np.sqrt(noise_e2), stands_for=frames[whose] / shown[whose], open_s=open_s, cut=lit < exposure * (1.0 - 1e-9),
        frames=frames,
    )  # fmt: skip


def turning(flight: Flight, n: int, whose: Indices, begin_s: Array, end_s: Array, rng: np.random.Generator) -> Array:
    """Light (k,) over the mean of pieces (n,) that turn, between pairs of times: as `scene.sources: light_curves` draws them."""
    options = flight.options.population
    surface = options.surface
    tumbles = rng.random(n) < options.tumbling_share
    period, amplitude = rng.lognormal(np.log(2.0), CURVE_SPREAD, n), rng.uniform(0.1, 0.7, n)
    phase, faces, flashes = rng.uniform(0.0, 2.0 * np.pi, n), rng.random((n, 3)), rng.random(n) < surface.glint_share
    peak = surface.glint_factor * np.exp(0.7 * rng.standard_normal(n))
    faceted = faces[:, 0] < surface.facet_share
    out = np.ones(len(whose))
    turns = np.flatnonzero(tumbles[whose])
    if not turns.size:
        return out
    mine = whose[turns]
    columns: dict[str, Any] = {
        "period_s": period[mine],
        "amplitude": amplitude[mine],
        "phase_rad": phase[mine],
        "facets": np.where(faceted, 0.5 + 0.5 * faces[:, 1], 0.0)[mine],
        "facet_phase_rad": 2.0 * np.pi * faces[mine, 2],
        "glint_factor": np.where(flashes, peak, 0.0)[mine],
        "glint_width_s": (period * surface.glint_turn_deg / 360.0)[mine],
    }
    out[turns] = LightCurve(**columns).mean_factor(begin_s[turns], end_s[turns])
    return out
