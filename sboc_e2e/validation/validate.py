"""A comparison of a simulated image with a real one, from the command to the files that hold it."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files.atomic import write_bytes, write_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.validation.figures import Validation, compare
from sboc_e2e.validation.page import page, picture
from sboc_e2e.validation.subjects import from_fits, from_scenario, is_fits


@dataclass(frozen=True, kw_only=True)
class Request:
    """What to compare. simulated : scenario name, scenario path or FITS file. hdu : of the real file, None for the first image.
    frame : of the scenario."""

    simulated: str
    real: Path
    hdu: int | None = None
    frame: int = 0
    overrides: tuple[str, ...] = field(default=())


def validate(request: Request, out: Path, registry: Registry) -> Validation:
    """Compare and write validation.json, .html and .png into `out`. Raises `UserError` for anything wrong with the input."""
    if out.exists() and not out.is_dir():
        raise UserError(f"--out {out}: is a file; allowed is a folder, which need not exist")
    if is_fits(request.simulated):
        _refuse_options_of_scenarios(request, registry)
    real = from_fits(request.real, request.hdu, StarCatalogue.embedded)
    if is_fits(request.simulated):
        simulated = from_fits(Path(request.simulated), None, StarCatalogue.embedded)
    else:
        simulated = from_scenario(request.simulated, request.frame, registry, request.overrides)
    result = compare(simulated, real)
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / "validation.json", json.dumps(result.figures, indent=1) + "\n")
    write_text(out / "validation.html", page(result))
    write_bytes(out / "validation.png", picture(result))
    return result


def _refuse_options_of_scenarios(request: Request, registry: Registry) -> None:
    """Refuse what changes a scenario where there is none: it would be ignored."""
    given = {"--set": request.overrides, "--frame": request.frame, "--plugin": registry.trusted_modules}
    for option, value in given.items():
        if value:
            raise UserError(f"{option}: has no effect on a FITS file; allowed with a scenario as SIM, got {request.simulated}")
