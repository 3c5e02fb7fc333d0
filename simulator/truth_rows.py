"""What really was in a frame, as rows of the truth tables: the frame itself, its stars and particle tracks, and
the objects of a run."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sboc_e2e import truth
from simulator.camera import Camera
from simulator.platform.carrier import Carrier
from simulator.platform.line_of_sight import LineOfSight
from simulator.platform.rotation import quaternion_of
from simulator.radiation.hits import HitList
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.objects import PixelPathObject, SkyObject
from simulator.scene.star_image import StarPlaces
from simulator.scene.stars import StarField, angles_deg

Array = NDArray[np.float64]

STAR_TRUTH_SNR = 5.0
"""Stars above this matched-filter S/N are in the truth table; the fainter ones are in the image only."""
GRID_SAMPLES = 50
"""Instants of the exposure over which the truth grid's directions are averaged."""
GRID_SIDE = 9
"""Points of the truth grid along each side of a frame."""


def frame_row(
    camera: Camera, carrier: Carrier, sight: LineOfSight, air: Atmosphere | None, sky_e: float, frame: int
) -> NDArray[np.void]:
    """The row (1,) of the truth of frames; sky_e : mean sky in electrons per detector pixel.

    The grid holds apparent directions of GRID_SIDE x GRID_SIDE delivered pixels, each averaged over the exposure of its row.
    """
    timing = carrier.timing(frame, delivered=True)
    position, velocity = (v[0] for v in sight.observer_at(np.array([sight.reference_s])))
    delivered, pixels = camera.sensor.delivered, camera.binning.rows * camera.binning.cols
    row, col = np.meshgrid(*(np.linspace(0, n - 1.0, GRID_SIDE) for n in (delivered.rows, delivered.cols)), indexing="ij")
    row, col = row.ravel(), col.ravel()
    opened_s = (timing.t_start_tai_ns - carrier.epoch_tai_ns + timing.line_time_ns * row) * 1e-9
    # A star's image is the mean over the exposure, and so is what a frame solution can know of the jitter.
    shares = (np.arange(GRID_SAMPLES) + 0.5) / GRID_SAMPLES
    times_s = (opened_s[:, None] + shares * camera.exposure_s).ravel()
    vectors = np.repeat(camera.projection.to_vectors(*camera.undelivered(row, col)), GRID_SAMPLES, axis=0)
    seen = sight.to_gcrs(times_s, vectors).reshape(len(row), GRID_SAMPLES, 3).mean(axis=1)
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    ra, dec = angles_deg(seen if air is None else air.unrefracted(seen))
    values = {
        "frame": frame,
        "t_start_true_tai_ns": timing.t_start_tai_ns,
        "t_start_clock_tai_ns": timing.clock_tai_ns,
        "exposure_ns": timing.exposure_ns,
        "line_time_ns": timing.line_time_ns,
        "q_true": quaternion_of(sight.reference),
        "position_m": position * 1e3,
        "velocity_m_s": velocity * 1e3,
        "grid_row": row,
        "grid_col": col,
        "grid_ra_app_deg": ra,
        "grid_dec_app_deg": dec,
        "sky_e_px": sky_e * pixels,
        "noise_e": np.sqrt(float(camera.sensor.variance_e2(sky_e, camera.exposure_s)) * pixels),
        "zero_point_mag": 2.5 * np.log10(camera.zero_point_e_s),
    }
    out = truth.empty("frames", 1)
    for name, value in values.items():
        out[name] = value
    return out


def star_rows(
    camera: Camera, field: StarField, places: StarPlaces, flux_e: Array, sigma_px: Array, level_e: float, frame: int
) -> NDArray[np.void]:
    """Stars inside the frame and above `STAR_TRUTH_SNR` on a background of `level_e` electrons per pixel.

    flux_e, sigma_px : (n,) electrons and PSF sigma of each of `places`.
    """
    row, col = places.row.mean(axis=0), places.col.mean(axis=0)
    noise_e = np.sqrt(float(camera.sensor.variance_e2(level_e, camera.exposure_s)))
    length = np.hypot(np.ptp(places.row, axis=0), np.ptp(places.col, axis=0))
    width = 2.0 * np.sqrt(np.pi) * sigma_px
    known = flux_e > STAR_TRUTH_SNR * noise_e * np.sqrt(width * (width + length))
    known &= (row > -0.5) & (row < camera.shape[0] - 0.5) & (col > -0.5) & (col < camera.shape[1] - 0.5)
    out = truth.empty("stars", int(known.sum()))
    chosen = places.index[known]
    out["frame"], out["star_id"], out["flux_e"] = frame, field.star_id[chosen], flux_e[known]
    out["row"], out["col"] = camera.delivered(row[known], col[known])
    out["v_mag"], out["b_v"] = field.v_mag[chosen], field.b_v[chosen]
    return out


def cosmic_rows(camera: Camera, hits: HitList, frame: int) -> NDArray[np.void]:
    """Particle tracks whose middle lies inside the frame, in delivered pixels."""
    window, shape = camera.sensor.options.window, camera.shape
    tracks = hits.tracks
    middle_row = 0.5 * (tracks["row0"] + tracks["row1"]) - window.row0
    middle_col = 0.5 * (tracks["col0"] + tracks["col1"]) - window.col0
    inside = (middle_row > -1.0) & (middle_row < shape[0]) & (middle_col > -1.0) & (middle_col < shape[1])
    tracks = tracks[inside]
    out = truth.empty("cosmics", len(tracks))
    out["frame"], out["charge_e"] = frame, tracks["charge_e"]
    for end in ("0", "1"):
        row, col = camera.delivered(tracks[f"row{end}"] - window.row0, tracks[f"col{end}"] - window.col0)
        out[f"row{end}"], out[f"col{end}"] = row, col
    return out


def object_rows(
    objects: Sequence[SkyObject | PixelPathObject], n_frames: int, seen_km: Callable[[int, list[int]], dict[int, float]]
) -> NDArray[np.void]:
    """Truth (n,) of all objects, with the range at which each is first seen; NaN for those that no frame shows.

    seen_km : range of those of the given objects (numbers) that a frame shows.
    """
    out = truth.empty("objects", len(objects))
    for k, thing in enumerate(objects):
        out[k]["object_id"], out[k]["range_km"] = k, np.nan
        for name in ("name", "kind", "size_m", "albedo", "a_km", "e", "i_deg", "weight"):
            out[k][name] = getattr(thing.identity, name)
    waiting = set(range(len(out)))
    for index in range(n_frames):
        if not waiting:
            break
        for k, distance_km in seen_km(index, sorted(waiting)).items():
            out[k]["range_km"] = distance_km
            waiting.discard(k)
    return out
