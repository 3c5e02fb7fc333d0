"""Commands for frames from outside: looking at them, making a camera of them."""

import os
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Final

import typer

from sboc_e2e.cli.application import app, shown_progress
from sboc_e2e.icd.errors import UserError

camera_app = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Cameras of frames from outside.")
app.add_typer(camera_app, name="camera")

ENDINGS: Final = (".fits", ".fit", ".fts", ".fz", ".gz", ".bz2", ".xz", ".z", ".zip")
"""What names of FITS files and of compressed ones end in; any other dot belongs to the name, as in `m31.r.fits`."""
MOST_CHARACTERS: Final = 60
"""Of a file's name in that of its folder: 240 bytes at most, where file systems allow 255."""


@app.command()
def view(
    path: Annotated[Path, typer.Argument(metavar="RUN_DIR|FITS", help="a run, or a FITS file, which is processed first")],
    out: Annotated[Path | None, typer.Option("--out", help="folder for what is written, default RUN_DIR/view")] = None,
    samp: Annotated[bool, typer.Option("--samp/--no-samp", help="send frames to DS9, Aladin, TOPCAT where a hub runs")] = True,
    browser: Annotated[bool, typer.Option("--browser", help="make a page of all frames and open it")] = False,
    show: Annotated[bool, typer.Option("--open/--no-open", help="whether --browser opens its page")] = True,
) -> None:
    """Show frames with what was measured: DS9 regions and VOTables beside each frame, SAMP, a page in the browser."""
    from sboc_e2e.view import Hub, RunFrames, send, write_files, write_page

    run = RunFrames(path=_processed(path) if path.is_file() else path)
    folder = out or run.path / "view"
    written = write_files(run, folder)
    typer.echo(f"{folder}: regions and tables of {len(written)} frames")
    if samp:
        try:
            with Hub() as hub:
                send(hub, written)
            typer.echo("\n".join([f"SAMP: {hub.taken} messages taken", *hub.remarks]))
        except UserError as error:
            typer.echo(str(error))
    if browser:
        page = write_page(run, folder)
        typer.echo(page)
        if show:
            typer.launch(page.resolve().as_uri())


def folder_of(path: Path) -> Path:
    """The run directory of a FITS file that is viewed: by its name, and by a digest of where it lies."""
    name = path.name
    while (ending := next((end for end in ENDINGS if name.lower().endswith(end)), "")) and len(name) > len(ending):
        name = name[: -len(ending)]
    return Path("runs") / f"view-{name[:MOST_CHARACTERS]}-{sha256(os.fsencode(path.resolve())).hexdigest()[:8]}"


def _processed(path: Path) -> Path:
    """The run of a FITS file, made beside the working directory's other runs."""
    from sboc_e2e import scenario as scenarios
    from sboc_e2e.outside.fits_frames import FitsFolder
    from sboc_e2e.outside.process import base_document, process
    from sboc_e2e.registry import Registry

    registry, out = Registry(), folder_of(path)
    resolved = scenarios.bare("process", base_document("header"), registry=registry)
    with shown_progress() as progress:
        process(
            FitsFolder(path=path),
            resolved,
            out,
            camera=None,
            folder=path.parent,
            force=True,
            registry=registry,
            progress=progress,
        )
    return out


@camera_app.command("make")
def camera_make(
    frames: Annotated[list[Path], typer.Argument(metavar="FITS...", help="frames of one camera, two or more for gain and noise")],
    out: Annotated[Path, typer.Option("--out", help="camera file to write (.toml), for `sboc process --camera`")],
    hdu: Annotated[
        list[int] | None,
        typer.Option("--hdu", help="image of each file, by its HDU; may be repeated for exposures of one camera"),
    ] = None,
    width: Annotated[float | None, typer.Option("--width", help="width of the field over its columns (deg), if known")] = None,
    bias: Annotated[float | None, typer.Option("--bias", help="level without light in ADU, if no overscan tells it")] = None,
    search: Annotated[bool, typer.Option("--search", help="try all widths of 1.6 to 60 deg by star patterns: minutes")] = False,
) -> None:
    """Make a camera of its frames: PSF, gain and noise, saturation, plate scale."""
    from sboc_e2e.files.atomic import require_writable, write_text
    from sboc_e2e.outside.make_camera import made_camera, toml_text

    # before the work, which takes minutes
    if out.is_dir():
        raise UserError(f"{out}: Is a directory; a file is needed there")
    require_writable(out.parent)
    made = made_camera(frames, hdus=hdu or (), width_deg=width, bias_adu=bias, search=search)
    write_text(out, toml_text(made))
    for line in made.words():
        typer.echo(line)
    typer.echo(out)
