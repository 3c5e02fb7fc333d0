"""What a survey teaches: survey.md with flux, convergence, models that can be told apart, and sensitivity; three pictures."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.files import atomic, ecsv
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import Scenario
from sboc_e2e.score.figures import SEED
from sboc_e2e.survey.block import ALTITUDE_EDGES_KM, CLASS_EDGES_M, INCLINATION_EDGES_DEG
from sboc_e2e.survey.estimate import SIZES, Flux, days_to, flux_by_band, systematic_ln, systematic_terms, told_apart
from sboc_e2e.survey.named import named_page
from sboc_e2e.survey.pictures import convergence_png, flux_png, sensitivity_png
from sboc_e2e.survey.response import Response
from sboc_e2e.survey.sensitivity import GROUPS, Setting, expected_per_day, sensitivity
from sboc_e2e.survey.shards import Survey, read_survey
from simulator.platform.earth import DAY_S, EARTH_RADIUS_KM
from simulator.scene.fleet import KINDS as FLEET_KINDS
from simulator.scene.fleet import Fleet
from simulator.survey.expected import expected_passages, model_flux
from simulator.survey.flight import Flight

Array = NDArray[np.float64]

RESPONSE_CURVES: Final = 12
"""Of the 40 of a response: their spread is then known to 21 % (1 / sqrt(2 * 11)). Each costs an integral."""
YEAR_DAYS: Final = 365.0  # Length of the survey that the page's figures are scaled to, without its leap day.
SHELLS: Final = ((2, 3), (2, 4), (3, 4), (4, 4), (4, 7))
"""Numbers of sizes and altitudes for which the page says how soon they are known."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """A population by the factor on the number of pieces of each diameter (m)."""

    name: str
    ratio_at: Callable[[Array], Array]


def bump(share: float) -> Callable[[Array], Array]:
    """1 + share between 3 mm and 3 cm, and 1 elsewhere: so much more at 1 cm."""
    return lambda size_m: np.where((size_m >= 0.003) & (size_m < 0.03), 1.0 + share, 1.0)


def slope(step: float, below_m: float) -> Callable[[Array], Array]:
    """Steeper by `step` below a diameter."""
    return lambda size_m: np.where(size_m < below_m, (np.maximum(size_m, 1e-5) / below_m) ** -step, 1.0)


MODELS: Final = (
    Model(name="20 % more between 3 mm and 3 cm", ratio_at=bump(0.2)),
    Model(name="5 % more between 3 mm and 3 cm", ratio_at=bump(0.05)),
    Model(name="steeper by 0.1 below 1 cm", ratio_at=slope(0.1, 0.01)),
    Model(name="steeper by 0.5 below 1 cm (assumed ORDEM-like)", ratio_at=slope(0.5, 0.01)),
    Model(name="flatter by 0.3 below 10 cm (assumed MASTER-like)", ratio_at=slope(-0.3, 0.1)),
    Model(name="the same population", ratio_at=np.ones_like),
)


def write_reports(
    out: Path, scenario: Scenario, response: Response, overrides: Sequence[str], registry: Registry
) -> tuple[Path, ...]:
    """Write what a survey teaches about the sampled population and about objects with names; the pages that there are."""
    flight = Flight.of(scenario.simulator, scenario.seed)
    pages = []
    if any(c.count for c in scenario.simulator.population.classes):
        write_report(out, scenario, response, overrides, registry)
        pages.append(out / "survey.md")
    if flight.fleet is not None:
        atomic.write_text(out / "objects.md", named_page(out, flight.fleet, scenario.simulator.objects.breakup, scenario.seed))
        ecsv.write_table(out / "objects.ecsv", _objects(flight.fleet))
        pages.append(out / "objects.md")
    return tuple(pages)


def _objects(fleet: Fleet) -> Table:
    """One row for each object with a name: `object` of the truth is its row."""
    a_km, e, i_deg = fleet.orbits()
    kinds = [FLEET_KINDS[k] for k in fleet.kind]
    return Table(
        {"object": np.arange(len(fleet)), "name": list(fleet.names), "kind": kinds, "size_m": fleet.size_m, "a_km": a_km,
         "e": e, "i_deg": i_deg}
    )  # fmt: skip


def write_report(out: Path, scenario: Scenario, response: Response, overrides: Sequence[str], registry: Registry) -> None:
    """Write survey.md, flux.ecsv and the pictures into the folder of a survey."""
    survey = read_survey(out)
    flight = Flight.of(scenario.simulator, scenario.seed)
    edges = np.array(CLASS_EDGES_M), np.array(ALTITUDE_EDGES_KM), np.array(INCLINATION_EDGES_DEG)
    model = model_flux(flight, *edges)
    expected = expected_passages(flight, *edges, survey.span_days * DAY_S)
    terms = systematic_terms(response_error(flight, response))
    wrong = systematic_ln(terms)
    height_km = float(np.linalg.norm(flight.window.observer_km)) - EARTH_RADIUS_KM
    home = int(np.clip(np.searchsorted(ALTITUDE_EDGES_KM, height_km, side="right") - 1, 0, len(ALTITUDE_EDGES_KM) - 2))
    rng = np.random.default_rng(SEED)
    whole = flux_by_band(survey, model[:, home : home + 1].sum(axis=2), expected.sum(axis=(2, 3))[..., None], "none", wrong, rng)
    altitude = flux_by_band(survey, model.sum(axis=2), expected.sum(axis=3), "altitude", wrong, rng)
    inclination = flux_by_band(survey, model[:, home], expected.sum(axis=2), "inclination", wrong, rng)
    settings = sensitivity(scenario.name, overrides, registry, response, YEAR_DAYS, scenario.seed)
    shell = _shell(home)
    apart = [(m, *told_apart(survey, m.ratio_at, days, rng), days) for m in MODELS for days in (7.0, YEAR_DAYS)]
    ecsv.write_table(out / "flux.ecsv", _table(whole, altitude, inclination))
    atomic.write_bytes(out / "flux.png", flux_png(whole, altitude, inclination, f"flux at {shell}"))
    curves = [
        (f"> {100 * CLASS_EDGES_M[k]:g} cm, {_shell(b)}", _width(altitude, k, b), 1.645 * float(wrong[k])) for k, b in SHELLS
    ]
    atomic.write_bytes(
        out / "convergence.png", convergence_png([c for c in curves if np.isfinite(c[1])], 0.5 * survey.watched_days)
    )
    atomic.write_bytes(out / "sensitivity.png", sensitivity_png(settings))
    atomic.write_text(out / "survey.md", _page(scenario, survey, response, whole, altitude, terms, settings, apart, shell))


def response_error(flight: Flight, response: Response) -> Array:
    """One sigma of ln(tracklets) by class from resampled pixel runs: how well the response is known."""
    curves = response.curves[:RESPONSE_CURVES]
    counts = []
    for curve in curves:
        content: dict[str, Any] = {**response.content, "detection": {**response.content["detection"], "curve": curve.tolist()}}
        counts.append(expected_per_day(flight, Response(content=content), YEAR_DAYS)[0])
    spread = np.std(np.log(np.maximum(counts, 1e-9)), axis=0, ddof=1)
    linked = response.content["linking"][1]
    tried, n = linked["tried"] + 1.0, linked["linked"] + 0.5
    link = np.sqrt(n / tried * (1.0 - min(n / tried, 0.999)) / (tried + 1.0))
    group = [next(g for g, (low, high) in enumerate(GROUPS) if low <= d < high) for d in CLASS_EDGES_M[:-1]]
    return np.array([np.hypot(spread[g], link) for g in group])


def _width(flux: Flux, k: int, b: int) -> float:
    low, middle, high = flux.larger[k, b]
    return float(0.5 * (high - low) / middle) if middle > 0.0 else float("nan")


def _table(whole: Flux, altitude: Flux, inclination: Flux) -> Table:
    """One row for each size and band."""
    rows: list[tuple[Any, ...]] = []
    bands = (
        ("all", whole, ((0.0, 0.0),)),
        ("altitude_km", altitude, tuple(pairwise(ALTITUDE_EDGES_KM))),
        ("inclination_deg", inclination, tuple(pairwise(INCLINATION_EDGES_DEG))),
    )
    for axis, flux, edges in bands:
        for b, (low, high) in enumerate(edges):
            for k in range(SIZES):
                rows.append((axis, low, high, CLASS_EDGES_M[k], int(flux.n[k, b]), *flux.larger[k, b], flux.total[k, b, 0],
                             flux.total[k, b, 2], flux.true[k, b]))  # fmt: skip
    names = ("axis", "from", "to", "larger_than_m", "n_tracklets", "flux_low", "flux", "flux_high", "flux_total_low",
             "flux_total_high", "injected")  # fmt: skip
    table = Table(rows=rows, names=names)
    table.meta = {"unit": "objects larger than larger_than_m, per km2 and year; 90 % intervals, counting and total"}
    return table


def _page(
    scenario: Scenario, survey: Survey, response: Response, whole: Flux, altitude: Flux, terms: dict[str, Array],
    settings: Sequence[Setting], apart: Sequence[tuple[Model, float, float, float]], shell: str,
) -> str:  # fmt: skip
    """The page in Markdown."""
    n, kinds = len(survey.block), survey.true["kind"]
    content = response.content
    trails = content["detection"]["snr50_30px"]["n"]
    share = 100.0 * survey.watched_days / survey.span_days
    lines = [
        f"# Survey: {scenario.name}, {survey.span_days:g} days",
        "",
        f"{n} tracklets in {survey.watched_days:.2f} days watched ({share:.1f} % of the time; in the rest the Earth stands in",
        f"the field); {int(np.sum(kinds == 1))} of them false. {int(survey.crossings.sum())} passages could be seen.",
        f"The response rests on {content['runs']} runs of the pixel chain, {content['frames']} frames, {trails} trails and "
        f"{len(content['tracklets'])} tracklets (code {content['code']}).",
        "",
        f"## Flux at {shell}",
        "",
        "Objects larger than d per km2 and year; 90 % intervals. Every other block is counted, the others show the efficiency.",
        "",
        "| larger than | tracklets | flux | counting | with the systematic term | injected | efficiency |",
        "|---|---|---|---|---|---|---|",
    ]
    for k in range(SIZES):
        low, value, high = whole.larger[k, 0]
        least, _, most = whole.total[k, 0]
        lines.append(
            f"| {1e3 * CLASS_EDGES_M[k]:g} mm | {whole.n[k, 0]} | {value:.4g} | {low:.4g} to {high:.4g} "
            f"| {least:.3g} to {most:.3g} | {whole.true[k, 0]:.4g} | {whole.efficiency[k, 0]:.2f} |"
        )
    lines += ["", "One sigma of ln N(> d) that is the same in all cells:", ""]
    lines += ["| larger than | " + " | ".join(terms) + " |", "|---|" + "---|" * len(terms)]
    for k in range(SIZES):
        lines.append(f"| {1e3 * CLASS_EDGES_M[k]:g} mm | " + " | ".join(f"{term[k]:.3f}" for term in terms.values()) + " |")
    lines += ["", "![flux](flux.png)", "", "## How soon", ""]
    for k, b in SHELLS:
        days = days_to(0.1, altitude, k, b, 0.5 * survey.watched_days)
        words = f"{100 * CLASS_EDGES_M[k]:g} cm flux at {_shell(b)}"
        lines.append(f"- {words}: to 10 % after {days:.3g} days of counting" if np.isfinite(days) else f"- {words}: not seen")
    lines += ["", "![convergence](convergence.png)", "", "## Which models a survey tells apart", ""]
    lines += ["By counting alone, at 1 % false alarms; albedo, phase and response, the same for both, are left out.", ""]
    lines += ["| against today's | days | told apart | false alarms |", "|---|---|---|---|"]
    lines += [f"| {m.name} | {days:g} | {100 * found:.0f} % | {100 * false:.1f} % |" for m, found, false, days in apart]
    groups = " | ".join(f"{1e3 * low:g} to {1e3 * high:g} mm" for low, high in GROUPS)
    lines += ["", "## What the answer depends on", "", "Tracklets a day over a year, one key changed at a time."]
    lines += ["That another camera finds as much at equal S/N and length is an assumption.", ""]
    lines += [f"| key | value | {groups} | watched |", "|---|---|" + "---|" * (len(GROUPS) + 1)]
    for s in settings:
        values = " | ".join(f"{v:.0f} ± {e:.0f}" for v, e in zip(s.per_day, s.error, strict=True)) if s.per_day else s.refused
        lines.append(f"| {s.key} | {s.value} | {values} | {100 * s.watched:.0f} % |")
    lines += ["", "![sensitivity](sensitivity.png)", ""]
    return "\n".join(lines)


def _shell(band: int) -> str:
    return f"{ALTITUDE_EDGES_KM[band]:g} to {ALTITUDE_EDGES_KM[band + 1]:g} km"
