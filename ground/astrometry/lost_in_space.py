"""Attitude without telemetry: star patterns in a database made from the catalogue (extra `solve`, package tetra3rs).

The pattern solver (tetra3: Pedrotti et al., European Space Agency) gives the attitude to some ten arcsec; matching and
camera fit then continue as with a telemetered attitude. Patterns are ratios of distances, which a mirror does not change.
The solver therefore also gives the parity of the image, and the scale of an unknown camera.
"""

import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
"""Number of stars in an average field for which the database is made; it holds the brightest."""

BRIGHTEST_USED: Final = 80
"""A budget of work: patterns need a few bright stars, all of which the database has (`STARS_PER_FIELD`)."""
FIELD_TOLERANCE: Final = 0.02
"""The field's width is known to this share."""

FEWEST_STARS: Final = 8
"""Fewer stars than two patterns of four cannot confirm a match; chosen, not measured."""

HINT_TOLERANCE: Final = 0.15
"""A header's pixel scale or focal length is nominal: reducers, binning and rounded values lie within this share."""

DATABASES: Final = (
    (29.0, 40.0, 60.0), (20.0, 28.0, 40.0), (14.0, 19.0, 28.0), (9.6, 13.0, 19.0),
    (6.6, 9.0, 13.0), (4.4, 6.0, 9.0), (3.0, 4.0, 6.0), (2.0, 1.6, 4.0),
)  # fmt: skip
"""Width (deg) for which a pattern database is made, and the field widths that it serves. Patterns smaller than the field are
found more often (62 of 62 at 1.25 to 1.7 times the width, 58 of 62 at 0.9). Narrow ones take long to make (2 deg: 50 s)."""

NARROWEST_DEG: Final = DATABASES[-1][1]
"""Narrower fields hold too few stars of a catalogue to V = 11 for patterns, and their database would not fit into memory."""

PATTERNS_PER_FIELD: Final = 50
"""More make the database larger. The share solved (see `DATABASES`) holds for this number; others were not measured."""

SOLVER_STAR: Final = np.dtype(
    [("number", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("mag", "<f4"), ("pm_ra", "<f4"), ("pm_dec", "<f4")]
)
"""One star of the solver's table: 36 bytes, after a header of magic, version and count."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PatternMatch:
    """Matrix (3, 3), GCRS to camera frame; whether the image is mirrored (`Camera`); focal length of its width."""

    matrix: Array
    mirrored: bool
    focal_px: float


def find_attitude(
    stars: StarList, camera: Camera, cols: int, rows: int, catalogue: StarCatalogue, folder: str
) -> PatternMatch | None:
    """Attitude and parity of a star list; None when no pattern fits.

    folder : where the pattern database is kept from run to run; empty: made anew in memory. Aberration (20 arcsec) is not in it.
    Raises `UserError` when the extra is not installed.
    """
    vectors = replace(camera, mirrored=False).unproject(stars.row, stars.col)
    plane = camera.focal_px * vectors[:, :2] / vectors[:, 2:]
    width_deg = width_of(camera.focal_px, cols)
    return _matched(plane, stars.flux_e, (rows, cols), width_deg, FIELD_TOLERANCE * width_deg, catalogue, folder)


@dataclass(frozen=True, kw_only=True, eq=False)
class StarField:
    """Stars of an image of an unknown camera: places (n,) in px, light (n,) in any unit, and the image's size."""

    row: Array
    col: Array
    flux: NDArray[np.floating[Any]]
    rows: int
    cols: int


def find_scale(fields: Sequence[StarField], hints_px: Sequence[float], catalogue: StarCatalogue) -> PatternMatch | None:
    """The first of some images of one unknown camera that a pattern fits; None when none does.

    hints_px : focal lengths to try before all widths. Raises `UserError` when the extra is not installed.
    """
    hinted = [width_of(focal_px, fields[0].cols) for focal_px in hints_px]
    if hinted and max(hinted) < NARROWEST_DEG:
        return None
    trials = [(width_deg, HINT_TOLERANCE * width_deg) for width_deg in hinted]
    trials += [(0.5 * (low_deg + high_deg), 0.5 * (high_deg - low_deg)) for _, low_deg, high_deg in DATABASES]
    for width_deg, error_deg in trials:
        for field in fields:
            plane = np.stack((field.col - 0.5 * (field.cols - 1), field.row - 0.5 * (field.rows - 1)), axis=1)
            found = _matched(plane, field.flux, (field.rows, field.cols), width_deg, error_deg, catalogue, "")
            if found is not None:
                return found
    return None


def width_of(focal_px: float, cols: int) -> float:
    """Width (deg) of the field over all columns."""
    return float(np.degrees(2.0 * np.arctan(0.5 * cols / focal_px)))


def _matched(
    plane: Array,
    flux: NDArray[np.floating[Any]],
    shape: tuple[int, int],
    width_deg: float,
    error_deg: float,
    catalogue: StarCatalogue,
    folder: str,
) -> PatternMatch | None:
    """Match of the patterns of stars at (n, 2) x, y (px from the axis, free of distortion)."""
    solver = required_solver()
    if width_deg < NARROWEST_DEG or len(plane) < FEWEST_STARS:
        return None
    made_for_deg = next(made_for_deg for made_for_deg, low_deg, _ in DATABASES if width_deg >= low_deg)
    database = _database(made_for_deg, folder, catalogue.name, catalogue)
    if database is None:
        return None
    order = np.argsort(-flux, kind="stable")[:BRIGHTEST_USED]
    centroids = [
        solver.Centroid(x=float(x), y=float(y), brightness=float(f)) for (x, y), f in zip(plane[order], flux[order], strict=True)
    ]
    result = database.solve_from_centroids(
        centroids,
        fov_estimate_deg=width_deg,
        image_width=shape[1],
        image_height=shape[0],
        fov_max_error_deg=error_deg,
        solve_timeout_ms=None,
    )
    if not result:
        return None
    return PatternMatch(
        matrix=np.asarray(result.rotation_matrix_icrs_to_camera, dtype=np.float64),
        mirrored=bool(result.parity_flip),
        focal_px=float(0.5 * shape[1] / np.tan(np.radians(0.5 * result.fov_deg))),
    )


def installed() -> bool:
    """Whether the extra `solve` is there."""
    return find_spec("tetra3rs") is not None


def required_solver() -> Any:
    """The optional package. Raises `UserError` where it is not installed."""
    try:
        import tetra3rs  # the extra `solve`
    except ImportError as error:
        raise UserError("ground.astrometry.lost_in_space: needs the extra `solve`: pip install 'sboc-e2e[solve]'") from error
    return tetra3rs


@lru_cache(maxsize=2)
def _database(width_deg: float, folder: str, name: str, catalogue: StarCatalogue) -> Any:
    """The pattern database for a field width: read from `folder`, or made (1 to 40 s, once per process) and kept there.

    None where the catalogue has no star whose motion is known.
    """
    solver = required_solver()
    path = Path(folder) / f"patterns-{name.replace(' ', '-').lower()}-{width_deg:.1f}deg.bin"
    if folder and path.is_file():
        try:
            return solver.SolverDatabase.load_from_file(str(path))
        except Exception as error:
            raise UserError(f"{path}: not a readable pattern database ({error}); delete it, it is made again") from error
    with tempfile.TemporaryDirectory() as work:
        table = Path(work) / "stars.bin"
        v_max = _write_stars(table, catalogue, width_deg)
        if v_max is None:
            return None
        made = solver.SolverDatabase.generate_from_gaia(
            catalog_path=str(table),
            max_fov_deg=width_deg,
            min_fov_deg=width_deg,
            star_max_magnitude=v_max,
            patterns_per_lattice_field=PATTERNS_PER_FIELD,
            # more and fainter stars make more patterns of narrow fields: as few as still solved every trial
            lattice_field_oversampling=int(np.clip(2.0 * width_deg**2, 8, 100)),
        )
    if folder:
        partial = path.with_name(path.name + ".part")
        try:
            made.save_to_file(str(partial))
            partial.replace(path)
        except OSError as error:
            raise UserError(f"{folder}: the pattern database cannot be written there ({error.strerror})") from error
    return made


def _write_stars(path: Path, catalogue: StarCatalogue, width_deg: float) -> float | None:
    """Bright reference stars in the binary form that the solver reads; returns their faintest magnitude, None without stars.

    Positions are of 2027, without proper motion. In a decade few stars move by more than the solver's tolerance.
    """
    stars = catalogue.cone(0.0, 0.0, 180.0, epoch_jyear=2027.0)
    stars = stars.take((stars.flags & int(CatalogueFlag.NO_PROPER_MOTION)) == 0)
    if len(stars) == 0:
        return None
    wanted = round(STARS_PER_FIELD * 41253.0 / width_deg**2)
    v_max = float(np.sort(stars.v_mag)[min(wanted, len(stars)) - 1])
    stars = stars.take(stars.v_mag <= v_max)
    records = np.zeros(len(stars), dtype=SOLVER_STAR)
    records["number"], records["ra"], records["dec"] = np.arange(1, len(stars) + 1), stars.ra_deg, stars.dec_deg
    records["mag"] = stars.v_mag
    path.write_bytes(struct.pack("<4sIQ", b"GDR3", 1, len(stars)) + records.tobytes())
    return v_max
