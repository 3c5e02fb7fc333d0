"""Light curves along trails: bins with the signal to tell, with honest errors, at the right epochs, in a table."""

from dataclasses import replace

import numpy as np
import pytest

from ground.products.trail_light import BIN_SNR, FEWEST_BINS, joined_bins, trail_light_tables
from ground.records import GroundProducts
from ground.streaks import TrailedPsfFitter
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement
from tests.streaks.trail_rendering import expose, trail_at

FITTER = TrailedPsfFitter()


def measured(fit, number: int = 0, flags: StreakFlag = StreakFlag(0), mag: float = float("nan")) -> StreakMeasurement:  # noqa: B008
    return StreakMeasurement(
        frame=number,
        streak_id=number * 100_000,
        roi_id=0,
        fit=fit,
        row_mid=0.0,
        col_mid=0.0,
        ra_deg=np.zeros(3),
        dec_deg=np.zeros(3),
        t_tai_ns=np.array([10**18, 10**18 + 10**8, 10**18 + 2 * 10**8]),
        sigma_along_arcsec=1.0,
        sigma_cross_arcsec=1.0,
        mag=mag,
        mag_err=0.02,
        probability=1.0,
        tracklet_id=number,
        flags=flags,
    )


def table_of(*streaks: StreakMeasurement):
    products = GroundProducts(
        headers=(), solutions=(), photometry=(), streaks=streaks, tracklets=(), members=(), orbits=()
    )  # fmt: skip
    (table,) = trail_light_tables(products)
    return table


def test_errors_of_bins_are_honest():
    """Densities of steady trails scatter about the true one by their errors; end bins, which hang on the ends, are left out."""
    rng, pulls = np.random.default_rng(41), []
    for k in range(60):
        length = float(rng.uniform(60.0, 250.0))
        exposure = expose(rng, trail_at(rng, length), [15.0, 40.0, 100.0][k % 3])
        found = joined_bins(FITTER.fit(exposure.pixels, exposure.detection))
        assert found is not None
        density, error = found
        pulls.append(((density - exposure.trail.flux_e / length) / error)[1:-1])
    pull = np.concatenate(pulls)
    # 4 / sqrt(2 n) about one
    assert np.std(pull) == pytest.approx(1.0, abs=4.0 / np.sqrt(2.0 * len(pull)) + 0.03)
    assert abs(np.mean(pull)) < 4.0 / np.sqrt(len(pull)) + 0.05


@pytest.mark.parametrize(("snr", "told"), [(7.0, False), (9.0, False), (14.0, True), (60.0, True)])
def test_faint_trails_have_no_light_curve_and_others_have_bins_of_enough_signal(snr, told):
    rng = np.random.default_rng(3)
    exposure = expose(rng, trail_at(rng, 200.0), snr)
    found = joined_bins(FITTER.fit(exposure.pixels, exposure.detection))
    assert (found is not None) == told
    if found is not None:
        density, error = found
        assert len(density) >= FEWEST_BINS
        assert np.median(density / error) > 0.9 * BIN_SNR


def test_a_tumbling_trail_s_table_shows_its_flashes():
    """Seven flashes in a trail of 300 px, half of the mean up and down."""
    rng = np.random.default_rng(8)
    exposure = expose(rng, trail_at(rng, 300.0, amplitude=0.5, cycles=7.0), 80.0)
    fit = FITTER.fit(exposure.pixels, exposure.detection)
    rows = table_of(measured(fit, flags=StreakFlag.DIRECTION_RESOLVED, mag=12.0))
    phase = 2.0 * np.pi * 7.0 * rows["along_px"] / fit.length_px
    design = np.column_stack((np.ones(len(rows)), np.sin(phase), np.cos(phase)))
    level, *wave = np.linalg.lstsq(design, rows["relative"], rcond=None)[0]
    assert level == pytest.approx(1.0, abs=0.03)
    # a bin averages over a part of the flash
    assert 0.35 < np.hypot(*wave) < 0.53
    assert np.allclose(rows["mag"], 12.0 - 2.5 * np.log10(rows["relative"]))
    assert rows["t_tai_ns"][0] - 10**18 == pytest.approx(1e8 / len(rows), rel=1e-6)
    assert np.allclose(np.diff(rows["t_tai_ns"]), 2e8 / len(rows), atol=1.0)


def test_what_is_unknown_is_not_made_up():
    rng = np.random.default_rng(5)
    exposure = expose(rng, trail_at(rng, 150.0), 50.0)
    fit = FITTER.fit(exposure.pixels, exposure.detection)
    rows = table_of(
        measured(fit), measured(fit, 1, StreakFlag.VETOED), measured(replace(fit, light_curve_err_e_px=np.zeros(0)), 2)
    )
    assert set(rows["frame"]) == {0}
    assert (rows["t_tai_ns"] == 0).all()
    assert np.isnan(rows["mag"]).all()
    assert len(table_of()) == 0
    assert "vetoed" in rows.meta["selection"]
