"""Reader of Tycho-2 (Hog et al. 2000, A&A 355, L27; CDS I/259): main catalogue and supplement 1, fixed-width records.

Known traps and what is done about them:

* 109,445 rows (pflag X) have no mean position: the observed position of about 1991.5 is taken; these and some others,
  122,527 in all, have no proper motion and are flagged NO_PROPER_MOTION: never reference stars.
* Rows measured in one band only get BT-VT = 0.7 (B-V 0.595) and the flag ONE_BAND.
* Arcturus has a second row in supplement 1, a spurious companion of the Hipparcos solution: it is left out. The other
  86 pairs of supplement 1 that share a Hipparcos number are real double stars: kept and flagged DOUBLE.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.catalogue.packed import RawStars
from sboc_e2e.catalogue.proper_motion import propagate
from sboc_e2e.catalogue.stars import CatalogueFlag
from sboc_e2e.icd.errors import UserError

MAIN_RECORD_BYTES: Final = 207  # 206 characters by the ReadMe of CDS I/259, and the end of the line.
SUPPLEMENT_RECORD_BYTES: Final = 123  # 122 characters by the ReadMe of CDS I/259, and the end of the line.
ASSUMED_BT_VT_MAG: Final = 0.7
"""Of stars measured in one band: B-V = 0.595. The median of the embedded catalogue is 0.68, so that V is off by 0.01 mag on
average."""
SUPPLEMENT_EPOCH_JYEAR: Final = 1991.25
"""Epoch of the supplement's positions, that of the Hipparcos catalogue (ReadMe of CDS I/259)."""
SPURIOUS_IDENTIFIER: Final = (1472 << 17) | (1436 << 3) | 2
"""The second row of Arcturus."""

Records = NDArray[np.uint8]
Columns = dict[str, NDArray[Any]]


def read_tycho2(source_dir: Path) -> RawStars:
    """All stars of `tyc2.dat.*` and `suppl_1.dat`, positions at J2000 (observed ones where there is no proper motion)."""
    main_files = sorted(source_dir.glob("tyc2.dat*"))
    supplement = source_dir / "suppl_1.dat"
    if not main_files or not supplement.is_file():
        raise UserError(f"Tycho-2 source {source_dir}: expected tyc2.dat.* and suppl_1.dat (CDS I/259)")
    parts = [_main_columns(_records(path, MAIN_RECORD_BYTES)) for path in main_files]
    parts.append(_supplement_columns(_records(supplement, SUPPLEMENT_RECORD_BYTES)))
    column = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}

    no_motion = np.isnan(column["pm_ra"]) | np.isnan(column["pm_dec"])
    one_band = np.isnan(column["bt"]) | np.isnan(column["vt"])
    bt_vt = np.where(one_band, ASSUMED_BT_VT_MAG, column["bt"] - column["vt"])
    vt = np.where(np.isnan(column["vt"]), column["bt"] - bt_vt, column["vt"])
    flags = column["flags"].copy()
    flags[no_motion] |= np.uint8(CatalogueFlag.NO_PROPER_MOTION)
    flags[one_band] |= np.uint8(CatalogueFlag.ONE_BAND)
    flags[_same_hip_in_supplement(column["hip"], column["flags"])] |= np.uint8(CatalogueFlag.DOUBLE)
    real = column["tyc"] != SPURIOUS_IDENTIFIER
    return RawStars(
        epoch_jyear=2000.0,
        ra_deg=column["ra"][real],
        dec_deg=column["dec"][real],
        pm_ra_mas_yr=column["pm_ra"][real],
        pm_dec_mas_yr=column["pm_dec"][real],
        v_mag=(vt - 0.090 * bt_vt)[real],  # note 7 of the catalogue
        b_v=0.850 * bt_vt[real],
        sigma_mas=column["sigma"][real],
        sigma_pm_mas_yr=np.nan_to_num(column["sigma_pm"])[real],
        mean_epoch_jyear=column["mean_epoch"][real],
        flags=flags[real],
        source_id=column["tyc"][real],
        hip=column["hip"][real].astype(np.int32),
    )


def _main_columns(record: Records) -> Columns:
    """Columns of the main catalogue; byte numbers are those of the catalogue's ReadMe."""
    no_mean = record[:, 13] == ord("X")
    mean_or_observed = {
        "ra": ((16, 27), (153, 164)),
        "dec": ((29, 40), (166, 177)),
        "sigma_ra": ((58, 60), (189, 193)),
        "sigma_dec": ((62, 64), (195, 199)),
        "epoch_ra": ((76, 82), (179, 182)),
        "epoch_dec": ((84, 90), (184, 187)),
    }
    value = {key: np.where(no_mean, _numbers(record, *b), _numbers(record, *a)) for key, (a, b) in mean_or_observed.items()}
    epoch = 0.5 * (value["epoch_ra"] + value["epoch_dec"]) + np.where(no_mean, 1990.0, 0.0)
    double = (record[:, 13] == ord("P")) | (record[:, 200] == ord("D")) | (record[:, 200] == ord("P"))
    return {
        "tyc": _identifier(record),
        "ra": value["ra"],
        "dec": value["dec"],
        "pm_ra": _numbers(record, 42, 48),
        "pm_dec": _numbers(record, 50, 56),
        "sigma": _rms(value["sigma_ra"], value["sigma_dec"]),
        "sigma_pm": _rms(_numbers(record, 66, 69), _numbers(record, 71, 74)),
        "mean_epoch": epoch,
        "bt": _numbers(record, 111, 116),
        "vt": _numbers(record, 124, 129),
        "hip": np.nan_to_num(_numbers(record, 143, 148)),
        "flags": (double * np.uint8(CatalogueFlag.DOUBLE)).astype(np.uint8),
    }


def _supplement_columns(record: Records) -> Columns:
    """Columns of supplement 1, moved from J1991.25 to J2000 where the motion is known."""
    pm_ra, pm_dec = _numbers(record, 42, 48), _numbers(record, 50, 56)
    observed = _numbers(record, 16, 27), _numbers(record, 29, 40)
    ra, dec, *_ = propagate(*observed, np.nan_to_num(pm_ra), np.nan_to_num(pm_dec), 2000.0 - SUPPLEMENT_EPOCH_JYEAR)
    return {
        "tyc": _identifier(record),
        "ra": ra,
        "dec": dec,
        "pm_ra": pm_ra,
        "pm_dec": pm_dec,
        "sigma": _rms(_numbers(record, 58, 62), _numbers(record, 64, 68)),
        "sigma_pm": _rms(_numbers(record, 70, 74), _numbers(record, 76, 80)),
        "mean_epoch": np.full(len(record), SUPPLEMENT_EPOCH_JYEAR),
        "bt": _numbers(record, 84, 89),
        "vt": _numbers(record, 97, 102),
        "hip": np.nan_to_num(_numbers(record, 116, 121)),
        "flags": np.full(len(record), CatalogueFlag.SUPPLEMENT, dtype=np.uint8),
    }


def _records(path: Path, record_bytes: int) -> Records:
    """A file of fixed-width records as (n, record_bytes)."""
    raw = np.fromfile(path, dtype=np.uint8)
    if raw.size == 0 or raw.size % record_bytes:
        raise UserError(f"Tycho-2 file {path}: {raw.size} bytes, expected a multiple of {record_bytes}: truncated?")
    return raw.reshape(-1, record_bytes)


def _numbers(record: Records, first: int, last: int) -> NDArray[np.float64]:
    """Bytes first..last (1-based, inclusive) as numbers, NaN where blank."""
    text = np.char.strip(np.ascontiguousarray(record[:, first - 1 : last]).view(f"S{last - first + 1}")[:, 0])
    out = np.full(len(text), np.nan)
    given = text != b""
    out[given] = text[given].astype(np.float64)
    return out


def _identifier(record: Records) -> NDArray[np.int64]:
    """TYC1, TYC2 (at most 12121) and TYC3 (at most 4) in one integer."""
    tyc1, tyc2, tyc3 = (_numbers(record, *span).astype(np.int64) for span in ((1, 4), (6, 10), (12, 12)))
    return (tyc1 << 17) | (tyc2 << 3) | tyc3


def _rms(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sqrt(0.5 * (a * a + b * b))


def _same_hip_in_supplement(hip: NDArray[np.float64], flags: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Rows of supplement 1 that share their Hipparcos number with another row of it."""
    rows = np.flatnonzero((flags & CatalogueFlag.SUPPLEMENT).astype(bool) & (hip > 0))
    _, inverse, counts = np.unique(hip[rows], return_inverse=True, return_counts=True)
    return rows[counts[inverse] > 1]
