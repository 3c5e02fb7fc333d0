"""Making catalogue files: Tycho-2 at any depth, and tables with Gaia's column names."""

from pathlib import Path

from sboc_e2e.catalogue.gaia import read_gaia
from sboc_e2e.catalogue.packed import RawStars, write_packed
from sboc_e2e.catalogue.tycho2 import read_tycho2
from sboc_e2e.icd.errors import UserError

TYCHO2_PROVENANCE = (
    "Tycho-2, Hog E. et al. 2000, A&A 355, L27 (CDS I/259): main catalogue and supplement 1, ICRS, J2000; "
    "V and B-V from BT, VT by note 7 of the catalogue; Debian source package tycho2, BSD-2-Clause"
)


def build_tycho2(source_dir: str | Path, out: str | Path, v_max: float) -> int:
    """Pack Tycho-2 stars with V < `v_max` (99: all) from `source_dir` into `out`; returns their number.

    source_dir : holds `tyc2.dat.00` ... and `suppl_1.dat`, unpacked.
    """
    raw = read_tycho2(Path(source_dir))
    return _write(Path(out), raw, name="Tycho-2", provenance=TYCHO2_PROVENANCE, v_max=v_max)


def import_gaia(path: str | Path, out: str | Path) -> int:
    """Pack a FITS, ECSV or parquet table with Gaia's column names into `out`; returns the number of stars."""
    raw, release = read_gaia(Path(path))
    provenance = (
        f"{release} table {Path(path).name}; V from G by G-V(BP-RP) of Gaia DR3 documentation 5.5.1, B-V from BP-RP by a cubic "
        "fitted on stars in common with Tycho-2; credit: ESA/Gaia/DPAC"
    )
    return _write(Path(out), raw, name=release, provenance=provenance, v_max=99.0)


def _write(out: Path, raw: RawStars, *, name: str, provenance: str, v_max: float) -> int:
    if not out.parent.is_dir():
        raise UserError(f"catalogue output {out}: folder {out.parent} does not exist")
    if not (raw.v_mag < v_max).any():
        raise UserError(f"catalogue output {out}: none of {len(raw.v_mag)} stars has a magnitude below {v_max:g}")
    return write_packed(out, raw, name=name, provenance=provenance, v_max=v_max)
