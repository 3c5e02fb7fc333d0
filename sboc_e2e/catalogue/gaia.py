"""Reader of tables with Gaia's column names (FITS, ECSV, parquet), DR2 or DR3.

Needed: ra, dec, phot_g_mean_mag. Used where present: pmra, pmdec, bp_rp (or phot_bp_mean_mag and phot_rp_mean_mag),
ra_error, dec_error, pmra_error, pmdec_error, ref_epoch, source_id, duplicated_source.
"""

from pathlib import Path
from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.catalogue.packed import RawStars
from sboc_e2e.catalogue.stars import CatalogueFlag
from sboc_e2e.icd.errors import UserError

RELEASE_OF_EPOCH: Final = {2015.5: "Gaia DR2", 2016.0: "Gaia DR3"}

G_MINUS_V: Final = (-0.02704, 0.01424, -0.2156, 0.01426)
"""G - V in powers of BP-RP (Gaia DR3 documentation, section 5.5.1, table 5.9; scatter 0.03 mag)."""

BP_RP_OF_B_V: Final = (0.0102, 1.7871, -0.9738, 0.3512)
"""BP-RP in powers of B-V as Tycho-2 gives it: a fit to 238,000 stars in common, -0.2 < B-V < 1.8, rms 0.054 mag."""

ASSUMED_BP_RP: Final = 0.82
"""Colour of the Sun, for stars without BP-RP."""

DEFAULT_SIGMA_MAS: Final = 0.1
"""For tables without errors. The catalogue file stores whole mas and 1 at least, so that all values up to 1.5 give the same
bytes."""
DEFAULT_SIGMA_PM_MAS_YR: Final = 0.1
"""For tables without errors: one unit of the catalogue file. Gaia EDR3 has 0.07 mas/yr at G = 17 (Gaia Collaboration 2021, A&A
649, A1)."""


def read_gaia(path: Path) -> tuple[RawStars, str]:
    """Stars of a table and the release ('Gaia DR2' or 'Gaia DR3') that its reference epoch tells."""
    table = _read_table(path)
    for name in ("ra", "dec", "phot_g_mean_mag"):
        if name not in table.colnames:
            raise UserError(f"Gaia table {path}: no column {name}; found {', '.join(table.colnames[:12])}")
    n = len(table)
    if n == 0:
        raise UserError(f"Gaia table {path}: no rows")
    epochs = np.unique(_column(table, "ref_epoch", 2016.0))
    if len(epochs) != 1 or float(epochs[0]) not in RELEASE_OF_EPOCH:
        raise UserError(f"Gaia table {path}: ref_epoch {epochs[:3].tolist()}, expected one of 2015.5 (DR2), 2016.0 (DR3)")
    epoch_jyear = float(epochs[0])

    bp_rp = _column(table, "bp_rp", np.nan)
    if "bp_rp" not in table.colnames and {"phot_bp_mean_mag", "phot_rp_mean_mag"} <= set(table.colnames):
        bp_rp = _column(table, "phot_bp_mean_mag", np.nan) - _column(table, "phot_rp_mean_mag", np.nan)
    one_band = ~np.isfinite(bp_rp)
    bp_rp = np.where(one_band, ASSUMED_BP_RP, bp_rp)
    pm_ra, pm_dec = _column(table, "pmra", np.nan), _column(table, "pmdec", np.nan)
    no_motion = ~np.isfinite(pm_ra) | ~np.isfinite(pm_dec)
    double = _column(table, "duplicated_source", 0.0) > 0
    flags = (
        no_motion * np.uint8(CatalogueFlag.NO_PROPER_MOTION)
        | one_band * np.uint8(CatalogueFlag.ONE_BAND)
        | double * np.uint8(CatalogueFlag.DOUBLE)
    )
    has_id = "source_id" in table.colnames
    raw = RawStars(
        epoch_jyear=epoch_jyear,
        ra_deg=_column(table, "ra", np.nan),
        dec_deg=_column(table, "dec", np.nan),
        pm_ra_mas_yr=pm_ra,
        pm_dec_mas_yr=pm_dec,
        v_mag=_column(table, "phot_g_mean_mag", np.nan) - np.polynomial.polynomial.polyval(bp_rp, G_MINUS_V),
        b_v=b_v_of_bp_rp(bp_rp),
        sigma_mas=_pair_rms(table, "ra_error", "dec_error", DEFAULT_SIGMA_MAS),
        sigma_pm_mas_yr=_pair_rms(table, "pmra_error", "pmdec_error", DEFAULT_SIGMA_PM_MAS_YR),
        mean_epoch_jyear=np.full(n, epoch_jyear),
        flags=flags.astype(np.uint8),
        source_id=np.asarray(table["source_id"], dtype=np.int64) if has_id else np.arange(n, dtype=np.int64),
        hip=np.zeros(n, dtype=np.int32),
    )
    if not (np.isfinite(raw.ra_deg).all() and np.isfinite(raw.dec_deg).all() and (np.abs(raw.dec_deg) <= 90.0).all()):
        raise UserError(f"Gaia table {path}: ra or dec is missing or out of range in some rows")
    return raw, RELEASE_OF_EPOCH[epoch_jyear]


def b_v_of_bp_rp(bp_rp: NDArray[np.float64]) -> NDArray[np.float64]:
    """B-V (Tycho-2 system) of a BP-RP colour: inverse of `BP_RP_OF_B_V`, clipped to -0.3 <= B-V <= 2."""
    b_v = np.linspace(-0.3, 2.0, 461)
    return np.interp(bp_rp, np.polynomial.polynomial.polyval(b_v, BP_RP_OF_B_V), b_v)


def _read_table(path: Path) -> Table:
    if not path.is_file():
        raise UserError(f"Gaia table {path}: no such file")
    suffix = path.suffix.lower()
    if suffix not in (".fits", ".fit", ".ecsv", ".parquet", ".parq"):
        raise UserError(f"Gaia table {path}: expected .fits, .ecsv or .parquet, got {suffix or 'no suffix'}")
    try:
        if suffix in (".parquet", ".parq"):
            return _read_parquet(path)
        return Table.read(path, format="ascii.ecsv" if suffix == ".ecsv" else "fits")
    except ImportError as error:
        raise UserError(f"Gaia table {path}: parquet needs pyarrow; install the extra `gaia`") from error
    except Exception as error:  # readers of foreign files raise anything; the user can mend the file
        raise UserError(f"Gaia table {path}: cannot be read ({' '.join(str(error).split())[:120]})") from error


def _read_parquet(path: Path) -> Table:
    import pyarrow.parquet  # optional: the extra `gaia`

    table = pyarrow.parquet.read_table(path)
    return Table({name: table.column(name).to_numpy() for name in table.column_names})


def _column(table: Table, name: str, default: float) -> NDArray[np.float64]:
    """A column as float64, masked or absent values replaced by `default`."""
    if name not in table.colnames:
        return np.full(len(table), default)
    column = table[name]
    filled = column.filled(default) if hasattr(column, "filled") and column.dtype.kind == "f" else column
    return np.asarray(getattr(filled, "value", filled), dtype=np.float64)


def _pair_rms(table: Table, name_a: str, name_b: str, default: float) -> NDArray[np.float64]:
    a, b = _column(table, name_a, default), _column(table, name_b, default)
    rms = np.sqrt(0.5 * (a * a + b * b))
    return np.where(np.isfinite(rms), rms, default)
