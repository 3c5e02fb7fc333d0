"""Gaia tables and Tycho-2 records become catalogues; what cannot be used is refused by name."""

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue
from sboc_e2e.catalogue.build import build_tycho2, import_gaia
from sboc_e2e.catalogue.gaia import BP_RP_OF_B_V, b_v_of_bp_rp
from sboc_e2e.icd.errors import UserError


def _gaia_table(ref_epoch: float = 2016.0) -> Table:
    return Table(
        {
            "source_id": np.array([5, 6, 7], dtype=np.int64) * 10**17,
            "ra": [10.0, 10.1, 10.2],
            "dec": [-5.0, -5.1, -5.2],
            "pmra": [12.5, np.nan, -3.0],
            "pmdec": [-7.0, np.nan, 4.0],
            "pmra_error": [0.3, np.nan, 0.4],
            "pmdec_error": [0.3, np.nan, 0.4],
            "phot_g_mean_mag": [8.0, 12.0, 15.5],
            "bp_rp": [0.82, 1.5, np.nan],
            "ref_epoch": np.full(3, ref_epoch),
        }
    )


@pytest.mark.parametrize("suffix", [".fits", ".ecsv", ".parquet"])
def test_gaia_tables_of_each_kind_are_imported(tmp_path, suffix):
    path = tmp_path / f"gaia{suffix}"
    if suffix == ".parquet":
        parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
        pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
        parquet.write_table(pyarrow.table({name: np.asarray(column) for name, column in _gaia_table().items()}), path)
    else:
        _gaia_table().write(path)
    assert import_gaia(path, tmp_path / "gaia.npz") == 3
    catalogue = StarCatalogue.open(tmp_path / "gaia.npz")
    assert catalogue.name == "Gaia DR3"
    stars = catalogue.cone(10.1, -5.1, 1.0, epoch_jyear=2016.0)
    order = np.argsort(stars.source_id)
    assert stars.source_id[order].tolist() == [5 * 10**17, 6 * 10**17, 7 * 10**17]
    np.testing.assert_allclose(stars.ra_deg[order], [10.0, 10.1, 10.2], atol=5e-8)
    # the Sun: G - V at BP-RP 0.82 is -0.152 by the polynomial, B-V 0.653
    assert abs(stars.v_mag[order][0] - 8.152) < 0.01
    assert abs(stars.b_v[order][0] - 0.64) < 0.03
    assert stars.flags[order].tolist() == [0, CatalogueFlag.NO_PROPER_MOTION, CatalogueFlag.ONE_BAND]


def test_release_follows_from_the_reference_epoch(tmp_path):
    _gaia_table(2015.5).write(tmp_path / "dr2.fits")
    import_gaia(tmp_path / "dr2.fits", tmp_path / "dr2.npz")
    assert StarCatalogue.open(tmp_path / "dr2.npz").name == "Gaia DR2"
    assert StarCatalogue.open(tmp_path / "dr2.npz").epoch_jyear == 2015.5


def test_unusable_gaia_tables_are_refused(tmp_path):
    _gaia_table(2000.0).write(tmp_path / "epoch.fits")
    with pytest.raises(UserError, match="ref_epoch"):
        import_gaia(tmp_path / "epoch.fits", tmp_path / "o.npz")
    table = _gaia_table()
    table.remove_column("dec")
    table.write(tmp_path / "nodec.ecsv")
    with pytest.raises(UserError, match="no column dec"):
        import_gaia(tmp_path / "nodec.ecsv", tmp_path / "o.npz")
    (tmp_path / "broken.fits").write_text("nothing")
    with pytest.raises(UserError, match="cannot be read"):
        import_gaia(tmp_path / "broken.fits", tmp_path / "o.npz")
    (tmp_path / "a.csv").write_text("ra,dec")
    with pytest.raises(UserError, match=r"expected \.fits"):
        import_gaia(tmp_path / "a.csv", tmp_path / "o.npz")
    assert not (tmp_path / "o.npz").exists()


def test_colour_transformation_is_inverted():
    b_v = np.linspace(-0.2, 1.8, 50)
    bp_rp = np.polynomial.polynomial.polyval(b_v, BP_RP_OF_B_V)
    np.testing.assert_allclose(b_v_of_bp_rp(bp_rp), b_v, atol=1e-3)


def test_tycho2_source_that_is_not_whole_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"expected tyc2\.dat"):
        build_tycho2(tmp_path, tmp_path / "o.npz", 11.0)
    (tmp_path / "tyc2.dat.00").write_bytes(b"x" * 300)
    (tmp_path / "suppl_1.dat").write_bytes(b"")
    with pytest.raises(UserError, match="multiple of 207"):
        build_tycho2(tmp_path, tmp_path / "o.npz", 11.0)


def test_tycho2_records_are_read_by_byte(tmp_path):
    # first record of the catalogue, and the first of supplement 1, as published
    main = (
        "0001 00008 1| |  2.31750494|  2.23184345|  -16.3|   -9.0| 68| 73| 1.7| 1.8|1958.89|1951.94| 4|1.0|1.0|0.9|1.0|"
        "12.146|0.158|12.146|0.223|999| |         |  2.31754222|  2.23186444|1.67|1.54| 88.0|100.8| |-0.2\n"
    )
    assert len(main) == 207
    fields = ["0002 00005 1", "T", f"{3.0:12.8f}", f"{4.0:12.8f}", " " * 7, " " * 7, " 27.0", " 21.0", " " * 5, " " * 5, " "]
    fields += ["10.000", "0.100", " 9.500", "0.100", "999", "T", " " * 7]
    supplement = "|".join(fields) + "\n"
    assert len(supplement) == 123
    (tmp_path / "tyc2.dat.00").write_text(main)
    (tmp_path / "suppl_1.dat").write_text(supplement)
    assert build_tycho2(tmp_path, tmp_path / "t.npz", 99.0) == 2
    stars = StarCatalogue.open(tmp_path / "t.npz").cone(2.6, 3.1, 5.0)
    first, second = (stars.take(np.abs(stars.ra_deg - ra) < 0.1) for ra in (2.3175, 3.0))
    assert abs(first.ra_deg[0] - 2.31750494) < 5e-8
    assert abs(first.pm_ra_mas_yr[0] + 16.3) < 0.01
    assert abs(first.v_mag[0] - 12.146) < 1e-3
    # mean epoch 1955.4, errors 70.5 mas and 1.75 mas/yr: hypot(71, 1.8 * 45)
    assert abs(first.sigma_mas[0] - np.hypot(70.5, 1.75 * 44.6)) < 3.0
    assert abs(second.v_mag[0] - (9.5 - 0.09 * 0.5)) < 1e-3
    assert second.flags[0] == CatalogueFlag.NO_PROPER_MOTION | CatalogueFlag.SUPPLEMENT
