"""The commands. Each parses its options, calls one function of the harness and says where the result is."""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from sboc_e2e.cli.progress import BarProgress, PlainProgress, make_progress
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import SEAMS, Registry, plugin_names

DONE: Final = 0  # Exit code, as docs/user-guide.md lists it: the command did what was asked.
CHECK_FAILED: Final = 1  # Exit code: the command ran, and what it checked is not so.
USER_ERROR: Final = 2  # Exit code: the user can mend it. Shells and argparse use 2 for wrong usage, too.
PROGRAM_ERROR: Final = 3  # Exit code: a plug-in or the program failed, and a traceback is in a log file.

WCS_CHOICES: Final = ("header", "solve", "none")
"""Of `sboc process --wcs`."""

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="End-to-end demonstrator of a space-based optical debris camera: simulate, process on board and on ground, score.",
)
catalogue_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Star catalogues.")
app.add_typer(catalogue_app, name="catalogue")
scenarios_app = typer.Typer(rich_markup_mode=None, help="Scenarios that come with the project.")
app.add_typer(scenarios_app, name="scenarios")

Plugins = Annotated[list[str] | None, typer.Option("--plugin", help="trust a module that a scenario names as module:Class")]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="override a scenario key, such as sensor.prnu=0.01")]
Uses = Annotated[list[str] | None, typer.Option("--use", help="swap a step: onboard.detector=lsd or =my_lab.nets:StreakNet")]
Workers = Annotated[int, typer.Option("--workers", help="processes, 0: one for each processor, one for few pixels")]
RunDir = Annotated[Path, typer.Argument(metavar="RUN_DIR", help="directory of a run")]


@contextmanager
def shown_progress() -> Iterator[PlainProgress | BarProgress]:
    """Progress that leaves the terminal tidy."""
    progress = make_progress()
    try:
        yield progress
    finally:
        progress.close()


def registry_of(plugins: list[str] | None) -> Registry:
    """The registry that trusts the modules of ``--plugin``."""
    return Registry(trusted_modules=plugin_names(plugins or ()))


def parsed_uses(uses: list[str] | None) -> dict[str, str]:
    """``seam=name`` texts by seam; a seam may be named without its segment where that is clear."""
    result: dict[str, str] = {}
    for text in uses or ():
        seam, equals, name = text.partition("=")
        matching = [known for known in SEAMS if known == seam or known.partition(".")[2] == seam]
        if not equals or not name or len(matching) != 1:
            raise UserError(f'--use: expected SEAM=NAME, got "{text[:80]}"; seams: {", ".join(SEAMS)}')
        result[matching[0]] = name
    return result


def _version(wanted: bool) -> None:
    if wanted:
        from sboc_e2e.run.manifest import versions

        for name, version in versions().items():
            typer.echo(f"{name} {version}")
        raise typer.Exit


@app.callback()
def _application(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="versions that matter")] = False,
) -> None:
    """End-to-end demonstrator of a space-based optical debris camera."""


@app.command()
def run(
    scenario: Annotated[str, typer.Argument(help="a name of `sboc scenarios` or the path of a TOML file")],
    out: Annotated[Path | None, typer.Option("--out", help="run directory, default runs/<scenario>")] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="replaces the scenario's seed")] = None,
    overrides: Overrides = None,
    use: Uses = None,
    plugin: Plugins = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on after the last complete frame")] = False,
    force: Annotated[bool, typer.Option("--force", help="replace an earlier run")] = False,
    workers: Workers = 0,
) -> None:
    """Simulate, process on board and on ground, score, report."""
    from sboc_e2e import scenario as scenarios
    from sboc_e2e.report.closing import closing_text
    from sboc_e2e.run import RunRequest
    from sboc_e2e.run import run as execute

    resolved = scenarios.load(scenario, registry=registry_of(plugin), overrides=overrides or (), use=parsed_uses(use), seed=seed)
    target = out or Path("runs") / resolved.name
    with shown_progress() as progress:
        execute(RunRequest(scenario=resolved, out=target, resume=resume, force=force, workers=workers), progress)
    score, manifest = (json.loads((target / f"{name}.json").read_text()) for name in ("score", "manifest"))
    typer.echo(closing_text(score, manifest["stages"]))
    typer.echo(f"{target}/report.html")


def _stage(name: str, run_dir: Path, plugin: list[str] | None, workers: int = 0) -> None:
    """Run one stage of an existing run."""
    from sboc_e2e.run.pipeline import Run

    with shown_progress() as progress:
        opened = Run.open(run_dir, registry_of(plugin), workers=workers, progress=progress)
        {"simulate": opened.simulate, "onboard": opened.onboard, "report": opened.report}[name]()


@app.command()
def simulate(run_dir: RunDir, plugin: Plugins = None, workers: Workers = 0) -> None:
    """Make the frames and the truth of a run again."""
    _stage("simulate", run_dir, plugin, workers)


@app.command()
def onboard(run_dir: RunDir, plugin: Plugins = None) -> None:
    """Process the kept frames of a run on board: frames/ -> downlink.bin."""
    _stage("onboard", run_dir, plugin)


@app.command()
def ground(
    run_dir: RunDir,
    run_id: Annotated[int | None, typer.Option("--run-id", help="whose packets of a mixed downlink, default this run's")] = None,
    plugin: Plugins = None,
) -> None:
    """Process the downlink of a run on ground: downlink.bin -> products/."""
    from sboc_e2e.run.pipeline import Run

    with shown_progress() as progress:
        Run.open(run_dir, registry_of(plugin), progress=progress).ground(run_id)


@app.command()
def score(
    run_dir: RunDir,
    truth: Annotated[Path | None, typer.Option("--truth", help="truth from elsewhere: a table, or SatNet annotations")] = None,
    plugin: Plugins = None,
) -> None:
    """Score the products of a run against truth: score.json."""
    from sboc_e2e.outside.found import is_unscored
    from sboc_e2e.run.pipeline import Run

    if truth is None and is_unscored(run_dir):
        raise UserError(
            f"{run_dir}: frames from outside come without truth; give a list with --truth (docs/scoring.md), "
            f"or see what was found: sboc report {run_dir}"
        )
    with shown_progress() as progress:
        Run.open(run_dir, registry_of(plugin), progress=progress).score(truth)
    typer.echo(run_dir / "score.json")


@app.command()
def report(
    run_dir: RunDir,
    movie: Annotated[Path | None, typer.Option("--movie", help="also write the kept frames as an animated GIF")] = None,
    plugin: Plugins = None,
) -> None:
    """Write report.html and report.md of a scored run; of frames from outside without truth, a page of what was found."""
    from sboc_e2e.outside.found import RunFound, is_unscored

    if movie is not None and movie.suffix.lower() != ".gif":
        raise UserError(f'--movie: expected a file name that ends in .gif, got "{movie}"')
    if is_unscored(run_dir):
        from sboc_e2e.outside.page import write_report as write_page

        if movie is not None:
            raise UserError(f"--movie: {run_dir} holds frames from outside, which no run kept; expected a run of `sboc run`")
        typer.echo(write_page(RunFound.of(run_dir)))
        return
    _stage("report", run_dir, plugin)
    typer.echo(run_dir / "report.html")
    if movie is not None:
        from sboc_e2e.report.movie import write_movie

        write_movie(run_dir, movie)
        typer.echo(movie)


@app.command()
def process(
    folder: Annotated[Path, typer.Argument(metavar="FITS_DIR", help="folder of FITS files, or one file")],
    out: Annotated[Path, typer.Option("--out", help="directory for the products")],
    camera: Annotated[str | None, typer.Option("--camera", help="instrument preset; without one a camera is guessed")] = None,
    wcs: Annotated[str, typer.Option("--wcs", help="sky positions: header, solve or none")] = "header",
    overrides: Overrides = None,
    use: Uses = None,
    plugin: Plugins = None,
    force: Annotated[bool, typer.Option("--force", help="replace earlier products")] = False,
) -> None:
    """Process frames from outside: on board and on ground, without truth."""
    from sboc_e2e.outside.memory import keep_freed_memory, uncollected

    if wcs not in WCS_CHOICES:
        raise UserError(f'--wcs: expected one of {", ".join(WCS_CHOICES)}, got "{wcs[:40]}"')
    with uncollected(), ExitStack() as stack:
        from sboc_e2e.outside.first_frame import FirstFrame
        from sboc_e2e.outside.fits_frames import FitsFolder
        from sboc_e2e.outside.lone_frame import begun

        source = FitsFolder(path=folder, use_wcs=wcs == "header")
        first = stack.enter_context(begun(source, alone=wcs != "solve", guessed=camera is None))
        # A large frame is read beside the following imports and what comes before the frame.
        from sboc_e2e import scenario as scenarios
        from sboc_e2e.outside.process import base_document
        from sboc_e2e.outside.process import process as execute

        registry = registry_of(plugin)
        resolved = scenarios.bare(
            "process", base_document(wcs), registry=registry, overrides=overrides or (), use=parsed_uses(use)
        )
        beside = stack.pop_all()
    with beside, shown_progress() as progress:
        if isinstance(first, FirstFrame) and first.is_beside:
            # else the frame is small, or so large that its memory counts more than its time
            first.wait()
            keep_freed_memory()
        at = folder.parent if folder.is_file() else folder
        execute(
            source,
            resolved,
            out,
            camera=camera,
            solve=wcs == "solve",
            folder=at,
            begun=first,
            force=force,
            registry=registry,
            progress=progress,
        )
    from sboc_e2e.outside.found import RunFound, closing_text
    from sboc_e2e.outside.page import write_report as write_page

    found = RunFound.of(out)
    typer.echo(closing_text(found))
    typer.echo(write_page(found))


@app.command()
def check(
    path: Annotated[str, typer.Argument(metavar="MODULE:CLASS", help="the class of a step, in an installed or local module")],
    seam: Annotated[str | None, typer.Option("--seam", help="the seam it is for, where its methods do not tell")] = None,
    shape: Annotated[str, typer.Option("--shape", help="rows x columns of the frame for the question of speed")] = "1024x1024",
) -> int:
    """Examine a plug-in: bad frames, untouched input, determinism, speed, and how well it does on trails of stated S/N."""
    from sboc_e2e.checks import examine

    rows, _, cols = shape.partition("x")
    if not (rows.isdecimal() and cols.isdecimal() and min(int(rows), int(cols)) >= 256 and max(int(rows), int(cols)) <= 16384):
        raise UserError(f'--shape: expected ROWSxCOLS from 256x256 to 16384x16384, such as 4096x4096, got "{shape[:40]}"')
    place, verdicts = examine(path, Registry(), seam, (int(rows), int(cols)))
    typer.echo(f"{path} as {place.name}")
    for verdict in verdicts:
        typer.echo(
            f"  {'pass' if verdict.passed else 'FAIL'}  {verdict.question}{': ' if verdict.detail else ''}{verdict.detail}"
        )
    failed = sum(not verdict.passed for verdict in verdicts)
    typer.echo(f"{len(verdicts) - failed} of {len(verdicts)} passed")
    return 1 if failed else 0


@app.command()
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from sboc_e2e.scenario import schema as scenario_schema

    typer.echo(scenario_schema.text(), nl=False)


@scenarios_app.callback(invoke_without_command=True)
def scenarios(context: typer.Context) -> None:
    """List the scenarios that come with the project."""
    from sboc_e2e import scenario

    if context.invoked_subcommand is None:
        for name, description in scenario.available().items():
            typer.echo(f"{name:23} {description}")


@scenarios_app.command("show")
def scenarios_show(
    scenario: Annotated[str, typer.Argument(help="a name of `sboc scenarios` or the path of a TOML file")],
    overrides: Overrides = None,
    use: Uses = None,
    plugin: Plugins = None,
) -> None:
    """Print a scenario with every key: value, meaning, range, and whether file, preset or command line gave it.

    It ends with a refusal where the exposure or the read-out does not fit the frame rate, or the camera rolls too far in a frame.
    """
    from sboc_e2e import scenario as scenario_files
    from sboc_e2e.icd.errors import UserError
    from sboc_e2e.scenario import shown

    resolved = scenario_files.load(scenario, registry=registry_of(plugin), overrides=overrides or (), use=parsed_uses(use))
    typer.echo(shown.text(resolved), nl=False)
    try:
        resolved.simulator.refuse_bad_timing()
    except UserError as error:
        raise UserError(f"scenario {resolved.name}: {resolved.told(str(error))}") from error


@catalogue_app.command("build")
def catalogue_build(
    source: Annotated[Path, typer.Argument(help="folder with tyc2.dat.00 ... and suppl_1.dat, or a Gaia table")],
    out: Annotated[Path, typer.Option("--out", help="catalogue file to write (.npz)")],
    depth: Annotated[float, typer.Option("--depth", help="faintest V of Tycho-2 stars, 99: all")] = 99.0,
) -> None:
    """Pack Tycho-2 to a depth, or a table with Gaia's column names, into a catalogue file."""
    from sboc_e2e.catalogue import build

    n_stars = build.build_tycho2(source, out, depth) if source.is_dir() else build.import_gaia(source, out)
    typer.echo(f"{out}: {n_stars} stars")
