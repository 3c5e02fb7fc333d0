"""Cone searches: complete, at the right epoch, with honest errors; bad files give one clear line."""

from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue
from sboc_e2e.catalogue.packed import RawStars, write_packed
from sboc_e2e.icd.errors import UserError

MAS = 1.0 / 3.6e6


@pytest.fixture(scope="module")
def tycho2() -> StarCatalogue:
    return StarCatalogue.embedded()


def _separation_deg(ra_deg, dec_deg, ra0_deg, dec0_deg):
    ra, dec, ra0, dec0 = map(np.radians, (ra_deg, dec_deg, ra0_deg, dec0_deg))
    half = np.sin(0.5 * (dec - dec0)) ** 2 + np.cos(dec) * np.cos(dec0) * np.sin(0.5 * (ra - ra0)) ** 2
    return np.degrees(2.0 * np.arcsin(np.sqrt(half)))


def test_counts_by_magnitude_are_those_of_the_catalogue(tycho2):
    whole_sky = tycho2.cone(0.0, 0.0, 180.0)
    assert len(whole_sky) == tycho2.n_stars == 945_994  # 945,995 rows with V < 11, less the second row of Arcturus
    # 130,726 before magnitudes are rounded to 1 mmag
    assert abs((whole_sky.v_mag < 9.0).sum() - 130_726) < 100
    assert tycho2.pixel_counts.sum() == tycho2.n_stars
    assert tycho2.pixel_counts.shape == (12 * 64**2,)


@pytest.mark.parametrize(("ra_deg", "dec_deg"), [(0.01, 0.0), (129.9, 19.7), (250.0, 89.5), (77.0, -90.0), (359.9, -45.0)])
def test_cone_holds_all_stars_within_its_radius_and_no_other(tycho2, ra_deg, dec_deg):
    everything = tycho2.cone(0.0, 0.0, 180.0)
    inside = _separation_deg(everything.ra_deg, everything.dec_deg, ra_deg, dec_deg) <= 4.0
    cone = tycho2.cone(ra_deg, dec_deg, 4.0)
    assert len(cone) > 100
    assert len(cone) == inside.sum()
    np.testing.assert_array_equal(np.sort(cone.ra_deg), np.sort(everything.ra_deg[inside]))


def test_magnitude_limit_keeps_the_bright_ones(tycho2):
    deep, bright = tycho2.cone(130.0, 20.0, 3.0), tycho2.cone(130.0, 20.0, 3.0, v_max=9.0)
    np.testing.assert_array_equal(bright.source_id, deep.source_id[deep.v_mag < 9.0])


def test_praesepe_stands_where_it_should(tycho2):
    cluster = tycho2.cone(130.1, 19.67, 0.6, v_max=8.0)
    assert len(cluster) >= 15
    # mean proper motion of M44 by Gaia DR2 (Cantat-Gaudin et al. 2018): (-36.0, -12.9) mas/yr
    assert abs(np.median(cluster.pm_ra_mas_yr) + 36.0) < 3.0
    assert abs(np.median(cluster.pm_dec_mas_yr) + 12.9) < 3.0


def test_traps_of_tycho2_are_flagged(tycho2):
    whole_sky = tycho2.cone(0.0, 0.0, 180.0)
    arcturus = whole_sky.take(whole_sky.hip == 69673)
    assert len(arcturus) == 1
    assert arcturus.v_mag[0] < 0.5
    sirius = whole_sky.take(whole_sky.hip == 32349)
    assert CatalogueFlag(int(sirius.flags[0])) & CatalogueFlag.ONE_BAND
    unmoving = (whole_sky.flags & CatalogueFlag.NO_PROPER_MOTION).astype(bool)
    assert unmoving.sum() > 1000
    assert not whole_sky.pm_ra_mas_yr[unmoving].any()
    assert not whole_sky.pm_dec_mas_yr[unmoving].any()


def test_fast_stars_keep_their_motion_and_are_found_where_they_went(tycho2):
    barnard_2027 = tycho2.cone(269.44871, 4.77056, 0.005, epoch_jyear=2027.0)
    k = np.flatnonzero(barnard_2027.hip == 87937)
    assert len(k) == 1
    assert abs(barnard_2027.pm_dec_mas_yr[k[0]] - 10_277.3) < 1.0


def test_quoted_errors_grow_with_time(tycho2):
    at_1991, at_2027 = (tycho2.cone(130.0, 20.0, 3.0, epoch_jyear=epoch).sigma_mas for epoch in (1991.5, 2027.0))
    assert 20.0 < np.median(at_1991) < 50.0
    assert 55.0 < np.median(at_2027) < 110.0  # against Gaia DR3 the median distance (two coordinates) is about 100 mas in 2026


def test_columns_survive_packing(tmp_path):
    rng = np.random.default_rng(4)
    n = 200
    raw = RawStars(
        epoch_jyear=2016.0,
        ra_deg=rng.uniform(0.0, 360.0, n),
        dec_deg=np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, n))),
        pm_ra_mas_yr=np.where(np.arange(n) == 7, -10_000.0, rng.normal(0.0, 30.0, n)),
        pm_dec_mas_yr=rng.normal(0.0, 30.0, n),
        v_mag=rng.uniform(3.0, 12.0, n),
        b_v=rng.uniform(-0.3, 2.0, n),
        sigma_mas=rng.uniform(1.0, 90.0, n),
        sigma_pm_mas_yr=rng.uniform(0.0, 5.0, n),
        mean_epoch_jyear=np.full(n, 2016.0),
        flags=rng.integers(0, 16, n).astype(np.uint8) & np.uint8(~1 & 0xFF),
        source_id=rng.integers(0, 2**62, n),
        hip=np.where(np.arange(n) % 9 == 0, np.arange(n), 0).astype(np.int32),
    )
    assert write_packed(tmp_path / "c.npz", raw, name="test", provenance="drawn", v_max=11.0) == (raw.v_mag < 11.0).sum()
    stars = StarCatalogue.open(tmp_path / "c.npz").cone(10.0, 10.0, 180.0, epoch_jyear=2016.0)
    source = {int(s): i for i, s in enumerate(raw.source_id)}
    row = np.array([source[int(s)] for s in stars.source_id])
    assert np.abs((stars.ra_deg - raw.ra_deg[row] + 180.0) % 360.0 - 180.0).max() < 0.16 * MAS
    assert np.abs(stars.dec_deg - raw.dec_deg[row]).max() < 0.16 * MAS
    assert np.abs(stars.pm_ra_mas_yr - raw.pm_ra_mas_yr[row]).max() < 0.0501
    assert np.abs(stars.v_mag - raw.v_mag[row]).max() < 0.51e-3
    assert np.abs(stars.b_v - raw.b_v[row]).max() < 2.6e-3
    assert np.abs(stars.sigma_mas - raw.sigma_mas[row]).max() < 0.51
    np.testing.assert_array_equal(stars.flags, raw.flags[row])
    np.testing.assert_array_equal(stars.hip, raw.hip[row])


def test_missing_truncated_and_foreign_files_are_refused_in_one_line(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        StarCatalogue.open(tmp_path / "absent.npz")
    whole = (Path(__file__).parents[2] / "sboc_e2e/catalogue/data/tycho2_v11.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    damaged = bytearray(whole)
    damaged[2_000_000:2_000_400] = bytes(400)
    (tmp_path / "damaged.npz").write_bytes(damaged)
    (tmp_path / "text.npz").write_text("not a catalogue")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("cut.npz", "damaged.npz", "text.npz", "other.npz"):
        with pytest.raises(UserError, match=name) as caught:
            StarCatalogue.open(tmp_path / name)
        assert "\n" not in str(caught.value)
