"""A page of the catalogue's state: quality of each orbit, residuals of its last tracklets, decisions."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.determination.propagation import propagate
from ground.orbit.states import elements_of
from ground.products.epochs import utc_text
from ground.store.forces import forces_of
from ground.store.store import ObjectStore, StoredOrbit
from ground.upkeep.view import directions_of, position_error_km
from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.conjunctions import epoch_of
from sboc_e2e.report import plots
from sboc_e2e.report.page import simple_page, table

Array = NDArray[np.float64]

QUALITY: Final = ((1.0, "good"), (10.0, "fair"), (np.inf, "poor"))
"""One sigma of place at the page's epoch (km) up to which an orbit is called so."""
MOST_RESIDUALS: Final = 200
"""Objects whose residuals are drawn: each costs an integration."""
MOST_DECISIONS: Final = 50  # Rows of the table of the last decisions, a few screens. Chosen; the store keeps all of them.
COLOURS: Final = {"good": plots.GREEN, "fair": plots.BLUE, "poor": plots.ORANGE, "lost": plots.RED}


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectRow:
    """An object as the page shows it. error_km : one sigma of place, 3-D, at the page's epoch."""

    name: str
    status: str
    orbit: StoredOrbit
    elements: Array
    error_km: float
    n_tracklets: int

    @property
    def quality(self) -> str:
        """good, fair or poor by the error of place; lost where the catalogue says so."""
        return self.status if self.status != "active" else next(word for limit, word in QUALITY if self.error_km <= limit)


def write_page(url: str, at_utc: str, out: Path, more: Sequence[str] = ()) -> Path:
    """The page of a store at an epoch; `more` are parts that stand before its objects. UserError without a store."""
    if "://" not in url and not Path(url).is_file():
        raise UserError(f"{url}: no such store")
    at = epoch_of(at_utc)
    store = ObjectStore(url)
    rows = _rows(store, at)
    counts, status = store.counts(), Counter(row["status"] for row in store.objects())
    accepted, ambiguous = (len(store.associations(state=state)) for state in ("accepted", "ambiguous"))
    cards = (
        ("objects", f"{counts['objects']:,}", ", ".join(f"{n} {name}" for name, n in sorted(status.items()))),
        (
            "good, fair, poor",
            " / ".join(str(sum(r.quality == q for r in rows)) for _, q in QUALITY),
            "one sigma of place below 1, 10 km, above",
        ),
        ("median error of place", f"{np.median([r.error_km for r in rows]):.3g} km" if rows else "-", f"at {at_utc}"),
        ("tracklets", f"{counts['tracklets']:,}", f"{accepted:,} accepted, {ambiguous:,} ambiguous decisions"),
        ("orbits", f"{counts['orbits']:,}", "with their history"),
        ("decisions", f"{counts['decisions']:,}", ""),
    )  # fmt: skip
    residuals = _residuals(store, rows)
    body = [
        "<div class='cards'>",
        *(f"<div class='card'><span>{escape(a)}</span><b>{escape(b)}</b><small>{escape(c)}</small></div>" for a, b, c in cards),
        "</div>",
        "<div class='plots'>",
        *_figures(rows, residuals),
        "</div>",
        *more,
        "<h2>Objects</h2>",
        _object_table(rows, at),
        "<h2>Decisions</h2>",
        _decision_table(store.decisions()[-MOST_DECISIONS:]),
    ]
    store.close()
    write_text(out, simple_page(f"Catalogue of {Path(url).name} at {at_utc}", body))
    return out


def _rows(store: ObjectStore, at_tai_ns: int) -> list[ObjectRow]:
    named = {row["object_id"]: row for row in store.objects()}
    linked = Counter(a.object_id for a in store.associations(state="accepted"))
    out = []
    for orbit in store.orbits():
        row = named[orbit.object_id]
        if row["status"] == "merged":
            continue
        try:
            error_km = position_error_km(orbit, at_tai_ns)
        except UserError:
            error_km = float("inf")
        elements = elements_of(orbit.state[None])[0]
        out.append(
            ObjectRow(
                name=row["name"], status=row["status"], orbit=orbit, elements=elements, error_km=error_km,
                n_tracklets=linked[orbit.object_id],
            )
        )  # fmt: skip
    return out


def _residuals(store: ObjectStore, rows: Sequence[ObjectRow]) -> Array:
    """Of the last tracklets of some objects, (n, 3): days from the orbit's epoch, residuals along and across in sigma."""
    found = []
    for row in rows[:MOST_RESIDUALS]:
        tracklets = list(store.tracklets_of(row.orbit.object_id).values())
        for stored in tracklets[-3:]:
            data = directions_of(stored)
            try:
                arc = propagate(row.orbit.state, row.orbit.epoch_tai_ns, data.t_tai_ns, forces_of(row.orbit))
            except UserError:
                continue
            value, _ = data.residuals(arc.states)
            days = (data.t_tai_ns - row.orbit.epoch_tai_ns) / tai.NS_PER_DAY
            found.append(np.column_stack([days, value]))
    return np.vstack(found) if found else np.empty((0, 3))


def _figures(rows: Sequence[ObjectRow], residuals: Array) -> Iterator[str]:
    if rows:
        with plots.canvas() as (figure, (ax,)):
            for name, colour in COLOURS.items():
                mine = [r for r in rows if r.quality == name]
                if mine:
                    ax.plot(
                        [r.elements[0] for r in mine], [np.degrees(r.elements[2]) for r in mine], ".", color=colour, label=name
                    )
            ax.set(xlabel="semi-major axis (km)", ylabel="inclination (deg)", xscale="log")
            plots.plain_logarithmic(ax.xaxis)
            ax.legend()
            yield f"<figure><figcaption>Orbits by quality</figcaption>{plots.svg(figure)}</figure>"
        errors = np.array([r.error_km for r in rows if np.isfinite(r.error_km) and r.error_km > 0.0])
        if errors.size:
            with plots.canvas() as (figure, (ax,)):
                ax.hist(errors, bins=np.geomspace(errors.min() * 0.9, errors.max() * 1.1, 25), color=plots.BLUE)
                ax.set(xlabel="one sigma of place (km)", ylabel="objects", xscale="log")
                yield f"<figure><figcaption>How well places are known</figcaption>{plots.svg(figure)}</figure>"
    if len(residuals):
        with plots.canvas(columns=2, width_in=9.0) as (figure, (left, right)):
            left.plot(residuals[:, 0], residuals[:, 1], ".", ms=2, color=plots.BLUE, label="along the motion")
            left.plot(residuals[:, 0], residuals[:, 2], ".", ms=2, color=plots.ORANGE, label="across")
            left.set(xlabel="days from the orbit's epoch", ylabel="residual / its sigma", ylim=(-6.0, 6.0))
            left.legend()
            bins = np.linspace(-5.0, 5.0, 41)
            for column, colour in ((1, plots.BLUE), (2, plots.ORANGE)):
                right.hist(residuals[:, column], bins=bins, density=True, histtype="step", color=colour)
            right.plot(bins, np.exp(-0.5 * bins**2) / np.sqrt(2.0 * np.pi), "--", color=plots.INK)
            right.set(xlabel="residual / its sigma", ylabel="density")
            words = f"Residuals of the last three tracklets of {min(MOST_RESIDUALS, len(rows))} objects against their orbits"
            yield f"<figure class='broad'><figcaption>{words}</figcaption>{plots.svg(figure)}</figure>"


def _object_table(rows: Sequence[ObjectRow], at_tai_ns: int) -> str:
    head = (
        "object", "name", "status", "quality", "a (km)", "e", "i (deg)", "error (km)", "age (days)", "tracklets", "measurements",
        "chi2/nu", "made by",
    )  # fmt: skip
    lines = [
        (
            str(r.orbit.object_id), r.name, r.status, r.quality, f"{r.elements[0]:.1f}", f"{r.elements[1]:.5f}",
            f"{np.degrees(r.elements[2]):.3f}", f"{r.error_km:.3g}",
            f"{(at_tai_ns - r.orbit.epoch_tai_ns) / tai.NS_PER_DAY:.2f}", str(r.n_tracklets), str(r.orbit.n_used),
            f"{r.orbit.chi2_nu:.2f}", r.orbit.made_by,
        )
        for r in rows
    ]  # fmt: skip
    return table(head, lines) if lines else "<p>None.</p>"


def _decision_table(decisions: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        (
            utc_text(np.array([d["decided_tai_ns"]]))[0], d["kind"],
            ", ".join(f"{k} {v}" for k, v in d["detail"].items()), d["decided_by"],
        )
        for d in reversed(decisions)
    ]  # fmt: skip
    return table(("at (UTC)", "kind", "what", "by"), lines) if lines else "<p>None.</p>"
