"""The command that sets a simulated frame beside a real one."""

from pathlib import Path
from typing import Annotated

import typer

from sboc_e2e.cli.application import Overrides, Plugins, app, registry_of


@app.command()
def validate(
    simulated: Annotated[str, typer.Argument(metavar="SIM", help="a scenario, by name or path, or a FITS file")],
    against: Annotated[Path, typer.Option("--against", help="FITS file of the real frame")],
    hdu: Annotated[int | None, typer.Option("--hdu", help="HDU of the real frame, default the first image")] = None,
    frame: Annotated[int, typer.Option("--frame", min=0, help="frame of the scenario")] = 0,
    out: Annotated[Path | None, typer.Option("--out", help="folder, default runs/validate-<sim>")] = None,
    overrides: Overrides = None,
    plugin: Plugins = None,
) -> None:
    """Compare a simulated frame with a real one: pixel values, noise spectrum, star counts, star widths, places of stars."""
    from sboc_e2e.validation import Request
    from sboc_e2e.validation import validate as execute

    target = out or Path("runs") / f"validate-{Path(simulated).stem}"
    request = Request(simulated=simulated, real=against, hdu=hdu, frame=frame, overrides=tuple(overrides or ()))
    execute(request, target, registry_of(plugin))
    typer.echo(target / "validation.html")
