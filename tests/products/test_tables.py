"""Tables have the promised columns with units, empty runs included, and survive ECSV."""

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table

from ground.astrometry.astrometer import CameraFit
from ground.calibration import ideal_calibration
from ground.photometry.zero_point import ZeroPoint
from ground.products import tables
from ground.products.tables.frames import COUNTERS
from ground.records import GroundProducts
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from tests.astrometry.star_fields import make_field
from tests.astrometry.test_magnitudes import measured_streak
from tests.golden.cases import HOUSEKEEPING

STREAK_COLUMNS = {
    *("frame", "streak_id", "row0", "col0", "row1", "col1", "row_mid", "col_mid", "length_px", "angle_deg", "flux_e"),
    *("flux_err_e", "snr", "ra_mid_deg", "dec_mid_deg", "sigma_along_arcsec", "sigma_cross_arcsec", "t_mid_utc", "mag"),
    *("mag_err", "tracklet_id", "flags", "density_e_px", "density_err_e_px", "mag_at_1deg_s", "mag_at_1deg_s_err"),
    *("end0_low_px", "end0_high_px", "end1_low_px", "end1_high_px"),
    *("light0_low_px", "light0_high_px", "light1_low_px", "light1_high_px"),
}


@pytest.fixture(scope="module")
def run():
    catalogue = StarCatalogue.embedded()
    fit, photometer = CameraFit(), ZeroPoint()
    fields = [make_field(catalogue, seed) for seed in range(2)]
    state, solutions, photometry = fit.initial_state(fields[0].calibration, catalogue), [], []
    for field in fields:
        state, solution = fit.solve(state, field.frame)
        solutions.append(solution)
        photometry.append(photometer.calibrate(field.frame, solution, field.calibration))
    frames = [field.frame for field in fields]
    products = GroundProducts(
        headers=tuple(frame.header for frame in frames),
        solutions=tuple(solutions),
        photometry=tuple(photometry),
        streaks=(),
        tracklets=(),
        members=(),
        orbits=(),
    )
    return frames, products


def _round_trip(table: Table) -> Table:
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return Table.read(text.getvalue(), format="ascii.ecsv")


def test_every_table_survives_ecsv_with_units_and_descriptions(run):
    frames, products = run
    made = [
        *tables.frames_tables(products, frames),
        *tables.stars_tables(products, frames),
        *tables.streaks_tables(products),
        tables.tracklets_table(products),
        tables.orbits_table(products),
    ]
    for table in made:
        back = _round_trip(table)
        assert back.colnames == table.colnames
        for name in table.colnames:
            assert back[name].unit == table[name].unit
            assert table[name].description
            if len(table):
                assert back[name].dtype.kind == table[name].dtype.kind


def test_streaks_have_the_columns_that_are_promised(run):
    _, products = run
    (table,) = tables.streaks_tables(products)
    assert set(table.colnames) >= STREAK_COLUMNS
    assert len(table) == 0
    assert "annual aberration not removed" in table.meta["directions"]


def test_ends_of_the_light_are_those_of_the_object_where_no_others_are_given(run):
    _, products = run
    plain = measured_streak(0.0, 200.0, [2 * 10**18] * 3, 1e4, StreakFlag(0))
    fades = replace(plain, fit=replace(plain.fit, light_interval_px=np.array([[-1.0, 2.0], [-3.0, 4.0]])))
    (table,) = tables.streaks_tables(replace(products, streaks=(plain, fades)))
    for name, given in (("0_low", -1.0), ("0_high", 2.0), ("1_low", -3.0), ("1_high", 4.0)):
        assert table[f"light{name}_px"].tolist() == [table[f"end{name}_px"][0], given]
        assert table[f"end{name}_px"][1] == table[f"end{name}_px"][0]


def test_crossings_are_told_and_points_have_no_density(run):
    _, products = run
    edges = StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.SINGLE_FRAME
    one, other = (measured_streak(0.0, 200.0, [2 * 10**18] * 3, 1e4, flags) for flags in (edges, StreakFlag.POINT_LIKE))
    (table,) = tables.streaks_tables(replace(products, streaks=(replace(one, mag_at_1deg_s=11.5, mag_at_1deg_s_err=0.1), other)))
    assert table["density_e_px"].tolist() == pytest.approx([50.0, np.nan], nan_ok=True)
    assert table["density_err_e_px"].tolist() == pytest.approx([0.5, np.nan], nan_ok=True)
    assert table["mag_at_1deg_s"].tolist() == pytest.approx([11.5, np.nan], nan_ok=True)
    assert "mag_at_1deg_s - 2.5 log10(rate in deg/s)" in table.meta["crossings"]


@pytest.mark.parametrize(("without", "phrase"), [(0, "velocity removed,"), (1, "NO_OBSERVER"), (2, "velocity not removed")])
def test_tables_say_what_was_removed_from_directions(run, without, phrase):
    _, products = run
    headers = [replace(header, observer=None) if k < without else header for k, header in enumerate(products.headers)]
    told = replace(products, headers=headers)
    for table in (*tables.streaks_tables(told), tables.tracklets_table(told)):
        assert phrase in table.meta["directions"]


def test_frames_table_points_where_the_camera_looks(run):
    frames, products = run
    (table,) = tables.frames_tables(products, frames)
    assert table["solved"].all()
    # the field's centre is 131.5, 17.9 (ICRS); aberration moves it by at most 26 arcsec
    assert np.abs(table["ra_app_deg"] - 131.5).max() < 0.02
    assert np.abs(table["dec_app_deg"] - 17.9).max() < 0.02
    assert all(re.fullmatch(r"2027-01-2\dT\d\d:\d\d:\d\d\.\d{6}", text) for text in table["t_start_utc"])


def test_frames_table_has_what_the_spacecraft_said(run):
    frames, products = run
    told = [
        replace(frame, flags=FrameFlag.STORM | FrameFlag.BUDGET_CUT, psf_sigma_px=0.93, housekeeping=HOUSEKEEPING)
        for frame in frames
    ]
    (table,) = tables.frames_tables(products, told)
    assert (table["flags"] & int(FrameFlag.STORM) > 0).all()
    assert (table["flags"] & int(FrameFlag.BUDGET_CUT) > 0).all()
    assert table["psf_sigma_px"].tolist() == [0.93] * len(frames)
    for name, _, _ in COUNTERS:
        assert table[name].tolist() == [getattr(HOUSEKEEPING, name)] * len(frames)
    assert table["threshold_sigma"].tolist() == [HOUSEKEEPING.threshold_sigma] * len(frames)
    (lost,) = tables.frames_tables(products, [replace(frame, housekeeping=None) for frame in frames])
    assert np.isnan(lost["psf_sigma_px"]).all()
    assert np.isnan(lost["threshold_sigma"]).all()
    assert (lost["n_rois_dropped"] == -1).all()


def test_stars_table_names_the_matched_ones(run):
    frames, products = run
    (table,) = tables.stars_tables(products, frames)
    assert len(table) == sum(len(frame.stars) for frame in frames)
    matched = np.isfinite(table["v_mag"])
    assert matched.sum() == sum(s.n_stars for s in products.solutions)


def test_an_ideal_calibration_takes_no_memory():
    catalogue = StarCatalogue.embedded()
    camera = make_field(catalogue, 0).calibration.camera
    calibration = ideal_calibration(camera)
    assert calibration.dark_adu.strides == (0, 0)
