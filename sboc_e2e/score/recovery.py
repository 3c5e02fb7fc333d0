"""Debris by size as a mission would infer it: counts of detections unfolded with the efficiency of other objects.

A run counts tracklets by estimated size, single-frame detections by magnitude, and detections that have neither. The response to
objects of a true size is measured on injected objects, and never on the objects that are counted. The injected objects are
divided into halves. Each half is counted and unfolded (`ground.population`) with the response of the other. The two results are
added.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from ground.population import (
    NOT_DETECTED,
    Exposure,
    Recovered,
    Response,
    categories,
    cone_cross_section_km2,
    n_categories,
    observed_counts,
    recover,
    response_of,
    slopes,
)
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.score.figures import SEED, Figure, absent, exact, figure, proportion, rate, scaled
from sboc_e2e.score.matching import TruthStreak

SIZE_EDGES_M: Final = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Classes of diameters, two a decade, of runs and surveys. Chosen: finer ones hold fewer objects each."""
MAG_EDGES: Final = (0.0, 9.0, 11.0, 13.0, 20.0)
"""Classes of detections without a size. Chosen: two magnitudes wide where most of them are."""
DRAWS: Final = 1000  # Of posteriors: an end of the 90 % interval is known to 0.07 of the standard error.
RANGE_SHARE: Final = 0.9
"""A class's flux is that through the viewing cone out to the range which holds this share of its injected objects."""

_EDGES: Final = np.array(SIZE_EDGES_M)
_N_OBSERVED: Final = n_categories(_EDGES, np.array(MAG_EDGES))
_ARRAYS: Final = {
    "size_m": np.float64,
    "weight": np.float64,
    "range_km": np.float64,
    "category": np.int64,
    "surplus": np.int64,
    "surplus_frame": np.int64,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Counted:
    """Injected objects with the detection of each, and detections beyond the first of each.

    size_m, weight, range_km : (n,) true diameter, objects in nature that each stands for, true range (NaN if never in a frame).
    category : (n,) of its detection, NOT_DETECTED without one. surplus : (m,) categories of detections of no object, or of one
    that was counted already; surplus_frame : (m,) their frames.
    """

    size_m: NDArray[np.float64]
    weight: NDArray[np.float64]
    range_km: NDArray[np.float64]
    category: NDArray[np.int64]
    surplus: NDArray[np.int64]
    surplus_frame: NDArray[np.int64]
    n_frames: int

    def as_lists(self) -> dict[str, Any]:
        """The same as JSON knows it, for the metadata of a table; `Counted.from_lists` reads it."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return {name: [None if v != v else v for v in values] for name, values in arrays.items()} | {"n_frames": self.n_frames}

    @classmethod
    def from_lists(cls, lists: Mapping[str, Any]) -> "Counted":
        """What `as_lists` gave."""
        arrays: dict[str, Any] = {
            name: np.array([np.nan if v is None else v for v in lists[name]], dtype=kind) for name, kind in _ARRAYS.items()
        }
        return cls(**arrays, n_frames=int(lists["n_frames"]))

    def halves(self) -> tuple["Counted", "Counted"]:
        """Every other object, and every other frame's surplus."""
        return self._half(0), self._half(1)

    def _half(self, rest: int) -> "Counted":
        objects, surplus = np.arange(len(self.size_m)) % 2 == rest, self.surplus_frame % 2 == rest
        kept = {name: getattr(self, name)[surplus if name.startswith("surplus") else objects] for name in _ARRAYS}
        return Counted(**kept, n_frames=(self.n_frames + 1 - rest) // 2)


def together(runs: Sequence[Counted]) -> Counted:
    """Several runs as one long one; frames of different runs count on."""
    offsets = np.cumsum([0, *(run.n_frames for run in runs[:-1])])
    joined = {name: np.concatenate([getattr(run, name) for run in runs]) for name in _ARRAYS}
    joined["surplus_frame"] += np.repeat(offsets, [len(run.surplus) for run in runs])
    return Counted(**joined, n_frames=sum(run.n_frames for run in runs))


def counted(
    objects: Table,
    streaks: Table,
    orbits: Table,
    pairs: Mapping[int, TruthStreak],
    owner: Mapping[int, int],
    n_frames: int,
) -> Counted:
    """What a run's products say, object by object.

    pairs : row of `streaks` -> truth streak. owner : tracklet id -> object id, -1 when false. An object's own detection is the
    tracklet with most streaks, or without one its first detection in a single frame. Objects that are no debris (of a catalogue,
    or placed by the scenario) and what was seen of them are left out: a mission knows those.
    """
    debris = np.array([str(kind) == "population" for kind in objects["kind"]], dtype=bool)
    place = {int(o): k for k, o in enumerate(np.asarray(objects["object_id"])[debris])}
    size_of = dict(zip(_column(orbits, "tracklet_id", int), _column(orbits, "size_m", float), strict=True))
    rows_of: dict[int, list[int]] = {}
    singles: list[tuple[int, int]] = []
    for row, s in enumerate(streaks):
        if int(s["tracklet_id"]) >= 0:
            rows_of.setdefault(int(s["tracklet_id"]), []).append(row)
        elif not int(s["flags"]) & StreakFlag.VETOED:
            singles.append((row, pairs[row].object_id if row in pairs else -1))
    claims = [
        (owner.get(tracklet, -1), size_of.get(tracklet, np.nan), _mean_mag(streaks, rows), int(streaks["frame"][rows[0]]))
        for tracklet, rows in sorted(rows_of.items(), key=lambda item: (-len(item[1]), item[0]))
    ]
    claims += [(target, np.nan, float(streaks["mag"][row]), int(streaks["frame"][row])) for row, target in singles]
    claims = [claim for claim in claims if claim[0] < 0 or claim[0] in place]
    _, sizes, mags, frames = (np.array(column) for column in zip(*claims, strict=True)) if claims else (np.zeros(0),) * 4
    kind = categories(np.asarray(sizes, float), np.asarray(mags, float), _EDGES, np.array(MAG_EDGES))
    category = np.full(len(place), NOT_DETECTED, dtype=np.int64)
    surplus = []
    for k, (target, *_) in enumerate(claims):
        if target >= 0 and category[place[target]] == NOT_DETECTED:
            category[place[target]] = kind[k]
        else:
            surplus.append(k)
    return Counted(
        size_m=np.asarray(objects["size_m"], float)[debris],
        weight=np.asarray(objects["weight"], float)[debris],
        range_km=np.asarray(objects["range_km"], float)[debris],
        category=category,
        surplus=kind[surplus],
        surplus_frame=np.asarray(frames, dtype=np.int64)[surplus],
        n_frames=n_frames,
    )


def recovery(sample: Counted, span_s: float, field_deg: float, injected: Counted | None = None) -> dict[str, Any]:
    """Objects by size class a day and per km^2 and year, and N(> d) with its slope: injected and recovered.

    span_s : time in which `sample.weight` objects of nature cross the field. field_deg : full angle of the viewing cone.
    injected : other runs (of any number of seeds) whose objects give the efficiency and the false alarms. Without them, each half
    of the sample gives these for the other half. A class is unfolded if its efficiency is measured: every sample that gives it
    detected at least one object of the class. N(> d) sums over such classes only, also for the injected objects.
    """
    first, second = sample.halves()
    ways = [(sample, injected)] if injected else [(first, second), (second, first)]
    responses = [response_of(other.size_m, other.category, _EDGES, _N_OBSERVED) for _, other in ways]
    use = np.flatnonzero(np.logical_and.reduce([response.detected.sum(axis=0) > 0.0 for response in responses]))
    exposed = injected or sample
    inside = _by_class(sample.size_m)
    weight = np.array([exposed.weight[mine].mean() if mine.any() else 1.0 for mine in _by_class(exposed.size_m)])
    reach_km = np.array([_reach_km(exposed.range_km[mine]) for mine in _by_class(exposed.size_m)])
    area_km2 = cone_cross_section_km2(field_deg, reach_km)
    exposure = Exposure(duration_s=span_s, boost=1.0 / weight, area_km2=area_km2)
    got = _unfolded(ways, responses, use) if len(use) else None
    true = np.array([sample.weight[mine].sum() for mine in inside])
    n, n_seen = (np.array([int((mine & chosen).sum()) for mine in inside]) for chosen in (True, sample.category != NOT_DETECTED))
    classes: list[dict[str, Any]] = []
    for k, (low, high) in enumerate(pairwise(SIZE_EDGES_M)):
        none = absent("no object of this size" if n[k] == 0 else "too few detected to tell the efficiency of others", int(n[k]))
        classes.append(
            {"from_m": low, "to_m": high, "efficiency": proportion(int(n_seen[k]), int(n[k]), "no object of this size")}
            | dict.fromkeys(("recovered_per_day", "injected_per_km2_year", "recovered_per_km2_year"), none)
        )
    few = absent("fewer than two size classes with a measured efficiency", int(n_seen.sum()))
    larger: list[dict[str, Any]] = []
    if got is None:
        return {"size_classes": classes, "larger_than": larger, "injected_slope": few, "recovered_slope": few}
    days = span_s / 86_400.0
    a_day = got.per(exposure.days()[use])
    for j, k in enumerate(use.tolist()):
        above = use[j:]
        classes[k]["recovered_per_day"] = _figure(a_day.objects[j], int(n_seen[k]))
        if area_km2[k] > 0.0:
            per_area = float(exposure.days()[k] / exposure.km2_years()[k])
            classes[k]["injected_per_km2_year"] = _counted(int(n[k]), true[k] / days * per_area)
            classes[k]["recovered_per_km2_year"] = _figure(a_day.objects[j] * per_area, int(n_seen[k]))
        larger.append(
            {
                "larger_than_m": SIZE_EDGES_M[k],
                "injected_per_day": _counted(int(n[above].sum()), float(true[above].sum()) / days),
                "recovered_per_day": _figure(a_day.cumulative[j], int(n_seen[above].sum())),
            }
        )
    return {
        "size_classes": classes,
        "larger_than": larger,
        "injected_slope": _injected_slope(true[use], n[use], _EDGES[use], a_day.counts, few),
        "recovered_slope": _figure(a_day.slope, int(n_seen.sum())) if np.isfinite(a_day.slope).all() else few,
    }


def _by_class(size_m: NDArray[np.float64]) -> list[NDArray[np.bool_]]:
    return [(size_m >= low) & (size_m < high) for low, high in pairwise(SIZE_EDGES_M)]


def field_deg(frames: Table) -> float:
    """Full angle of the cone whose solid angle is that of the first frame's 9 x 9 grid of directions; 0 where it is not known."""
    if not len(frames) or not np.isfinite(frames["grid_ra_app_deg"][0]).all():
        return 0.0
    ra, dec = np.radians(frames["grid_ra_app_deg"][0]), np.radians(frames["grid_dec_app_deg"][0])
    unit = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1).reshape(9, 9, 3)
    corner = unit[[0, 0, 8, 8], [0, 8, 8, 0]]
    # the area of a spherical quadrilateral, nearly that of the plane one between its corners
    area_sr = 0.5 * float(np.linalg.norm(np.cross(corner[2] - corner[0], corner[3] - corner[1])))
    return float(np.degrees(2.0 * np.sqrt(area_sr / np.pi)))


def _unfolded(ways: Sequence[tuple[Counted, Counted]], responses: Sequence[Response], use: NDArray[np.intp]) -> Recovered:
    """Each sample unfolded with the response and the surplus of its other, added up; `use` : classes."""
    rng = np.random.default_rng(SEED)
    found = []
    for (mine, other), response in zip(ways, responses, strict=True):
        found.append(
            recover(
                observed_counts(np.concatenate([mine.category, mine.surplus]), _N_OBSERVED),
                Response(detected=response.detected[:, use], missed=response.missed[use]),
                np.append(_EDGES[use], _EDGES[use[-1] + 1]),
                rng,
                false_counted=observed_counts(other.surplus, _N_OBSERVED).astype(np.float64),
                false_exposure_ratio=max(other.n_frames, 1) / max(mine.n_frames, 1),
                prior=0.5 / len(ways),
                n_draws=DRAWS,
            )
        )
    return found[0] if len(found) == 1 else found[0].plus(found[1])


def _injected_slope(
    true: NDArray[np.float64], n: NDArray[np.int64], lower_edge_m: NDArray[np.float64], counts: NDArray[np.float64], few: Figure
) -> Figure:
    """Slope of the injected N(> d) through the same classes as the recovered one, with the Poisson scatter of their numbers."""
    draws = np.random.default_rng(SEED).gamma(n + 0.5, size=(DRAWS, len(n))) / np.maximum(n, 1) * true
    value, drawn = (slopes(np.cumsum(v[:, ::-1], axis=1)[:, ::-1], lower_edge_m, counts) for v in (true[None], draws))
    return figure(float(value[0]), int(n.sum()), *np.percentile(drawn, [5.0, 95.0])) if np.isfinite(value[0]) else few


def _reach_km(range_km: NDArray[np.float64]) -> float:
    known = range_km[np.isfinite(range_km)]
    return float(np.quantile(known, RANGE_SHARE)) if len(known) else 0.0


def _figure(quantiles: NDArray[np.float64], n: int) -> Figure:
    """Median and 5 to 95 % interval of a posterior."""
    return figure(float(quantiles[1]), n, float(quantiles[0]), float(quantiles[2]))


def _counted(n: int, value: float) -> Figure:
    """A value that rests on a Poisson count, with Garwood's interval; with none counted the limits stay unknown."""
    return scaled(rate(n, 1.0, n), value / n) if n else exact(0.0, 0)


def _column(table: Table, name: str, kind: type) -> list[Any]:
    """A column as a list; nothing of a table without rows."""
    return [kind(v) for v in table[name]] if len(table) else []


def _mean_mag(streaks: Table, rows: Sequence[int]) -> float:
    """Mean of the magnitudes of a tracklet's streaks, NaN without any."""
    mags = np.asarray(streaks["mag"], float)[rows]
    known = mags[np.isfinite(mags)]
    return float(known.mean()) if len(known) else float("nan")
