"""From a plan's file to a folder: schedule.ecsv, targets.ecsv, windows.ecsv, scenario.toml, prm.xml, pictures, plan.md."""

import gzip
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from ground.orbit.catalogue_match import KnownObjects, read_elements
from ground.planning.fence import Fence, fence_of
from ground.planning.plan import plan_visits
from ground.planning.prm import prm_xml
from ground.planning.schedule import Schedule
from ground.planning.sky import Orbit
from ground.planning.targets import Targets
from ground.planning.windows import Windows
from ground.products.epochs import utc_text as utc_texts
from sboc_e2e import scenario
from sboc_e2e.files import atomic, ecsv
from sboc_e2e.files.frame_fits import utc_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.planning.flown import scenario_toml
from sboc_e2e.planning.instrument import optical_axes, planned_camera, station_of
from sboc_e2e.planning.pictures import sky_png, timeline_png
from sboc_e2e.planning.request import PlanRequest
from sboc_e2e.planning.weather import as_errors_of, instant, with_weather
from sboc_e2e.registry import Registry
from sboc_e2e.scenario.option_models import did_you_mean
from simulator.platform import earth

_LISTED: Final = 40
"""Names that an error line lists."""


def make_plan(request: PlanRequest, path: Path, out: Path, registry: Registry) -> Schedule:
    """Make a plan and write its folder. `path` is the plan's file. UserError for what cannot be planned."""
    found = scenario.load(request.scenario, registry=registry)
    start = instant(request.start_utc or found.simulator.epoch_utc, f"{path}: start_utc")
    with as_errors_of(f"{path}: start_utc"):
        earth.refuse_outside_data(start + round(request.plan.days * 86400e9))
    camera = planned_camera(found.simulator, request.plan.sky_mag_arcsec2)
    station = station_of(found.simulator, start)
    if request.weather:
        station = with_weather(station, path.resolve().parent / request.weather, f"{path}: weather")
    names: tuple[str, ...] = ()
    fence, source = None, None
    if request.goal == "fence":
        fence = fence_of(station, camera, start, request.plan, request.fence)
        schedule = fence.schedule
    else:
        source = path.resolve().parent / request.objects
        known = _objects(request, path, source)
        names = known.names
        n = len(names)
        targets = Targets(known=known, weight=np.ones(n), size_m=np.full(n, request.plan.size_m))
        schedule = plan_visits(targets, station, camera, start, request.plan)
    pointed = optical_axes(schedule, found.simulator)
    out.mkdir(parents=True, exist_ok=True)
    atomic.write_text(out / "scenario.toml", scenario_toml(request, found, station, source, pointed, registry))
    if isinstance(station, Orbit):
        roll_deg = found.simulator.pointing.roll_deg
        atomic.write_bytes(out / "prm.xml", prm_xml(pointed, roll_deg, start, found.ground.products))
    ecsv.write_table(out / "schedule.ecsv", _visits(schedule, names))
    if names:
        ecsv.write_table(out / "targets.ecsv", _targets(schedule, names))
    if schedule.windows is not None:
        ecsv.write_table(out / "windows.ecsv", _windows(schedule.windows, names))
    atomic.write_bytes(out / "timeline.png", timeline_png(schedule, start))
    atomic.write_bytes(out / "sky.png", sky_png(schedule, start))
    atomic.write_text(out / "plan.md", _page(request, schedule, fence, start, len(names)))
    return schedule


def _objects(request: PlanRequest, path: Path, source: Path) -> KnownObjects:
    """The element sets that the plan asks for."""
    try:
        data = source.read_bytes()
        text = (gzip.decompress(data) if source.suffix == ".gz" else data).decode()
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise UserError(f"{path}: objects: {source} cannot be read: {error}") from error
    known = read_elements(text)
    if not known.names:
        raise UserError(f"{path}: objects: {source} holds no element set")
    tags = [{name, str(number)} for name, number in zip(known.names, known.numbers, strict=True)]
    missing = set(request.names).difference(*tags)
    if missing:
        few = len(known.names) <= _LISTED
        near = did_you_mean(min(missing), known.names) if few else f"it has {len(known.names)} others"
        raise UserError(f"{path}: names: no element set of {source} is named {', '.join(sorted(missing))}; {near}")
    per_day = np.array([satellite.no_kozai for satellite in known.satellites]) * 1440.0 / (2.0 * np.pi)
    wanted = np.array([not request.names or not tag.isdisjoint(request.names) for tag in tags])
    kept = np.flatnonzero(wanted & (per_day >= request.least_mean_motion) & (per_day <= request.most_mean_motion))
    if not len(kept):
        raise UserError(
            f"{path}: objects: none of {np.count_nonzero(wanted)} element sets has a mean motion of "
            f"{request.least_mean_motion:g} to {request.most_mean_motion:g} revolutions a day"
        )
    return KnownObjects(
        names=tuple(known.names[k] for k in kept),
        numbers=known.numbers[kept],
        satellites=tuple(known.satellites[k] for k in kept),
    )


def _visits(schedule: Schedule, names: tuple[str, ...]) -> Table:
    """One row for each visit."""
    boresight = np.array([visit.boresight for visit in schedule.visits]).reshape(-1, 3)
    ra, dec = angles_deg(boresight)
    table = Table()
    table["visit"] = np.arange(len(schedule.visits))
    table["start_utc"] = utc_texts([visit.start_tai_ns for visit in schedule.visits])
    table["end_utc"] = utc_texts([visit.end_tai_ns for visit in schedule.visits])
    table["ra_deg"], table["dec_deg"] = ra, dec
    table["n_targets"] = [len(visit.targets) for visit in schedule.visits]
    table["gain_nats"] = [visit.gain for visit in schedule.visits]
    table["targets"] = [";".join(names[k] for k in visit.targets) or "-" for visit in schedule.visits]
    for name, unit, text in (
        ("start_utc", "", "the camera rests on the field from here on"),
        ("end_utc", "", "to here"),
        (
            "ra_deg",
            "deg",
            "geometric direction of the field's centre from the camera, GCRS axes; the optical axis stands in scenario.toml",
        ),
        ("dec_deg", "deg", "its declination"),
        ("gain_nats", "", "half the logarithm of the determinant of what is known after over before, all targets together"),
        ("targets", "", "targets within the circle inscribed in the field"),
    ):
        table[name].description = text
        if unit:
            table[name].unit = unit
    return table


def _windows(windows: Windows, names: tuple[str, ...]) -> Table:
    """One row for each window of a target."""
    table = Table()
    table["target"] = windows.target
    table["name"] = [names[k] for k in windows.target]
    table["start_utc"] = utc_texts(windows.start_tai_ns, 1)
    table["end_utc"] = utc_texts(windows.end_tai_ns, 1)
    return table


def _targets(schedule: Schedule, names: tuple[str, ...]) -> Table:
    """One row for each target."""
    counts = np.zeros(len(names), dtype=np.int64)
    for visit in schedule.visits:
        counts[list(visit.targets)] += 1
    table = Table()
    table["target"] = np.arange(len(names))
    table["name"] = list(names)
    table["n_visits"] = counts
    table["gain_nats"] = schedule.gain_nats
    table["error_ratio"] = np.exp(-schedule.gain_nats / 6.0)
    table["error_ratio"].description = "geometric mean of the errors of the six elements, after over before"
    return table


def angles_deg(vectors: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension and declination (n,) of unit vectors (n, 3)."""
    ra = np.degrees(np.arctan2(vectors[:, 1], vectors[:, 0])) % 360.0
    return np.asarray(ra), np.asarray(np.degrees(np.arcsin(np.clip(vectors[:, 2], -1.0, 1.0))))


def _page(request: PlanRequest, schedule: Schedule, fence: Fence | None, start: int, n_targets: int) -> str:
    """A page in Markdown."""
    lines: list[Any] = [f"# Plan: {request.description or request.scenario}", ""]
    lines += [f"{len(schedule.visits)} visits in {schedule.n_slots} slots from {utc_text(start)} on, {request.plan.days:g} days."]
    if fence is not None:
        verdict = "Nothing slips through." if fence.leak_proof else "The fence leaks."
        lines += [
            f"{verdict} The fence stands at right ascension {fence.meridian_deg:.1f} deg in {fence.n_fields} fields. "
            f"A field is visited every {fence.cycle_s:.0f} s; an object of the ring needs at least {fence.crossing_s:.0f} s to "
            f"cross it. Constraints allow {100 * fence.held:.1f} % of the visits. "
            f"The longest gap of a field is {fence.longest_gap_s:.0f} s."
        ]
    else:
        seen = int(np.count_nonzero(schedule.gain_nats > 0))
        ratio = np.exp(-np.median(schedule.gain_nats) / 6.0)
        lines += [f"{seen} of {n_targets} targets are visited. The median target's errors shrink to {100 * ratio:.2g} %."]
    lines += [
        "",
        *(f"- {note}" for note in schedule.notes),
        "",
        "| what forbids a target in a slot | share of all cases |",
        "|---|---|",
    ]
    lines += [
        f"| {name} | {100 * share:.1f} % |" for name, share in sorted(schedule.forbidden.items(), key=lambda item: -item[1])
    ]
    lines += ["", "![timeline](timeline.png)", "", "![sky](sky.png)", ""]
    lines += ["`sboc run scenario.toml` flies the first visits.", ""]
    return "\n".join(lines)
