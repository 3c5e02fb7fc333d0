"""Debris by size as a mission would infer it: counts of detections unfolded with the efficiency of other objects.

A run counts tracklets by estimated size, detections of one frame by magnitude, and those that have neither. How objects of a
true size show up is measured on injected objects, never on those that are being counted: the injected ones are divided into
halves, each half is counted and unfolded (`ground.population`) with the response of the other, and the two results add up.
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
    categories,
    cone_cross_section_km2,
    n_categories,
    observed_counts,
    recover,
    response_of,
    slopes,
)
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.score.figures import Figure, absent, figure, proportion, rate, scaled
from sboc_e2e.score.matching import TruthStreak

SIZE_EDGES_M: Final = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
MAG_EDGES: Final = (0.0, 9.0, 11.0, 13.0, 20.0)
DRAWS: Final = 1000
RANGE_SHARE: Final = 0.9
"""A class's flux is that through the viewing cone out to the range which holds this share of its injected objects."""

_EDGES: Final = np.array(SIZE_EDGES_M)
_N_OBSERVED: Final = n_categories(_EDGES, np.array(MAG_EDGES))
_SEED: Final = 20270129


@dataclass(frozen=True, kw_only=True, eq=False)
class Counted:
    """Injected objects with what became of each, and detections beyond the first of each.

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

    def halves(self) -> tuple["Counted", "Counted"]:
        """Every other object, and every other frame's surplus."""
        return self._half(0), self._half(1)

    def _half(self, rest: int) -> "Counted":
        objects, surplus = np.arange(len(self.size_m)) % 2 == rest, self.surplus_frame % 2 == rest
        return Counted(
            size_m=self.size_m[objects],
            weight=self.weight[objects],
            range_km=self.range_km[objects],
            category=self.category[objects],
            surplus=self.surplus[surplus],
            surplus_frame=self.surplus_frame[surplus],
            n_frames=(self.n_frames + 1 - rest) // 2,
        )


def together(runs: Sequence[Counted]) -> Counted:
    """Several runs as one long one; frames of different runs count on."""
    offsets = np.cumsum([0, *(run.n_frames for run in runs[:-1])])
    joined = {
        name: np.concatenate([getattr(run, name) for run in runs])
        for name in ("size_m", "weight", "range_km", "category", "surplus")
    }
    frames = np.concatenate([run.surplus_frame + offset for run, offset in zip(runs, offsets, strict=True)])
    return Counted(**joined, surplus_frame=frames, n_frames=sum(run.n_frames for run in runs))


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


def recovery(sample: Counted, span_s: float, field_deg: float) -> dict[str, Any]:
    """Objects by size class a day and per km^2 and year, and N(> d) with its slope: injected and recovered.

    span_s : time in which `sample.weight` objects of nature cross the field. field_deg : full angle of the viewing cone.
    A class is unfolded when each half of the injected objects has a detected one of it; N(> d) sums over such classes alone, for
    the injected objects too.
    """
    first, second = sample.halves()
    responses = [response_of(half.size_m, half.category, _EDGES, _N_OBSERVED) for half in (first, second)]
    measured = np.logical_and(*(response.detected.sum(axis=0) > 0.0 for response in responses))
    of_class = np.searchsorted(_EDGES, sample.size_m, side="right") - 1
    inside = [of_class == k for k in range(len(_EDGES) - 1)]
    seen = sample.category != NOT_DETECTED
    weight = np.array([sample.weight[mine].mean() if mine.any() else 1.0 for mine in inside])
    area_km2 = cone_cross_section_km2(field_deg, np.array([_reach_km(sample.range_km[mine]) for mine in inside]))
    exposure = Exposure(duration_s=span_s, boost=1.0 / weight, area_km2=area_km2)
    got = _both_ways(first, second, responses, measured) if measured.any() else None
    true = np.array([sample.weight[mine].sum() for mine in inside]) / (span_s / 86_400.0)
    use = np.flatnonzero(measured)
    a_day = got.per(exposure.days()[use]) if got else None
    a_km2_year = got.per(exposure.km2_years()[use]) if got else None
    place = {int(k): j for j, k in enumerate(use)}
    classes, larger = [], []
    for k, (low, high) in enumerate(pairwise(SIZE_EDGES_M)):
        n_seen, n = int((seen & inside[k]).sum()), int(inside[k].sum())
        row: dict[str, Any] = {"from_m": low, "to_m": high, "efficiency": proportion(n_seen, n, "no object of this size")}
        reason = "no object of this size" if n == 0 else "too few detected to measure the efficiency on others"
        row["recovered_per_day"] = _figure(a_day.objects[place[k]], n_seen) if a_day and k in place else absent(reason, n_seen)
        flux = a_km2_year and k in place and area_km2[k] > 0.0
        row["injected_per_km2_year"] = (
            _scaled_count(n, true[k] / n * 365.25 / area_km2[k]) if flux else absent(reason, n)
        )
        row["recovered_per_km2_year"] = _figure(a_km2_year.objects[place[k]], n_seen) if flux and a_km2_year else absent(reason, n)
        classes.append(row)
        if a_day and k in place:
            above = use[place[k] :]
            n_above, total = int(sum(inside[j].sum() for j in above)), float(true[above].sum())
            larger.append(
                {
                    "larger_than_m": low,
                    "injected_per_day": _scaled_count(n_above, total / n_above),
                    "recovered_per_day": _figure(a_day.cumulative[place[k]], int(sum((seen & inside[j]).sum() for j in above))),
                }
            )
    few = absent("fewer than two size classes with a measured efficiency", int(seen.sum()))
    return {
        "size_classes": classes,
        "larger_than": larger,
        "injected_slope": _injected_slope(true[use], [int(inside[k].sum()) for k in use], _EDGES[use], few),
        "recovered_slope": _figure(a_day.slope, int(seen.sum())) if a_day and np.isfinite(a_day.slope).all() else few,
    }


def field_deg(frames: Table) -> float:
    """Full angle of the cone whose solid angle is that of the first frame's 9 x 9 grid of directions; 0 without frames."""
    if not len(frames):
        return 0.0
    ra, dec = np.radians(frames["grid_ra_app_deg"][0]), np.radians(frames["grid_dec_app_deg"][0])
    unit = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=1).reshape(9, 9, 3)
    corner = unit[[0, 0, 8, 8], [0, 8, 8, 0]]
    # the area of a spherical quadrilateral, nearly that of the plane one between its corners
    area_sr = 0.5 * float(np.linalg.norm(np.cross(corner[2] - corner[0], corner[3] - corner[1])))
    return float(np.degrees(2.0 * np.sqrt(area_sr / np.pi)))


def _both_ways(first: Counted, second: Counted, responses: Sequence[Any], measured: NDArray[np.bool_]) -> Recovered:
    """Each half unfolded with the other's response and surplus, added up."""
    rng = np.random.default_rng(_SEED)
    use = np.flatnonzero(measured)
    edges = np.append(_EDGES[use], _EDGES[use[-1] + 1])
    found = []
    for mine, other, response in ((first, second, responses[1]), (second, first, responses[0])):
        observed = observed_counts(np.concatenate([mine.category, mine.surplus]), _N_OBSERVED)
        found.append(
            recover(
                observed,
                type(response)(detected=response.detected[:, use], missed=response.missed[use]),
                edges,
                rng,
                false_counted=observed_counts(other.surplus, _N_OBSERVED).astype(np.float64),
                false_exposure_ratio=max(other.n_frames, 1) / max(mine.n_frames, 1),
                n_draws=DRAWS,
            )
        )
    return found[0].plus(found[1])


def _injected_slope(true: NDArray[np.float64], counts: Sequence[int], lower_edge_m: NDArray[np.float64], few: Figure) -> Figure:
    """Slope of the injected N(> d) over the same classes, with the Poisson scatter of their numbers."""
    if len(counts) < 2:
        return few
    draws = np.random.default_rng(_SEED).gamma(np.array(counts) + 0.5, size=(DRAWS, len(counts))) / np.array(counts) * true
    drawn = slopes(np.cumsum(draws[:, ::-1], axis=1)[:, ::-1], lower_edge_m, np.ones(len(counts), bool))
    value = slopes(np.cumsum(true[None, ::-1], axis=1)[:, ::-1], lower_edge_m, np.ones(len(counts), bool))[0]
    return figure(float(value), int(sum(counts)), *np.percentile(drawn, [5.0, 95.0]))


def _reach_km(range_km: NDArray[np.float64]) -> float:
    known = range_km[np.isfinite(range_km)]
    return float(np.quantile(known, RANGE_SHARE)) if len(known) else 0.0


def _figure(quantiles: NDArray[np.float64], n: int) -> Figure:
    """Median and 5 to 95 % interval of a posterior."""
    return figure(float(quantiles[1]), n, float(quantiles[0]), float(quantiles[2]))


def _scaled_count(n: int, factor: float) -> Figure:
    """A Poisson count in other units, with Garwood's interval."""
    return scaled(rate(n, 1.0, n), factor)


def _column(table: Table, name: str, kind: type) -> list[Any]:
    """A column as a list; nothing of a table without rows."""
    return [kind(v) for v in table[name]] if len(table) else []


def _mean_mag(streaks: Table, rows: Sequence[int]) -> float:
    """Mean of the magnitudes of a tracklet's streaks, NaN without any."""
    mags = np.asarray(streaks["mag"], float)[rows]
    known = mags[np.isfinite(mags)]
    return float(known.mean()) if len(known) else float("nan")
