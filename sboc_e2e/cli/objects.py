"""Commands about objects and their orbits: conjunctions, the object catalogue, calibration by known orbits."""

from pathlib import Path
from typing import Annotated

import typer

from sboc_e2e.cli.application import Overrides, Plugins, Workers, app, registry_of, shown_progress

conjunctions_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Close approaches and collision probability.")
app.add_typer(conjunctions_app, name="conjunctions")


@conjunctions_app.command()
def assess(
    messages: Annotated[list[Path], typer.Argument(help="conjunction data messages (CCSDS 508.0, KVN)")],
    hard_body: Annotated[float | None, typer.Option("--hard-body", help="combined radius, m; default: of the message")] = None,
    pairs: Annotated[int, typer.Option("--pairs", help="pairs of orbits drawn where only Monte Carlo holds")] = 1_000_000,
    out: Annotated[Path | None, typer.Option("--out", help="folder for the messages with the judged probability")] = None,
) -> None:
    """Judge the encounters of messages: 2-D probability, whether it holds, and what stands where it does not."""
    from sboc_e2e.objects.conjunctions import assess_message, assessment_lines, judged_message

    for path in messages:
        message, judged = assess_message(path, hard_body, pairs)
        typer.echo("\n".join(assessment_lines(message, judged)))
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            (out / path.name).write_text(judged_message(message, judged), encoding="utf-8")


@conjunctions_app.command()
def screen(
    elements: Annotated[Path, typer.Argument(help="two- or three-line element sets")],
    start: Annotated[str, typer.Option("--start", help="UTC, such as 2022-01-22T00:00:00")],
    days: Annotated[float, typer.Option("--days", help="how long")] = 1.0,
    distance: Annotated[float, typer.Option("--distance", help="report approaches nearer than this, km")] = 5.0,
    out: Annotated[Path, typer.Option("--out", help="table of approaches")] = Path("conjunctions.csv"),
) -> None:
    """Screen all objects of a catalogue against all, by SGP4: no pair is left out."""
    from sboc_e2e.objects.conjunctions import screen_elements, write_approaches

    labels, found, start_ns = screen_elements(elements, start, days, distance)
    write_approaches(labels, found, start_ns, out)
    typer.echo(f"{len(labels)} objects, {len(found.first)} approaches nearer than {distance:g} km in {days:g} d")
    if len(found.lost):
        typer.echo(f"{len(found.lost)} objects have no state at some epoch (decayed, or elements that SGP4 refuses)")
    typer.echo(out)


objects_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="The object catalogue: orbits with their history.")
app.add_typer(objects_app, name="objects")

Store = Annotated[str, typer.Option("--store", help="SQLite file or URL such as postgresql+pg8000://user@host/name")]


@objects_app.command()
def add(
    ephemeris: Annotated[Path, typer.Argument(help="precise orbits: SP3 (also .Z) or CPF")],
    name: Annotated[list[str] | None, typer.Option("--object", help="only this one, such as G01; may be repeated")] = None,
    store: Store = "objects.db",
) -> None:
    """Fit orbits to a precise ephemeris and put them into the catalogue."""
    from sboc_e2e.objects.catalogue import add_precise

    typer.echo("\n".join(add_precise(store, ephemeris, name or [])))


@objects_app.command()
def observe(
    messages: Annotated[list[Path], typer.Argument(help="tracking data messages (TDM, right ascension and declination)")],
    observer: Annotated[Path | None, typer.Option("--observer", help="ephemeris of a moving sensor (OEM)")] = None,
    site: Annotated[str | None, typer.Option("--site", help="LATITUDE,LONGITUDE,HEIGHT of a fixed one: deg, deg, m")] = None,
    sensor: Annotated[str, typer.Option("--sensor", help="name of the sensor in the store")] = "sensor",
    sigma: Annotated[
        float | None,
        typer.Option("--sigma", help="one sigma of a direction, arcsec; default: tdm_angles.ecsv beside each message, else 1"),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="file of sboc calibrate: the nearest session's biases are taken off")
    ] = None,
    store: Store = "objects.db",
) -> None:
    """Put published tracklets into the catalogue, uncorrelated."""
    from sboc_e2e.icd.errors import UserError
    from sboc_e2e.objects.places import place_of_ephemeris, place_of_site
    from sboc_e2e.objects.upkeep import Correction
    from sboc_e2e.objects.upkeep import observe as execute

    if (observer is None) == (site is None):
        raise UserError("objects observe: give either --observer (a moving sensor) or --site (a fixed one)")
    place = place_of_site(site) if site is not None else place_of_ephemeris(observer or Path())
    correction = None if calibration is None else Correction.of(calibration, shares_clock=site is None)
    typer.echo(execute(store, messages, place, sensor, sigma, correction))


@objects_app.command()
def update(
    at: Annotated[str, typer.Option("--at", help="UTC up to which tracklets count, such as 2026-11-22T12:00:00")],
    window: Annotated[float, typer.Option("--window", help="days that tracklets and fits reach back")] = 10.0,
    store: Store = "objects.db",
    workers: Annotated[int, typer.Option("--workers", help="processes that predict orbits, 0: one for each processor")] = 0,
) -> None:
    """Correlate new tracklets, renew orbits, find new objects (MEO, GEO), call objects lost, found again or retired."""
    from sboc_e2e.objects.upkeep import bring_up
    from sboc_e2e.run.workers import worker_count

    typer.echo(bring_up(store, at, window, worker_count(workers)))


@objects_app.command(name="fly")
def fly_visits(
    scenario: Annotated[str, typer.Argument(help="a name of `sboc scenarios` or the path of a TOML file")],
    visit: Annotated[list[float], typer.Option("--visit", help="hours after the scenario's epoch, rising; two or more")],
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/visits-<scenario>")] = None,
    overrides: Overrides = None,
    plugin: Plugins = None,
    workers: Workers = 0,
) -> None:
    """Fly a scenario several times, pixel by pixel, and catalogue its objects: store, orbits, score against the truth, page."""
    from sboc_e2e import scenario as scenarios
    from sboc_e2e.objects.fly import fly

    registry = registry_of(plugin)
    found = scenarios.load(scenario, registry=registry, overrides=overrides or ())
    with shown_progress() as progress:
        lines = fly(found, visit, out or Path("runs") / f"visits-{found.name}", registry, workers, progress)
    typer.echo("\n".join(lines))


@objects_app.command()
def page(
    at: Annotated[str, typer.Option("--at", help="UTC for which errors of place are given, such as 2026-11-22T12:00:00")],
    out: Annotated[Path, typer.Option("--out", help="the page")] = Path("objects.html"),
    store: Store = "objects.db",
) -> None:
    """Write a page of the catalogue's state: quality of each orbit, residuals, decisions."""
    from sboc_e2e.objects.page import write_page

    typer.echo(write_page(store, at, out))


@objects_app.command()
def light(
    name: Annotated[str, typer.Argument(help="object of the catalogue")],
    messages: Annotated[list[Path], typer.Argument(help="tracking data messages (TDM) with MAG")],
    trails: Annotated[list[Path] | None, typer.Option("--trails", help="light_curves.ecsv of each message")] = None,
    observer: Annotated[Path | None, typer.Option("--observer", help="ephemeris of a moving sensor (OEM)")] = None,
    site: Annotated[str | None, typer.Option("--site", help="LATITUDE,LONGITUDE,HEIGHT of a fixed one: deg, deg, m")] = None,
    mag_err: Annotated[float, typer.Option("--mag-err", help="one sigma of a MAG, mag")] = 0.1,
    out: Annotated[Path | None, typer.Option("--out", help="folder for a JSON file and a plot")] = None,
    store: Store = "objects.db",
) -> None:
    """Light curve of an object over its passes: period, amplitude, phase function, stable, tumbling or glinting."""
    from sboc_e2e.icd.errors import UserError
    from sboc_e2e.objects.light import character_json, character_lines, draw, light_of
    from sboc_e2e.objects.places import place_of_ephemeris, place_of_site

    if (observer is None) == (site is None):
        raise UserError("objects light: give either --observer (a moving sensor) or --site (a fixed one)")
    place = place_of_site(site) if site is not None else place_of_ephemeris(observer or Path())
    found, passes = light_of(store, name, messages, trails or [], place, mag_err)
    typer.echo("\n".join(character_lines(name, found)))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        plain = "".join(c if c.isalnum() or c in "-_." else "_" for c in name)
        (out / f"{plain}.json").write_text(character_json(name, found), encoding="utf-8")
        draw(name, found, passes, out / f"{plain}.png")
        typer.echo(out)


@objects_app.command(name="list")
def list_objects(store: Store = "objects.db") -> None:
    """What the catalogue holds, and how good its orbits are."""
    from sboc_e2e.objects.catalogue import state_lines

    typer.echo("\n".join(state_lines(store)))


@objects_app.command()
def export(
    kind: Annotated[str, typer.Option("--as", help="opm, oem, omm or parquet")],
    out: Annotated[Path, typer.Option("--out", help="folder")],
    store: Store = "objects.db",
    originator: Annotated[str, typer.Option("--originator", help="of the messages")] = "SBOC-E2E",
    days: Annotated[float, typer.Option("--days", help="length of an OEM from the epoch on, 35 minutes at least")] = 1.0,
) -> None:
    """Write the current orbits as messages or tables."""
    from sboc_e2e.objects.catalogue import export as execute

    typer.echo("\n".join(execute(store, kind, out, originator, days)))


@app.command()
def calibrate(
    messages: Annotated[list[Path], typer.Argument(help="tracking data messages (TDM, right ascension and declination)")],
    orbits: Annotated[list[Path], typer.Option("--orbits", help="precise orbits, SP3 (also .Z) or CPF; may be repeated")],
    observer: Annotated[Path | None, typer.Option("--observer", help="ephemeris of a moving sensor (OEM)")] = None,
    site: Annotated[str | None, typer.Option("--site", help="LATITUDE,LONGITUDE,HEIGHT of a fixed one: deg, deg, m")] = None,
    gap: Annotated[float, typer.Option("--gap", help="hours without a track between two sessions")] = 6.0,
    out: Annotated[Path, typer.Option("--out", help="calibration file")] = Path("calibration.json"),
) -> None:
    """Time bias, pointing and noise of a sensor from objects with precise orbits, session by session (90 % intervals)."""
    from sboc_e2e.icd.errors import UserError
    from sboc_e2e.objects.calibration import calibrate as execute
    from sboc_e2e.objects.calibration import session_line
    from sboc_e2e.objects.places import place_of_ephemeris, place_of_site

    if (observer is None) == (site is None):
        raise UserError("calibrate: give either --observer (a moving sensor) or --site (a fixed one)")
    place = place_of_site(site) if site is not None else place_of_ephemeris(observer or Path())
    found, left_out = execute(messages, place, orbits, shares_clock=site is None, gap_h=gap, out=out)
    typer.echo("\n".join([*(session_line(bias) for bias in found), *(f"left out: {reason}" for reason in left_out)]))
    typer.echo(out)
