"""The shipped scenarios can be simulated, and show what their files say."""

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import document
from simulator.chain import Simulator


def simulator_of(name, *overrides):
    scenario = document.load(name, registry=Registry(), overrides=overrides)
    return Simulator(scenario.simulator, seed=scenario.seed, catalogue=StarCatalogue.embedded())


def test_seven_streaks_look_alike_under_the_rolling_shutter_only():
    rolling = simulator_of("shutter_seven_streaks").frame(0)[1].streaks
    still = simulator_of("shutter_seven_streaks", 'shutter.line_time="0 us"').frame(0)[1].streaks
    assert len(rolling) == len(still) == 7
    assert np.round(rolling["length_px"][5:], 3).tolist() == [500.0, 500.0]
    assert np.round(still["length_px"][5:], 2).tolist() == [400.0, 666.67]


def test_curved_streak_bends_and_brightens():
    streaks = simulator_of("curved_streak").frame(2)[1].streaks
    assert len(streaks) == 1
    assert abs(streaks["sagitta_px"][0]) > 2.0
    assert 0.35 < abs(streaks["gradient"][0]) < 0.55


@pytest.mark.slow
def test_storm_fills_the_frame():
    assert 3000 < simulator_of("sso_antisun_saa").frame(0)[1].frame["n_cosmics"][0] < 7000


@pytest.mark.slow
def test_near_field_is_small_fast_and_near():
    simulator = simulator_of("near_field_mm")
    objects = simulator.objects()
    assert len(objects) == 24
    assert objects["size_m"].max() <= 0.01
    assert np.nanmedian(objects["range_km"]) < 60.0


@pytest.mark.slow
def test_nadir_rotation_trails_the_corners():
    simulator = simulator_of("nadir_rotation")
    first, second = (simulator.frame(k)[1].frame[0] for k in (0, 1))
    corner_moves = np.hypot(*(first[k][0] - second[k][0] for k in ("grid_ra_app_deg", "grid_dec_app_deg")))
    centre_moves = np.hypot(*(first[k][40] - second[k][40] for k in ("grid_ra_app_deg", "grid_dec_app_deg")))
    # 3.73 deg from the centre at 0.0607 deg/s for two seconds
    assert corner_moves == pytest.approx(np.radians(0.0607 * 2.0) * 3.73, rel=0.1)
    assert centre_moves < 0.05 * corner_moves


@pytest.mark.slow
def test_geostationary_objects_are_faint():
    streaks = simulator_of("geo_survey").frame(6)[1].streaks
    assert len(streaks) == 4
    faint = streaks[streaks["mag"] > 15.0]
    assert ((faint["snr"] > 6.0) & (faint["snr"] < 25.0)).all()


@pytest.mark.slow
def test_the_milky_way_is_crowded():
    crowded = len(simulator_of("crowded_plane").frame(0)[1].stars)
    assert crowded > 1.5 * 30000


@pytest.mark.slow
def test_real_satellites_pass(shared_data):
    file = shared_data / "tle" / "catalogue_2022-01.3le.gz"
    objects = simulator_of("catalogue_pass", f'objects.satellites.file="{file}"').objects()
    assert len(objects) > 3
    assert set(objects["kind"]) == {"tle"}
    assert np.isfinite(objects["range_km"]).mean() > 0.7


def test_tracked_satellite_is_a_point_and_stars_trail():
    simulator = simulator_of("ground_site_tracking", 'stars.faint_limit="12 mag"')
    streaks = simulator.frame(4)[1].streaks
    assert len(streaks) == 1
    assert streaks["length_px"][0] < 1.0
    first, last = (simulator.frame(k)[1].frame["grid_ra_app_deg"][0][40] for k in (0, 7))
    assert abs(first - last) > 0.05  # the sky moves behind it
