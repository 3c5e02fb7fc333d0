"""Attitude without telemetry: star patterns in a database made from the catalogue (extra `solve`, package tetra3rs).

The pattern solver (tetra3: Pedrotti et al., European Space Agency) gives the attitude to some ten arcsec; matching and
camera fit then go on as if it had been telemetered.
"""

import struct
import tempfile
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.camera import Camera
from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.signals import StarList

Array = NDArray[np.float64]

STARS_PER_FIELD: Final = 100
"""The database holds the brightest stars, about so many in an average field."""

BRIGHTEST_USED: Final = 80
FIELD_TOLERANCE: Final = 0.02
"""The field's width is known to this share."""

TIMEOUT_MS: Final = 2000

SOLVER_STAR: Final = np.dtype(
    [("number", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("mag", "<f4"), ("pm_ra", "<f4"), ("pm_dec", "<f4")]
)
"""One star of the solver's table: 36 bytes, after a header of magic, version and count."""


def find_attitude(stars: StarList, camera: Camera, cols: int, rows: int, catalogue: StarCatalogue, folder: str) -> Array | None:
    """Matrix (3, 3), GCRS to camera frame, of a star list; None when no pattern fits.

    folder : where the pattern database is kept from run to run; empty: made anew in memory. Aberration (20 arcsec) is not in it.
    Raises `UserError` when the extra is not installed.
    """
    solver = _solver()
    width_deg = float(np.degrees(2.0 * np.arctan(0.5 * cols / camera.focal_px)))
    database = _database(round(width_deg, 1), folder, catalogue.name, catalogue)
    order = np.argsort(-stars.flux_e, kind="stable")[:BRIGHTEST_USED]
    vectors = camera.unproject(stars.row[order], stars.col[order])
    x, y = camera.focal_px * vectors[:, 0] / vectors[:, 2], camera.focal_px * vectors[:, 1] / vectors[:, 2]
    centroids = [
        solver.Centroid(x=float(a), y=float(b), brightness=float(f)) for a, b, f in zip(x, y, stars.flux_e[order], strict=True)
    ]
    result = database.solve_from_centroids(
        centroids,
        fov_estimate_deg=width_deg,
        image_width=cols,
        image_height=rows,
        fov_max_error_deg=FIELD_TOLERANCE * width_deg,
        solve_timeout_ms=TIMEOUT_MS,
    )
    if not result or result.parity_flip:
        return None
    return np.asarray(result.rotation_matrix_icrs_to_camera, dtype=np.float64)


def installed() -> bool:
    """Whether the extra `solve` is there."""
    return find_spec("tetra3rs") is not None


def _solver() -> Any:
    """The optional package."""
    try:
        import tetra3rs  # the extra `solve`
    except ImportError as error:
        raise UserError("ground.astrometry.lost_in_space: needs the extra `solve`: pip install 'sboc-e2e[solve]'") from error
    return tetra3rs


@lru_cache(maxsize=4)
def _database(width_deg: float, folder: str, name: str, catalogue: StarCatalogue) -> Any:
    """The pattern database for a field width: read from `folder`, or made (some seconds, once per process) and kept there."""
    solver = _solver()
    path = Path(folder) / f"patterns-{name.replace(' ', '-').lower()}-{width_deg:.1f}deg.bin"
    if folder and path.is_file():
        try:
            return solver.SolverDatabase.load_from_file(str(path))
        except Exception as error:
            raise UserError(f"{path}: not a readable pattern database ({error}); delete it, it is made again") from error
    with tempfile.TemporaryDirectory() as work:
        table = Path(work) / "stars.bin"
        v_max = _write_stars(table, catalogue, width_deg)
        made = solver.SolverDatabase.generate_from_gaia(
            catalog_path=str(table), max_fov_deg=width_deg, min_fov_deg=width_deg, star_max_magnitude=v_max
        )
    if folder:
        part = path.with_name(path.name + ".part")
        try:
            made.save_to_file(str(part))
            part.replace(path)
        except OSError as error:
            raise UserError(f"{folder}: the pattern database cannot be written there ({error.strerror})") from error
    return made


def _write_stars(path: Path, catalogue: StarCatalogue, width_deg: float) -> float:
    """Bright reference stars in the binary form that the solver reads; returns their faintest magnitude.

    Positions are those of 2027 with no motion: a decade moves few stars by more than the solver's tolerance.
    """
    stars = catalogue.cone(0.0, 0.0, 180.0, epoch_jyear=2027.0)
    stars = stars.take((stars.flags & int(CatalogueFlag.NO_PROPER_MOTION)) == 0)
    wanted = round(STARS_PER_FIELD * 41253.0 / width_deg**2)
    v_max = float(np.sort(stars.v_mag)[min(wanted, len(stars)) - 1])
    stars = stars.take(stars.v_mag <= v_max)
    records = np.zeros(len(stars), dtype=SOLVER_STAR)
    records["number"], records["ra"], records["dec"] = np.arange(1, len(stars) + 1), stars.ra_deg, stars.dec_deg
    records["mag"] = stars.v_mag
    path.write_bytes(struct.pack("<4sIQ", b"GDR3", 1, len(stars)) + records.tobytes())
    return v_max
