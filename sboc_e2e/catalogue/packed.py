"""The compact catalogue file: an npz whose columns are fixed-point numbers split into byte planes.

Stars are in HEALPix order (NSIDE 64, NESTED), by magnitude within a pixel. Column -> unit of the stored integer:

    ra, dec+90        uint32   360 deg / 2**32 (0.30 mas)        v_mag    int16   1 mmag
    pm_ra, pm_dec     int16    0.1 mas/yr; larger values are in a side table (row, int32, int32)
    b_v               int16    5 mmag                            flags    uint8   CatalogueFlag
    sigma             uint8    1 mas at the mean epoch           sigma_pm uint8   0.1 mas/yr (255: 25.5 or more)
    mean_epoch        uint8    year - 1850                       source_id int64   (its empty high bytes cost nothing)
    hip               side table (row, number)                   counts           uint16 stars of each pixel

One plane per byte compresses better than whole numbers, because high bytes hardly change along the sky order.
"""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.catalogue.healpix import N_PIXELS, pixel_of

FORMAT: Final = "sboc-star-catalogue-1"
ANGLE_UNITS_PER_DEG: Final = 2.0**32 / 360.0  # The circle fills 32 bits: a unit is 0.30 mas, less than the 1 mas unit of `sigma`.
PM_UNIT_MAS_YR: Final = 0.1  # Tycho-2 prints its proper motions in this step (CDS I/259, bytes 42-56).
V_UNIT_MAG: Final = 0.001  # Tycho-2 prints its magnitudes in this step (CDS I/259, bytes 111-129).
B_V_UNIT_MAG: Final = 0.005  # A rounding error of 1.4 mmag rms (step / sqrt(12)), below the errors of Tycho-2's colours.
SIGMA_UNIT_MAS: Final = 1.0
"""Tycho-2 prints mean errors of positions in this step (CDS I/259, bytes 58-64); the largest stored is 192."""
SIGMA_PM_UNIT_MAS_YR: Final = 0.1
"""Tycho-2 prints them in this step (CDS I/259, bytes 66-74); 56 of 945,994 stars have 25.5 or more."""
EPOCH_ZERO_JYEAR: Final = 1850.0  # A byte holds mean epochs from 1850 to 2105; those of the embedded stars are 1917 to 1992.

_DTYPES: Final[dict[str, str]] = {
    "ra": "<u4", "dec": "<u4", "pm_ra": "<i2", "pm_dec": "<i2", "v_mag": "<i2", "b_v": "<i2", "flags": "<u1",
    "sigma": "<u1", "sigma_pm": "<u1", "mean_epoch": "<u1", "source_id": "<i8",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class RawStars:
    """Stars as a source catalogue gives them, in any order; columns of equal length.

    ra_deg, dec_deg : ICRS at `epoch_jyear`; proper motions NaN where unknown; sigma_mas : error of a coordinate at its
    mean epoch `mean_epoch_jyear`; sigma_pm_mas_yr : error of the proper motion; hip : 0 for none.
    """

    epoch_jyear: float
    ra_deg: NDArray[np.float64]
    dec_deg: NDArray[np.float64]
    pm_ra_mas_yr: NDArray[np.float64]
    pm_dec_mas_yr: NDArray[np.float64]
    v_mag: NDArray[np.float64]
    b_v: NDArray[np.float64]
    sigma_mas: NDArray[np.float64]
    sigma_pm_mas_yr: NDArray[np.float64]
    mean_epoch_jyear: NDArray[np.float64]
    flags: NDArray[np.uint8]
    source_id: NDArray[np.int64]
    hip: NDArray[np.int32]


def write_packed(path: Path, raw: RawStars, *, name: str, provenance: str, v_max: float) -> int:
    """Write the stars brighter than `v_max` to `path` (through a temporary name); returns their number."""
    pixel = pixel_of(raw.ra_deg, raw.dec_deg)
    usable = np.isfinite(raw.v_mag) & (raw.v_mag < v_max)
    # ties of magnitude are broken by identifier, so that the bytes do not depend on the order of the source
    order = np.lexsort((raw.source_id, raw.v_mag, pixel))
    order = order[usable[order]]

    pm = np.stack((raw.pm_ra_mas_yr, raw.pm_dec_mas_yr), axis=1)[order]
    pm_units = np.rint(np.nan_to_num(pm) / PM_UNIT_MAS_YR).astype(np.int32)
    too_fast = np.flatnonzero(np.abs(pm_units).max(axis=1, initial=0) > 32767)
    pm_units_16 = np.clip(pm_units, -32767, 32767)
    has_hip = np.flatnonzero(raw.hip[order] > 0)
    integers = {
        "ra": np.rint(raw.ra_deg[order] % 360.0 * ANGLE_UNITS_PER_DEG).astype(np.uint64) % 2**32,
        "dec": np.rint((raw.dec_deg[order] + 90.0) * ANGLE_UNITS_PER_DEG),
        "pm_ra": pm_units_16[:, 0],
        "pm_dec": pm_units_16[:, 1],
        "v_mag": np.rint(raw.v_mag[order] / V_UNIT_MAG),
        "b_v": np.rint(raw.b_v[order] / B_V_UNIT_MAG),
        "flags": raw.flags[order],
        "sigma": np.clip(np.rint(raw.sigma_mas[order] / SIGMA_UNIT_MAS), 1, 255),
        "sigma_pm": np.clip(np.rint(raw.sigma_pm_mas_yr[order] / SIGMA_PM_UNIT_MAS_YR), 0, 255),
        "mean_epoch": np.clip(np.rint(raw.mean_epoch_jyear[order] - EPOCH_ZERO_JYEAR), 0, 255),
        "source_id": raw.source_id[order],
    }
    planes: dict[str, Any] = {key: _to_planes(values.astype(_DTYPES[key])) for key, values in integers.items()}
    temporary = path.with_name(path.name + ".part")
    with temporary.open("wb") as stream:
        np.savez_compressed(
            stream,
            format=np.array(FORMAT),
            name=np.array(name),
            provenance=np.array(provenance),
            epoch_jyear=np.array(raw.epoch_jyear),
            v_max=np.array(v_max),
            counts=np.bincount(pixel[order], minlength=N_PIXELS).astype("<u4"),
            fast_row=too_fast.astype("<u4"),
            fast_pm=pm_units[too_fast].astype("<i4"),
            hip_row=np.diff(has_hip, prepend=0).astype("<u4"),
            hip_number=raw.hip[order][has_hip].astype("<i4"),
            **planes,
        )
    temporary.replace(path)
    return len(order)


def read_packed(path: Path) -> dict[str, NDArray[Any]]:
    """Integer columns, side tables and texts of a packed file.

    Raises ValueError, with the reason, for what is not a whole, well-formed file of this format.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            if "format" not in archive.files or str(archive["format"]) != FORMAT:
                raise ValueError("not a star catalogue of this program")
            content = {key: archive[key] for key in archive.files}
        for key, dtype in _DTYPES.items():
            content[key] = _from_planes(content[key], dtype)
        n_stars = int(content["counts"].sum())
        if content["counts"].shape != (N_PIXELS,) or any(len(content[key]) != n_stars for key in _DTYPES):
            raise ValueError("columns differ in length")
    except (OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"truncated or corrupt ({error})") from error
    return content


def _to_planes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Bytes of (n,) little-endian integers as (bytes, n)."""
    return np.ascontiguousarray(values.view(np.uint8).reshape(len(values), values.dtype.itemsize).T)


def _from_planes(planes: NDArray[np.uint8], dtype: str) -> NDArray[Any]:
    """Inverse of `_to_planes`."""
    if planes.dtype != np.uint8 or planes.ndim != 2 or planes.shape[0] != np.dtype(dtype).itemsize:
        raise ValueError("byte planes of an unexpected shape")
    return np.ascontiguousarray(planes.T).view(dtype)[:, 0]
