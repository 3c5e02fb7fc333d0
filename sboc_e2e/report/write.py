"""Write report.html and report.md into a run directory."""

import json
from importlib import resources
from pathlib import Path
from typing import Any, Final

import jinja2
import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_text
from sboc_e2e.report import pictures, plots
from sboc_e2e.report.headlines import figure_at, headline_rows
from sboc_e2e.report.layers import cases, completeness_series, frame_layers
from sboc_e2e.report.published_files import published_rows
from sboc_e2e.report.reasons import Reasons
from sboc_e2e.report.track_stacks import track_stacks
from sboc_e2e.report.words import figure_words, section_rows
from sboc_e2e.score.astrometry import frame_astrometry, sky_paths, streak_astrometry
from sboc_e2e.score.evaluation import Evaluation, evaluate
from sboc_e2e.score.photometry import mean_magnitudes, photometry

MAX_PREVIEWS: Final = 24  # First frames shown on the page. Chosen, with `MAX_TILE_BYTES`, so that it stays below 25 MB.
MAX_TILE_BYTES: Final = 12_000_000
"""Full-resolution tiles in a page, so that it stays below 25 MB with previews and cut-outs."""
RESIDUALS_TITLE: Final = "Streak positions against their bounds"
ORBITS_TITLE: Final = "Orbits: samples of the posterior, and ranges with 90 % intervals (cross: truth)"
SECTIONS: Final = (
    "detection",
    "astrometry",
    "photometry",
    "linking",
    "tracking",
    "orbit",
    "products",
    "population",
    "compression",
    "timing",
)


def write_report(run_dir: Path, evaluation: Evaluation | None = None) -> None:
    """Both pages, from score.json and what lies in the run directory; pictures only of frames that were kept.

    evaluation : that of the same directory, with the truth that score.json was made with; needed where that came from
    elsewhere, and quicker where the caller has just scored it.
    """
    score = json.loads((run_dir / "score.json").read_text())
    e = evaluation or evaluate(run_dir)
    write_text(run_dir / "report.md", markdown(score, e))
    write_text(run_dir / "report.html", html(score, e, run_dir))


def markdown(score: dict[str, Any], e: Evaluation) -> str:
    """A page short enough for a CI job summary."""
    name = e.manifest.get("scenario", {}).get("name", "run") if isinstance(e.manifest.get("scenario"), dict) else "run"
    lines = [f"# {name}: {e.n_frames} frames of {e.shape[0]} x {e.shape[1]}", "", *(f"**Note:** {note}.\n" for note in e.notes)]
    lines += ["| figure | value | n |", "|---|---|---|"]
    lines += [f"| {label} | {value} | {note} |" for label, value, note in headline_rows(score)]
    lines += ["", f"{len(e.truth)} truth streaks, {len(e.detected_ground)} measured, {len(e.false_rows)} false, "
              f"{len(e.tracklets)} tracklets."]  # fmt: skip
    lines += per_day_lines(score)
    lines += ["", "What is published, read from the files:", "", "| figure | value | should be | |", "|---|---|---|---|"]
    for row in published_rows(score):
        value = f"- ({row.note})" if row.value == "-" else row.value
        lines.append(f"| {row.label} | {value} | {row.aim} | {row.verdict} |")
    return "\n".join(lines) + "\n"


def per_day_lines(score: dict[str, Any]) -> list[str]:
    """Detections a day by size, with the interval of counting and with that of models added; nothing without any."""
    seen = [c for c in score["population"]["size_classes"] if c.get("models_per_day", {}).get("value")]
    if not seen:
        return []
    lines = ["", "Debris detected a day, 90 % of counting, and with what albedo and population models leave:", ""]
    lines += ["| size | a day | counting | with models | n |", "|---|---|---|---|---|"]
    for c in seen:
        counted, models = c["detected_per_day"], c["models_per_day"]
        size = f"{1e3 * c['from_m']:g} to {1e3 * c['to_m']:g} mm"
        spans = (f"{of['low']:.3g} to {of['high']:.3g}" for of in (counted, models))
        lines.append(f"| {size} | {counted['value']:.3g} | {' | '.join(spans)} | {counted['n']} |")
    return lines


def html(score: dict[str, Any], e: Evaluation, run_dir: Path) -> str:
    """The self-contained page."""
    kept = pictures.kept_frames(run_dir)
    shown = sorted(kept)[:MAX_PREVIEWS]
    case_lists = cases(e, Reasons.of(e, run_dir))
    previews: dict[int, str] = {}
    stretches: dict[int, dict[str, list[float]]] = {}
    close_up: dict[int, list[tuple[int, int, str]]] = {}
    layers = frame_layers(e, shown)
    paths = {
        layer["frame"]: [point for each in (*layer["truth"], *layer["streaks"]) for point in each["line"]] for layer in layers
    }
    room = MAX_TILE_BYTES
    wanted: dict[int, list[dict[str, Any]]] = {}
    for case in (*case_lists["misses"], *case_lists["false_alarms"]):
        wanted.setdefault(case["frame"], []).append(case)
    for number in sorted(kept):
        if number not in shown and number not in wanted:
            continue
        image = pictures.read_pixels(kept[number])
        if number in shown:
            previews[number], small = pictures.preview(image)
            stretches[number] = {"preview": small.as_list()}
            if pictures.shrink_factor(e.shape) > 1 and room > 0:
                close_up[number], full = pictures.tiles(image, ((r, c) for c, r in paths[number]))
                stretches[number]["tiles"] = full.as_list()
                room -= sum(len(uri) for _, _, uri in close_up[number])
        for case in wanted.get(number, ()):
            case["picture"], case["row0"], case["col0"] = pictures.cutout(image, case["row"], case["col"])
    data = {
        "rows": e.shape[0],
        "cols": e.shape[1],
        "cutout": pictures.CUTOUT_PX,
        "previews": previews,
        "stretches": stretches,
        "tiles": close_up,
        "tile": pictures.TILE_PX,
        "layers": layers,
        "cases": case_lists,
    }
    folder = resources.files("sboc_e2e.report")
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    page = environment.from_string((folder / "page.html.j2").read_text(encoding="utf-8"))
    sections = {name: section_rows(score.get(name, {})) for name in SECTIONS}
    return page.render(
        title=str(run_dir.name),
        notes=e.notes,
        manifest=json.dumps(e.manifest, indent=1, sort_keys=True),
        headlines=headline_rows(score),
        published=published_rows(score),
        sections=sections,
        plots=_plots(score, e, run_dir),
        stacks=track_stacks(e.streaks, kept, _dark(run_dir)),
        wide_plots=(RESIDUALS_TITLE, ORBITS_TITLE),
        n_frames=e.n_frames,
        n_tiles=sum(len(each) for each in close_up.values()),
        n_kept=len(kept),
        shape=e.shape,
        counts={k: len(v) for k, v in case_lists.items()},
        # "</" must not end the script element that carries the data.
        data=json.dumps(data, separators=(",", ":")).replace("</", "<\\/"),
        css=(folder / "page.css").read_text(encoding="utf-8"),
        js="".join((folder / name).read_text(encoding="utf-8") for name in ("page.js", "sort.js")),
    )


def _dark(run_dir: Path) -> NDArray[np.float32] | None:
    """The dark of the run, ADU, where it has one."""
    path = run_dir / "calibration" / "dark.fits"
    return pictures.read_pixels(path) if path.is_file() else None


def _true_ranges(e: Evaluation) -> dict[int, float]:
    """Median true range (km) of the object behind each tracklet."""
    range_km: dict[int, list[float]] = {}
    for row, truth in e.pairs.items():
        tracklet = int(e.streaks["tracklet_id"][row])
        if tracklet >= 0 and "range_km" in e.truth_tables["streaks"].colnames:
            range_km.setdefault(tracklet, []).append(float(e.truth_tables["streaks"]["range_km"][truth.index]))
    return {tracklet: float(np.median(values)) for tracklet, values in range_km.items()}


def _plots(score: dict[str, Any], e: Evaluation, run_dir: Path) -> list[tuple[str, str]]:
    """Title and SVG of each plot that has something to show."""
    ideal = figure_at(score, "detection.ground.ideal_snr50")["value"]
    out = [("Completeness", plots.completeness(completeness_series(e), ideal))]
    measured = {row: t for row, t in e.measured.items() if t.index in e.bounds}
    sky = sky_paths(e.truth_tables["streaks"], sorted({t.index for t in measured.values()}))
    _, residuals = streak_astrometry(e.streaks, measured, e.bounds, sky)
    if residuals:
        out.append((RESIDUALS_TITLE, plots.residuals(residuals)))
    _, grids = frame_astrometry(e.frames, e.truth_tables["frames"])
    if grids:
        out.append(("Frame solution minus truth, mean over frames", plots.frame_vectors(grids)))
    truth_mag = mean_magnitudes(e.truth_tables["streaks"], e.truth)
    _, magnitudes = photometry(e.streaks, measured, truth_mag, e.bounds, e.frames, e.truth_tables["frames"])
    if magnitudes:
        out.append(("Streak magnitudes", plots.magnitudes(magnitudes)))
    if len(e.streaks):
        out.append(("Tracklets on the sky", plots.tracklets_on_sky(e.streaks, e.frames)))
    samples = run_dir / "products" / "orbit_samples.ecsv"
    if samples.is_file() and len(found := Table.read(samples, format="ascii.ecsv")):
        out.append((ORBITS_TITLE, plots.orbit_spread(found, e.orbits, _true_ranges(e))))
    if score["population"]["larger_than"]:
        out.append(("Small debris: injected and recovered", plots.larger_than(score["population"]["larger_than"])))
    seen = [c for c in score["population"]["size_classes"] if c.get("models_per_day", {}).get("value")]
    if seen:
        out.append(("Debris detected a day by size", plots.detected_per_day(seen)))
    if score["population"]["published"]["larger_than"]:
        out.append(
            ("Small debris: published flux and truth", plots.published_flux(score["population"]["published"]["larger_than"]))
        )
    units = ("frame", "star", "streak")
    bits = ", ".join(f"{figure_words(figure_at(score, f'compression.bits_per_{unit}'))[0]} a {unit}" for unit in units)
    out.append(
        (f"Downlink by kind of packet; bits: {bits}", plots.downlink_bars(score["compression"]["bytes_by_kind"], e.n_frames))
    )
    return out
