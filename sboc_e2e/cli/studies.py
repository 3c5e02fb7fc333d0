"""Commands that run many runs: comparisons, campaigns, the benchmark report."""

from pathlib import Path
from typing import Annotated

import typer

from sboc_e2e.cli.application import CHECK_FAILED, Overrides, Plugins, Workers, app, registry_of, shown_progress


@app.command()
def compare(
    scenario: Annotated[str, typer.Argument(help="a name of `sboc scenarios` or the path of a TOML file")],
    seam: Annotated[str, typer.Option("--seam", help="the step to exchange, such as onboard.detector")],
    use: Annotated[list[str], typer.Option("--use", help="a choice: a name or module:Class; give two or more")],
    seeds: Annotated[int, typer.Option("--seeds", help="how many seeds, from the scenario's on")] = 1,
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/compare-<scenario>")] = None,
    overrides: Overrides = None,
    plugin: Plugins = None,
    workers: Workers = 0,
    force: Annotated[bool, typer.Option("--force", help="run everything again, whatever earlier comparisons left")] = False,
) -> None:
    """Judge choices of one step on the same frames: paired differences, curves, a gallery, what each costs."""
    from sboc_e2e.compare import Request
    from sboc_e2e.compare import compare as execute

    target = out or Path("runs") / f"compare-{Path(scenario).stem}"
    request = Request(
        scenario=scenario, seam=seam, choices=tuple(use), seeds=seeds, overrides=tuple(overrides or ()), workers=workers
    )
    with shown_progress() as progress:
        execute(request, target, registry_of(plugin), progress, force=force)
    typer.echo((target / "compare.md").read_text())
    typer.echo(target / "compare.html")


@app.command()
def figure(
    number: Annotated[int, typer.Argument(min=5, max=8, help="5 curved streak, 6 row times, 7 both shutters, 8 particles")],
    out: Annotated[Path, typer.Option("--out", help="folder of the picture")] = Path("runs/figures"),
) -> None:
    """Draw one of the figures 5 to 8 of the paper on the ART/SPOOK simulator, its panels side by side, as a PNG."""
    from sboc_e2e.report.paper_figures import write_figure

    typer.echo(write_figure(number, out))


@app.command()
def sweep(
    campaign: Annotated[str, typer.Argument(help="a campaign file, or the name of a shipped one such as threshold_froc")],
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/sweep-<campaign>")] = None,
    overrides: Overrides = None,
    plugin: Plugins = None,
    replicas: Annotated[int | None, typer.Option("--replicas", help="replaces the campaign's number of replicas")] = None,
    workers: Workers = 0,
    scheduler: Annotated[str | None, typer.Option("--scheduler", help='dask scheduler "tcp://host:port", or "local"')] = None,
    force: Annotated[bool, typer.Option("--force", help="forget what another campaign left in the folder")] = False,
) -> None:
    """Run a campaign over scenario keys; finished tasks are kept, so the same command goes on after an interruption."""
    from sboc_e2e.campaign import read_campaign, run_campaign
    from sboc_e2e.campaign.pages import write_results

    plan = read_campaign(campaign).reduced(replicas, overrides or ())
    target = out or Path("runs") / f"sweep-{plan.name}"
    result = run_campaign(
        plan, target, workers=workers or None, scheduler=scheduler, registry=registry_of(plugin), force=force, report=typer.echo
    )
    write_results(plan, result, target)
    typer.echo(f"{result.done} done, {result.skipped} were done before, {len(result.failed)} failed, {result.wall_s:.1f} s")
    typer.echo(target / "campaign.html")
    if result.failed:
        raise typer.Exit(CHECK_FAILED)


@app.command()
def bench(
    quick: Annotated[bool, typer.Option("--quick", help="the subset for CI, four to eight minutes on two cores")] = False,
    check: Annotated[bool, typer.Option("--check", help="fail when a figure is worse than the committed baseline")] = False,
    peers: Annotated[bool, typer.Option("--peers", help="also peers that live in an environment of their own")] = False,
    long: Annotated[bool, typer.Option("--long", help="the soak of thousands of frames in full: hours")] = False,
    only: Annotated[list[str] | None, typer.Option("--only", help="a part, such as orbit; may be repeated")] = None,
    write_baseline: Annotated[bool, typer.Option("--write-baseline", help="make these figures the baseline")] = False,
    stored: Annotated[Path | None, typer.Option("--report", help="check this report.json instead of measuring")] = None,
    baseline: Annotated[Path | None, typer.Option("--baseline", help="baseline of --report, default the committed one")] = None,
    out: Annotated[Path, typer.Option("--out", help="folder of the report")] = Path("bench/out"),
) -> None:
    """Measure everything the project claims: report.json, report.md, report.html. Says what it costs before it starts."""
    from sboc_e2e.bench import check_report, run_bench

    if stored is not None:
        found = check_report(stored, baseline)
    else:
        found = run_bench(
            out, quick=quick, peers=peers, long=long, only=tuple(only or ()), check=check, rewrite_baseline=write_baseline,
            report=typer.echo,
        )  # fmt: skip
        typer.echo(out / "report.html")
    for regression in found:
        typer.echo(f"regression: {regression}", err=True)
    if found:
        raise typer.Exit(CHECK_FAILED)


@app.command()
def plan(
    request: Annotated[str, typer.Argument(metavar="PLAN", help="a plan's file, or the name of a shipped one such as geo_fence")],
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/plan-<plan>")] = None,
    overrides: Annotated[list[str] | None, typer.Option("--set", help="override a key of the plan, such as plan.days=2")] = None,
    plugin: Plugins = None,
) -> None:
    """Plan observations: where to point and when, so that orbits become known best or nothing crosses a fence unseen."""
    from sboc_e2e.planning import make_plan, read_request

    asked, path = read_request(request, overrides or ())
    target = out or Path("runs") / f"plan-{path.stem}"
    make_plan(asked, path, target, registry_of(plugin))
    typer.echo((target / "plan.md").read_text())
    typer.echo(target / "schedule.ecsv")


@app.command()
def response(
    scenario: Annotated[str, typer.Argument(help="a name of `sboc scenarios` or the path of a TOML file")],
    runs: Annotated[int, typer.Option("--runs", min=1, max=10000, help="runs of the pixel chain, each with its own seed")] = 20,
    judge: Annotated[int, typer.Option("--judge", min=0, max=10000, help="other runs that say whether it holds")] = 0,
    sky: Annotated[
        list[str] | None,
        typer.Option("--sky", help="KEY=VALUE of another sky, such as sky.zodiacal=10; every other run is below one"),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/response-<scenario>")] = None,
    overrides: Overrides = None,
    plugin: Plugins = None,
    workers: Workers = 0,
    scheduler: Annotated[str | None, typer.Option("--scheduler", help='dask scheduler "tcp://host:port", or "local"')] = None,
) -> None:
    """Measure what a survey needs to know of camera and software, by runs of the pixel chain: response.json."""
    from sboc_e2e import scenario as scenarios
    from sboc_e2e.survey.measure import judge_response, measure_response

    resolved = scenarios.load(scenario, registry=registry_of(plugin), overrides=overrides or ())
    target = out or Path("runs") / f"response-{resolved.name}"
    skies = {
        text: scenarios.load(scenario, registry=registry_of(plugin), overrides=[*(overrides or ()), text]) for text in sky or ()
    }
    path, failed = measure_response(resolved, runs, target, skies, workers=workers, scheduler=scheduler, report=typer.echo)
    typer.echo(path)
    if judge:
        typer.echo(judge_response(resolved, judge, target, workers=workers, scheduler=scheduler, report=typer.echo).read_text())
    if failed:
        raise typer.Exit(CHECK_FAILED)


@app.command()
def survey(
    scenario: Annotated[str, typer.Argument(help="a name of `sboc scenarios` or the path of a TOML file")],
    days: Annotated[float, typer.Option("--days", help="from the scenario's epoch on; whole quarters of days are made")] = 365.0,
    response_file: Annotated[
        Path | None, typer.Option("--response", help="file of `sboc response`, default the shipped one of the scenario")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/survey-<scenario>")] = None,
    seed: Annotated[int | None, typer.Option("--seed", help="replaces the scenario's seed")] = None,
    overrides: Overrides = None,
    plugin: Plugins = None,
    workers: Workers = 0,
    scheduler: Annotated[str | None, typer.Option("--scheduler", help='dask scheduler "tcp://host:port", or "local"')] = None,
    learn: Annotated[bool, typer.Option("--report", help="also say what it teaches: survey.md, flux.ecsv, pictures")] = False,
    force: Annotated[bool, typer.Option("--force", help="forget what another survey left in the folder")] = False,
) -> None:
    """Months of tracklets without pixels; finished blocks are kept, so the same command goes on after an interruption."""
    from sboc_e2e import scenario as scenarios
    from sboc_e2e.run.workers import worker_count
    from sboc_e2e.survey import response as responses
    from sboc_e2e.survey.engine import run_survey

    resolved = scenarios.load(scenario, registry=registry_of(plugin), overrides=overrides or (), seed=seed)
    measured = responses.read(response_file or responses.shipped(resolved), resolved)
    target = out or Path("runs") / f"survey-{resolved.name}"
    result = run_survey(
        resolved, measured, days, target, workers=worker_count(workers), scheduler=scheduler, force=force, report=typer.echo
    )
    typer.echo(
        f"{result.done} blocks done, {result.skipped} were done before, {len(result.failed)} failed, {result.wall_s:.1f} s"
    )
    if result.failed:
        raise typer.Exit(CHECK_FAILED)
    if learn:
        from sboc_e2e.survey.report import write_reports

        for page in write_reports(target, resolved, measured, overrides or (), registry_of(plugin)):
            typer.echo(page.read_text())
    typer.echo(target)
