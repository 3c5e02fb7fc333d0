"""Errors of published directions, from the table beside a tracking message, as errors that each row has for itself."""

from pathlib import Path
from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

ERRORS_NAME: Final = "tdm_angles.ecsv"
_COLUMNS: Final = (
    "tracklet_id", "epoch_tai_ns", "sigma_along_arcsec", "sigma_cross_arcsec", "motion_angle_deg", "shared_group",
    "shared_1_arcsec", "shared_2_arcsec", "shared_3_arcsec",
)  # fmt: skip


def errors_of(path: Path) -> dict[int, Array]:
    """Of each tracklet (n, 3) in order of time: sigma along and across (arcsec) and position angle of the motion (rad).

    Empty without the file. A tracklet with an unknown error is left out. UserError for a table without the columns.

    Rows of a group are points of one fitted curve with k numbers: n of them hold k measurements. The store has only errors that
    rows have for themselves. Independent errors s make a curve of k numbers whose variances at its n points sum to k s^2 (the
    trace of a projection); hence ``s^2 = sum(shared^2) / k``, beside what is each row's own.
    """
    if not path.is_file():
        return {}
    try:
        found = Table.read(path, format="ascii.ecsv")
    except (ValueError, OSError) as error:
        raise UserError(f"{path}: not a table (ECSV): {str(error).splitlines()[0][:120]}") from error
    missing = [name for name in _COLUMNS if name not in found.colnames]
    if missing:
        raise UserError(f"{path}: without the columns {', '.join(missing)}; --sigma gives one error for all directions")
    out = {}
    for number in np.unique(found["tracklet_id"]):
        rows = found[found["tracklet_id"] == number]
        rows = rows[np.argsort(np.asarray(rows["epoch_tai_ns"]), kind="stable")]
        along, cross = (np.asarray(rows[f"sigma_{name}_arcsec"], dtype=float) for name in ("along", "cross"))
        shared = np.column_stack([np.asarray(rows[f"shared_{k}_arcsec"], dtype=float) for k in (1, 2, 3)])
        variance = np.column_stack([along, cross]) ** 2
        line = [f"shared_cross_{k}_arcsec" for k in (1, 2, 3)]
        if set(line) <= set(rows.colnames):  # tables of earlier versions have no members on lines
            on_line = np.column_stack([np.asarray(rows[name], dtype=float) for name in line])
            _own(variance[:, 1], on_line, np.asarray(on_line.any(axis=1)))
        for group in np.unique(rows["shared_group"]):
            if group >= 0:
                _own(variance[:, 0], shared, np.asarray(rows["shared_group"]) == group)
        angle = np.radians(np.asarray(rows["motion_angle_deg"], dtype=float))
        errors = np.column_stack([np.sqrt(variance), angle])
        if np.isfinite(errors).all() and (errors[:, :2] > 0.0).all():
            out[int(number)] = errors
    return out


def _own(variance: Array, shared: Array, mine: NDArray[np.bool_]) -> None:
    """Replace, in the variances (n,), what rows of one curve share (n, 3) by what each would have for itself."""
    numbers = int(np.linalg.matrix_rank(shared[mine])) if mine.any() else 0
    if numbers and mine.sum() > numbers:
        common = (shared[mine] ** 2).sum(axis=1)
        variance[mine] += common.sum() / numbers - common
