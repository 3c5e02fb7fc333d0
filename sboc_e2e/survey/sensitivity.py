"""What a survey would count with another camera, orbit or pointing: expected tracklets a day, one key at a time.

The response is taken over S/N and length in pixels, so that a change acts through light, noise, scale and motion; that another
camera's software finds as much at equal S/N and length is an assumption, and the page says so.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e import scenario as scenarios
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.survey.curve import HALF, found_share, shifts
from sboc_e2e.survey.response import Response
from simulator.platform.earth import DAY_S
from simulator.randomness import Effect, generator
from simulator.survey.candidates import candidates, pool_of
from simulator.survey.flight import Flight, instants_of
from simulator.survey.looks import looks_of

Array = NDArray[np.float64]

CANDIDATES: Final = 150_000
"""Draws of each class; the scatter that they leave is stated beside every value (`Setting.error`). More cost time."""
INSTANTS: Final = 240
"""Times of a year at which the field is looked at. Chosen, not measured: two in three days, at random hours."""
SENSITIVITY_BLOCK: Final = 9_000_000
"""Number of a random stream that no survey reaches: its blocks are quarters of a day, 1.5 million in 1,000 years."""
GROUPS: Final = ((0.001, 0.01), (0.01, 0.1), (0.1, 3.0))
"""Diameters (m) of the pieces that are counted apart."""

VARIED: Final[tuple[tuple[str, str, tuple[str, ...]], ...]] = (
    ("aperture", "instrument.aperture", ("0.10 m", "0.15 m", "0.20 m", "0.30 m")),
    ("exposure", "shutter.exposure", ("0.05 s", "0.1 s", "0.2 s")),
    ("frame rate", "frame_rate", ("1 Hz", "2 Hz", "4 Hz")),
    ("local time of the node", "platform.ltan", ("6 h", "12 h", "18 h")),
    ("altitude", "platform.altitude", ("500 km", "600 km", "700 km", "850 km")),
)
"""Keys that any camera has; pointing, threshold and losses have ways of their own."""

POINTINGS: Final[tuple[tuple[str, tuple[str, ...]], ...]] = (
    ("anti-Sun", ("pointing.law=anti_sun",)),
    ("zenith", ("pointing.law=nadir",)),
    ("along the orbit", ("pointing.law=nadir", "pointing.tilt=110 deg", "pointing.azimuth=0 deg")),
    ("across the orbit", ("pointing.law=nadir", "pointing.tilt=110 deg", "pointing.azimuth=90 deg")),
)
THRESHOLDS: Final = (-1.0, 0.0, 1.0, 2.0)
"""Shifts of the half point in S/N."""

LOSSES: Final = (0.0, 0.1, 0.3, 0.5)
"""Shares of frames or packets that never arrive."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Tracklets a day by group of diameters, with the scatter of the draw; watched : share of the time; refused : why not."""

    key: str
    value: str
    per_day: tuple[float, ...] = ()
    error: tuple[float, ...] = ()
    watched: float = 0.0
    refused: str = ""


def expected_per_day(
    flight: Flight, response: Response, days: float, *, threshold_shift: float = 0.0, lost: float = 0.0
) -> tuple[Array, Array, float]:
    """Tracklets a day by `GROUPS`, one sigma of the draw, and the share of the time that is watched."""
    rng = generator(flight.seed, Effect.SURVEY, SENSITIVITY_BLOCK)
    at = instants_of(flight, np.sort(rng.random(INSTANTS)) * days * DAY_S, DAY_S)
    total, variance = np.zeros(len(GROUPS)), np.zeros(len(GROUPS))
    curve = response.curve.copy()
    curve[HALF] += threshold_shift
    shallow = replace(flight.options.population, snr_min=max(1.0, flight.options.population.snr_min + min(threshold_shift, 0.0)))
    flight = replace(flight, options=replace(flight.options, population=shallow))
    for k, size_class in enumerate(flight.options.population.classes):
        if size_class.count == 0:
            continue
        rng = generator(flight.seed, Effect.SURVEY, SENSITIVITY_BLOCK, k + 1)
        p = candidates(flight, at, pool_of(flight, size_class, rng), CANDIDATES, rng)
        p = p.taken(np.flatnonzero(p.snr >= flight.options.population.snr_min))
        looks = looks_of(flight, at, p, rng)
        n = len(p.size_m)
        noise, shift = response.noise_ratio(looks.noise_e), shifts(curve, n, rng)[looks.passage]
        share = found_share(curve, looks.snr, looks.length_px, noise, looks.cut, shift) * (1.0 - lost)
        share = np.clip(np.where(looks.snr > 0.0, share, 0.0), 0.0, 1.0 - 1e-9)
        none = np.exp(np.bincount(looks.passage, weights=looks.stands_for * np.log1p(-share), minlength=n))
        odds = np.bincount(looks.passage, weights=looks.stands_for * share / (1.0 - share), minlength=n)
        twice = np.clip(1.0 - none - none * odds, 0.0, 1.0)
        mean = np.bincount(looks.passage, weights=looks.stands_for * share, minlength=n)
        each = p.natural * twice * response.linked_share(np.maximum(np.round(mean), 2.0).astype(np.int64))
        for g, (low, high) in enumerate(GROUPS):
            inside = (p.size_m >= low) & (p.size_m < high)
            total[g] += each[inside].sum()
            variance[g] += (each[inside] ** 2).sum()
    return total, np.sqrt(variance), float(at.watched.mean())


def sensitivity(
    name: str, overrides: Sequence[str], registry: Registry, response: Response, days: float, seed: int
) -> list[Setting]:
    """All settings, one after the other. What the scenario refuses says why."""
    todo: list[tuple[str, str, tuple[str, ...], dict[str, Any]]] = []
    for key, path, values in VARIED:
        todo += [(key, value, (f"{path}={value}",), {}) for value in values]
    todo += [("pointing", words, texts, {}) for words, texts in POINTINGS]
    todo += [("threshold", f"{shift:+g} in S/N", (), {"threshold_shift": shift}) for shift in THRESHOLDS]
    todo += [("frames lost", f"{100 * lost:g} %", (), {"lost": lost}) for lost in LOSSES]
    out = []
    for key, value, texts, changes in todo:
        try:
            found = scenarios.load(name, registry=registry, overrides=[*overrides, *texts], seed=seed)
            per_day, error, watched = expected_per_day(Flight.of(found.simulator, seed), response, days, **changes)
        except UserError as error_line:
            out.append(Setting(key=key, value=value, refused=str(error_line)))
            continue
        out.append(Setting(key=key, value=value, per_day=tuple(per_day.tolist()), error=tuple(error.tolist()), watched=watched))
    return out
