"""The catalogue of a survey against the objects that were there: complete, pure, how wrong, and whether it knows."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray
from scipy.stats import chi2

from ground.store.forces import carried
from ground.store.store import ObjectStore, StoredOrbit
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from sboc_e2e.report import plots
from sboc_e2e.report.page import table
from sboc_e2e.score.figures import proportion
from simulator.scene.objects import OrbitingObject

Array = NDArray[np.float64]

LIGHT_KM_S: Final = 299_792.458
"""Speed of light in vacuum."""
OWN_ARCSEC: Final = 30.0
"""Median distance of a tracklet's directions from an object's up to which it is that object's: six pixels."""
LEAST_FRAMES: Final = 3
"""Frames in which an object has to be for a tracklet to be expected."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Objects by name, with places at seconds after an epoch. expected : visits that had each in the field."""

    epoch_tai_ns: int
    objects: Mapping[str, OrbitingObject]
    expected: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class Place:
    """Error of a place (3-D), one sigma of it, and the squared error over the covariance, divided by three."""

    error_km: float
    sigma_km: float
    nees: float


@dataclass(frozen=True, kw_only=True)
class Scored:
    """An object of the truth and what the catalogue has of it; empty where it has none."""

    name: str
    expected: int
    tracklets: int
    catalogued: str
    right: int
    wrong: int
    at_epoch: Place | None
    a_day_on: Place | None


@dataclass(frozen=True, kw_only=True)
class CatalogueScore:
    """All objects, and what belongs to none of them.

    false_tracklets : in the store, of no object. false_objects : of the catalogue, whose tracklets are mostly of none.
    """

    objects: tuple[Scored, ...]
    false_tracklets: int
    false_objects: int
    accepted: int
    accepted_right: int

    def as_json(self) -> dict[str, Any]:
        """Figures with their n and 90 % intervals."""
        seen = [o for o in self.objects if o.expected >= 2]
        places = {name: [p for o in self.objects if (p := getattr(o, name)) is not None] for name in ("at_epoch", "a_day_on")}
        return {
            "tracklets": proportion(
                sum(min(o.tracklets, o.expected) for o in self.objects), sum(o.expected for o in self.objects)
            ),
            "objects": proportion(sum(bool(o.catalogued) for o in seen), len(seen)),
            "purity": proportion(self.accepted_right, self.accepted),
            "false_tracklets": self.false_tracklets,
            "false_objects": self.false_objects,
            **{
                name: {
                    "n": len(found),
                    "median_error_km": float(np.median([p.error_km for p in found])) if found else None,
                    "median_sigma_km": float(np.median([p.sigma_km for p in found])) if found else None,
                    **nees_of([p.nees for p in found]),
                }
                for name, found in places.items()
            },
            "by_object": [
                {
                    "name": o.name, "visits": o.expected, "tracklets": o.tracklets, "catalogued": o.catalogued, "right": o.right,
                    "wrong": o.wrong,
                    **{
                        key: None if place is None else vars(place)
                        for key, place in (("at_epoch", o.at_epoch), ("a_day_on", o.a_day_on))
                    },
                }
                for o in self.objects
            ],
        }  # fmt: skip


def nees_of(values: Sequence[float]) -> dict[str, float | None]:
    """Mean of squared errors over three variances, and the 95 % range of such a mean of honest covariances."""
    n = len(values)
    if n == 0:
        return {"nees": None, "honest_low": None, "honest_high": None}
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / (3 * n)
    return {"nees": float(np.mean(values)), "honest_low": float(low), "honest_high": float(high)}


def expected_visits(run_dirs: Sequence[Path], names: Sequence[str]) -> dict[str, int]:
    """Visits whose truth has an object in enough frames."""
    found = dict.fromkeys(names, 0)
    for path in run_dirs:
        objects = Table.read(path / "truth" / "objects.ecsv")
        streaks = Table.read(path / "truth" / "streaks.ecsv")
        number = {int(row["object_id"]): str(row["name"]) for row in objects}
        for object_id, name in number.items():
            if name in found and len(np.unique(streaks["frame"][streaks["object_id"] == object_id])) >= LEAST_FRAMES:
                found[name] += 1
    return found


def score(store: ObjectStore, truth: Truth, at_tai_ns: int) -> CatalogueScore:
    """The store against the truth; places are compared at an epoch and a day later."""
    last = at_tai_ns + tai.NS_PER_DAY
    owner = {k: _owner(t.t_tai_ns, t.rows, truth) for k, t in store.tracklets(0, last).items()}
    named = {row["object_id"]: row for row in store.objects() if row["status"] != "merged"}
    members = {number: list(store.tracklets_of(number)) for number in named}
    orbits = {o.object_id: o for o in store.orbits()}
    belongs = {number: _majority([owner[t] for t in mine]) for number, mine in members.items() if mine}
    rows = []
    for name, thing in truth.objects.items():
        mine = [number for number, whose in belongs.items() if whose == name]
        # of two entries for one object the larger one counts, the other is a fragment
        number = max(mine, key=lambda k: (len(members[k]), -k), default=None)
        right = 0 if number is None else sum(owner[t] == name for t in members[number])
        orbit = None if number is None else orbits.get(number)
        rows.append(
            Scored(
                name=name,
                expected=truth.expected[name],
                tracklets=sum(whose == name for whose in owner.values()),
                catalogued="" if number is None or orbit is None else str(named[number]["name"]),
                right=right,
                wrong=0 if number is None else len(members[number]) - right,
                at_epoch=_place(orbit, thing, truth, at_tai_ns),
                a_day_on=_place(orbit, thing, truth, last),
            )
        )
    return CatalogueScore(
        objects=tuple(rows),
        false_tracklets=sum(not whose for whose in owner.values()),
        false_objects=sum(not whose for whose in belongs.values()),
        accepted=sum(map(len, members.values())),
        accepted_right=sum(owner[t] == belongs[number] != "" for number, mine in members.items() for t in mine),
    )


def _majority(names: Sequence[str]) -> str:
    return max(sorted(set(names)), key=names.count)


def _owner(t_tai_ns: NDArray[np.int64], rows: Array, truth: Truth) -> str:
    """Name of the object whose directions a tracklet has; empty for none."""
    time_s = np.asarray((t_tai_ns - truth.epoch_tai_ns) * 1e-9, dtype=np.float64)
    best, whose = OWN_ARCSEC, ""
    for name, thing in truth.objects.items():
        line = thing.positions_km(time_s) - rows[:, 6:]
        delay_s = np.asarray(np.linalg.norm(line, axis=1) / LIGHT_KM_S, dtype=np.float64)
        line = thing.positions_km(time_s - delay_s) - rows[:, 6:]
        away = np.linalg.norm(line / np.linalg.norm(line, axis=1, keepdims=True) - rows[:, :3], axis=1)
        arcsec = float(np.degrees(np.median(away))) * 3600.0
        if arcsec < best:
            best, whose = arcsec, name
    return whose


def _place(orbit: StoredOrbit | None, thing: OrbitingObject, truth: Truth, at_tai_ns: int) -> Place | None:
    """The orbit carried to an epoch against the truth there; None where it cannot be carried."""
    if orbit is None:
        return None
    try:
        states, covariances = carried(orbit, np.array([at_tai_ns], dtype=np.int64))
    except UserError:
        return None
    covariance = covariances[0, :3, :3]
    away = states[0, :3] - thing.positions_km(np.array([(at_tai_ns - truth.epoch_tai_ns) * 1e-9]))[0]
    return Place(
        error_km=float(np.linalg.norm(away)),
        sigma_km=float(np.sqrt(np.trace(covariance))),
        nees=float(away @ np.linalg.solve(covariance, away) / 3.0),
    )


def sections(found: CatalogueScore, runs: Mapping[str, str]) -> Iterator[str]:
    """The part of the page that knows the truth. runs : names of the visits and their reports."""
    figures = found.as_json()
    yield "<h2>Against the truth</h2>"
    yield "<p>The truth was simulated with forces and an integrator of its own. The catalogue was made without it.</p>"
    lines = [
        ("tracklets of objects that were in the field in three frames or more", _share(figures["tracklets"])),
        ("objects in the field in two visits or more that have an orbit", _share(figures["objects"])),
        ("accepted tracklets that are of the object that most of its tracklets are of", _share(figures["purity"])),
        ("tracklets of no object; catalogued objects of none", f"{found.false_tracklets}; {found.false_objects}"),
    ]
    for key, words in (("at_epoch", "at the page's epoch"), ("a_day_on", "a day later")):
        part = figures[key]
        if part["n"]:
            size = f"{part['median_error_km']:.3g} km (one sigma {part['median_sigma_km']:.3g} km)"
            honest = f"{part['honest_low']:.2f} to {part['honest_high']:.2f} (n = {part['n']})"
            lines += [
                (f"error of place {words}, median", size),
                (f"squared error over its variance {words}", f"{part['nees']:.2f}, of honest orbits {honest}"),
            ]
    yield table(("figure", "value"), lines)
    rows = [
        (
            o.name, o.catalogued or "none", f"{o.tracklets} of {o.expected}", str(o.right), str(o.wrong), *_told(o.at_epoch),
            *_told(o.a_day_on),
        )
        for o in found.objects
    ]  # fmt: skip
    head = ("object", "catalogued as", "tracklets of visits", "right", "wrong", "error (km)", "sigma (km)", "NEES",
            "a day later: error (km)", "sigma (km)", "NEES")  # fmt: skip
    yield table(head, rows)
    yield from _figure(found)
    links = ", ".join(f"<a href='{escape(path)}'>{escape(name)}</a>" for name, path in runs.items())
    yield f"<p>Reports of the visits: {links}.</p>"


def _told(place: Place | None) -> tuple[str, str, str]:
    return ("-", "-", "-") if place is None else (f"{place.error_km:.3g}", f"{place.sigma_km:.3g}", f"{place.nees:.2f}")


def _share(part: Mapping[str, Any]) -> str:
    if part["value"] is None:
        return "-"
    return f"{part['value']:.3f} [{part['low']:.3f}, {part['high']:.3f}] (n = {part['n']})"


def _figure(found: CatalogueScore) -> Iterator[str]:
    """Errors against what the orbits say of them."""
    drawn: list[tuple[str, str, Callable[[Scored], Place | None]]] = [
        ("at the page's epoch", plots.BLUE, lambda o: o.at_epoch),
        ("a day later", plots.ORANGE, lambda o: o.a_day_on),
    ]
    if not any(pick(o) for o in found.objects for _, _, pick in drawn):
        return
    with plots.canvas() as (figure, (ax,)):
        for label, colour, pick in drawn:
            places = [p for o in found.objects if (p := pick(o)) is not None]
            ax.plot([p.sigma_km for p in places], [p.error_km for p in places], "o", color=colour, label=label)
        low, high = ax.get_xlim()
        line = np.array([low, high])
        ax.plot(line, line, "--", color=plots.INK, label="error = one sigma")
        ax.set(xlabel="one sigma of place (km)", ylabel="error of place (km)", xscale="log", yscale="log")
        for axis in (ax.xaxis, ax.yaxis):
            plots.plain_logarithmic(axis)
        ax.legend()
        words = "Errors against what the orbits say of them"
        yield f"<div class='plots'><figure><figcaption>{words}</figcaption>{plots.svg(figure)}</figure></div>"
