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


@pytest.fixture(scope="module")
def shutters():
    """Seven streaks under a global and a rolling shutter: truth, and mean electrons without sky."""
    return {
        name: (made.frame(0)[1].streaks, made.mean_electrons(0))
        for name, made in (
            (name, simulator_of("shutter_seven_streaks", "stars.enabled=false", *more))
            for name, more in (("still", ('shutter.line_time="0 us"',)), ("rolling", ()))
        )
    }


def test_three_horizontal_streaks_stand_aligned_and_are_skewed_by_the_rolling_shutter(shutters):
    still, rolling = (shutters[name][0][:3] for name in ("still", "rolling"))
    for streaks in (still, rolling):
        assert np.abs(streaks["row1"] - streaks["row0"]).max() < 1e-3
        assert streaks["length_px"] == pytest.approx([300.0] * 3, abs=1e-3)
    assert still["col0"] == pytest.approx([90.0] * 3, abs=1e-3)
    # 1500 px/s x 100 us: 0.15 columns for each row from the middle one, 511.5.
    assert rolling["col0"] == pytest.approx(90.0 + 0.15 * (rolling["row0"] - 511.5), abs=1e-3)
    assert np.ptp(rolling["col0"]) == pytest.approx(76.8, abs=1e-3)


def test_of_two_inclined_streaks_one_is_longer_in_rows(shutters):
    still, rolling = (np.abs(shutters[name][0]["row1"] - shutters[name][0]["row0"])[3:5] for name in ("still", "rolling"))
    assert still == pytest.approx([300.0, 200.0], abs=1e-3)
    # T v / (1 - v tau): with the rows the one is longer still, against them the other is shorter.
    assert rolling == pytest.approx([300.0 / 0.85, 200.0 / 1.1], abs=1e-3)
    inclined = shutters["rolling"][0][3:5]
    assert (np.abs(inclined["col1"] - inclined["col0"]) > 100.0).all()


def test_two_opposite_vertical_streaks_differ_and_become_identical_and_aligned(shutters):
    still, rolling = (shutters[name][0][5:] for name in ("still", "rolling"))
    for streaks in (still, rolling):
        assert np.abs(streaks["col1"] - streaks["col0"]).max() < 1e-3
        assert np.sign(streaks["row1"] - streaks["row0"]).tolist() == [1.0, -1.0]
    assert still["length_px"] == pytest.approx([400.0, 2000.0 / 3.0], abs=1e-3)
    assert rolling["length_px"] == pytest.approx([500.0, 500.0], abs=1e-3)
    assert [sorted((s["row0"], s["row1"])) for s in rolling] == [pytest.approx([261.5, 761.5], abs=1e-3)] * 2
    # No pixel tells them apart: the light of each row of the one is that of the other.
    image = shutters["rolling"][1]
    down, up = (image[:, col - 20 : col + 21] - np.median(image) for col in (870, 950))
    assert np.abs(down - up).max() < 0.03 * down.max()  # a fifth of the photon noise; the ends are sampled at 0.45 px
    assert down.sum(axis=1)[300:720] == pytest.approx(up.sum(axis=1)[300:720], rel=0.01)
    down, up = (shutters["still"][1][:, col - 20 : col + 21] - np.median(image) for col in (870, 950))
    assert np.abs(down - up).max() > 0.9 * down.max()


def test_both_shutters_see_the_middle_row_at_the_same_time(shutters):
    still, rolling = shutters["still"][1], shutters["rolling"][1]
    row = slice(511, 513)
    for cols in (slice(60, 420), slice(450, 1024)):
        ours, theirs = (image[row, cols].sum(axis=0) for image in (rolling, still))
        # Streak 2 starts and ends in the same columns; 4 to 7 cross the row at the same place.
        assert np.argmax(ours) == pytest.approx(np.argmax(theirs), abs=1)
    first, second = rolling[row, 60:420].sum(axis=0), still[row, 60:420].sum(axis=0)
    assert np.abs(first - second).max() < 0.02 * second.max()


@pytest.mark.slow
def test_curved_streak_bends_and_varies_by_40_percent_without_a_roll_of_the_camera():
    made = simulator_of("curved_streak")
    assert made.options.pointing.roll_rate_deg_s == 0.0
    streaks = made.frame(2)[1].streaks
    assert len(streaks) == 1
    assert abs(streaks["sagitta_px"][0]) > 2.5
    # What the pixels show: light per column falls by 40 % of its mean from one end to the other.
    bare = simulator_of("curved_streak", "stars.enabled=false").mean_electrons(2)
    low, high = sorted((float(streaks["col0"][0]), float(streaks["col1"][0])))
    row = int(0.5 * (streaks["row0"][0] + streaks["row1"][0]))
    light = (bare[row - 60 : row + 60] - np.median(bare[row - 60 : row + 60])).sum(axis=0)[int(low) + 12 : int(high) - 12]
    assert np.ptp(light) / light.mean() == pytest.approx(0.40, abs=0.03)
    straight = simulator_of("curved_streak", "instrument.distortion.k1=0.0").frame(2)[1].streaks
    assert abs(straight["sagitta_px"][0]) < 0.2 * abs(streaks["sagitta_px"][0])


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


def test_a_measured_camera_is_one_preset_away(tmp_path):
    """`as_measured` lies under a scenario's own keys; its departures are drawn, its PSF is no Gaussian."""
    path = tmp_path / "measured.toml"
    lines = ['[instrument]\npreset = "smoke_wide"', '[psf]\npreset = "as_measured"', '[stars]\nfaint_limit = "12 mag"']
    path.write_text("\n\n".join(['epoch_utc = "2027-01-29T00:00:00"\nframes = 1', *lines]))
    made = simulator_of(str(path), "population.classes=[]")
    image = made.mean_electrons(0)
    assert made.options.psf.wavefront.rms_nm == 250.0
    assert made.options.instrument.as_built.focal_length_ppm != 150.0
    assert made.options.stars.faint_limit_mag == 12.0
    field = made._camera.psf_field
    assert field is not None
    assert 0.97 < field.halo.core_share < 0.99
    assert np.isfinite(image).all()
