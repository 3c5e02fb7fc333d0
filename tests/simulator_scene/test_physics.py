"""Single effects of platform and scene against closed forms and brute force."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sboc_e2e.icd.errors import UserError
from simulator.platform import earth
from simulator.platform.earth_orientation import ARCSEC_RAD
from simulator.platform.jitter import JitterOptions, VibrationLine, make_jitter
from simulator.platform.kepler import Elements, elements_deg, elements_of, state_of, velocity_through
from simulator.platform.observer import PlatformOptions, j2_rates, make_observer
from simulator.platform.pointing import PointingOptions, commanded_attitude
from simulator.platform.rotation import quaternion_of, rotation_vector_of, small_rotation, turned
from simulator.platform.shutter import ClockOptions, ShutterOptions, frame_timing
from simulator.scene import sky
from simulator.scene.crossing import RowShutter, exposed_intervals
from simulator.scene.debris import SizeClass, draw_orbits, number_larger, orbit_histogram
from simulator.scene.encounters import PopulationOptions, Window, draw_candidates, number_density, spatial_density
from simulator.scene.light import LightOptions
from simulator.scene.objects import orbit_positions
from simulator.scene.reflection import LightCurve, in_sight, lambert_flux, sunlit_fraction
from simulator.scene.sources import SkyPathOptions, kepler_object, sky_path
from simulator.scene.stars import _hash64, cumulative_counts_deg2, displaced, unit_vectors

EPOCH = "2027-01-29T00:00:00"


# ------------------------------------------------------------------ two-body


@given(
    a=st.floats(6800.0, 45000.0),
    e=st.floats(0.0, 0.8),
    i=st.floats(1.0, 179.0),
    node=st.floats(0.0, 359.0),
    perigee=st.floats(0.0, 359.0),
    anomaly=st.floats(-180.0, 180.0),
)
def test_elements_and_states_are_inverse(a, e, i, node, perigee, anomaly):
    position, velocity = state_of(elements_deg(a, e, i, node, perigee, anomaly))
    back = elements_of(position, velocity)
    again, again_velocity = state_of(back)
    assert np.abs(again - position).max() < 1e-6 * a
    assert np.abs(again_velocity - velocity).max() < 1e-6
    assert float(back.a_km) == pytest.approx(a, rel=1e-9)
    assert float(back.e) == pytest.approx(e, abs=1e-9)


def test_two_body_motion_obeys_newton():
    elements = elements_deg(7500.0, 0.1, 50.0, 10.0, 20.0, 30.0)
    h = 0.5
    before, here, after = (state_of(elements, t)[0] for t in (-h, 0.0, h))
    acceleration = (after - 2 * here + before) / h**2
    gravity = -earth.MU_KM3_S2 * here / np.linalg.norm(here) ** 3
    assert np.abs(acceleration - gravity).max() < 1e-6 * np.linalg.norm(gravity)


def test_orbits_through_a_point_have_the_wanted_elements():
    rng = np.random.default_rng(3)
    point = np.tile([4000.0, 5000.0, 2500.0], (400, 1))
    a, e, i = rng.uniform(6700.0, 8000.0, 400), rng.uniform(0.0, 0.1, 400), np.radians(rng.uniform(10.0, 170.0, 400))
    velocity = velocity_through(point, a, e, i, rng.random(400) < 0.5, rng.random(400) < 0.5)
    passes = np.isfinite(velocity).all(axis=1)
    found = elements_of(point[passes], velocity[passes])
    assert 50 < passes.sum() < 400
    assert np.abs(found.a_km - a[passes]).max() < 1e-6
    assert np.abs(found.e - e[passes]).max() < 1e-9
    assert np.abs(found.i_rad - i[passes]).max() < 1e-9


def test_observer_velocity_is_the_derivative_of_its_position():
    tai_ns = earth.tai_ns_of_utc(EPOCH)
    observer = make_observer(PlatformOptions(), tai_ns)
    for later_s in (0, 3600):
        t = tai_ns + later_s * 10**9
        before, after = observer.state(t - 10**8)[0], observer.state(t + 10**8)[0]
        assert np.abs((after - before) / 0.2 - observer.state(t)[1]).max() < 1e-6


def test_j2_rates_against_vallado():
    # Vallado 4th ed., section 9.6: a Sun-synchronous orbit's node moves 0.9856 deg/day
    node, _, _ = j2_rates(6378.137 + 700.0, 0.0, np.radians(98.188))
    assert np.degrees(node) * 86400.0 == pytest.approx(0.9856, abs=2e-3)


# ------------------------------------------------------------------ attitude


@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3))
def test_rotation_vectors_and_matrices_are_inverse(vector):
    vector = np.array(vector)
    matrix = small_rotation(vector)
    assert np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-12
    assert np.abs(rotation_vector_of(matrix) - vector).max() < 1e-9
    some = np.array([[0.3, -0.2, 0.9]])
    assert np.abs(turned(some, vector[None]) - some @ matrix.T).max() < 1e-12
    assert np.linalg.norm(quaternion_of(matrix)) == pytest.approx(1.0)


def test_jitter_has_the_asked_rms_and_spectrum():
    options = JitterOptions(
        cross_rms_arcsec=0.5, roll_rms_arcsec=2.0, lines=(VibrationLine(frequency_hz=40.0, rms_arcsec=0.2),),
        drift_x_arcsec_s=0.0, drift_y_arcsec_s=0.0, bias_x_arcsec=0.0, bias_y_arcsec=0.0, bias_roll_arcsec=0.0,
    )  # fmt: skip
    jitter = make_jitter(options, seed=1)
    time_s = np.arange(0.0, 600.0, 1 / 128)
    series = np.concatenate([jitter.rotation_vector(t) for t in np.split(time_s, 20)]) / ARCSEC_RAD
    assert np.sqrt((series[:, 0] ** 2).mean()) == pytest.approx(np.hypot(0.5, 0.2), rel=0.06)
    assert np.sqrt((series[:, 2] ** 2).mean()) == pytest.approx(np.hypot(2.0, 0.2), rel=0.06)
    power = np.abs(np.fft.rfft(series[:, 0])) ** 2 * 2.0 / len(series) ** 2
    hertz = np.fft.rfftfreq(len(series), 1 / 128)
    line = power[(hertz > 39.9) & (hertz < 40.1)].sum()
    assert np.sqrt(line) == pytest.approx(0.2, rel=0.05)
    slow, fast = power[(hertz > 0.02) & (hertz < 0.3)].sum(), power[(hertz > 1.0) & (hertz < 30.0)].sum()
    expected_slow = 0.3 * np.arctan(1.0) - 0.3 * np.arctan(0.02 / 0.3)  # integral of 1 / (1 + (f/f0)^2)
    expected_fast = 0.3 * (np.arctan(100.0) - np.arctan(1.0 / 0.3))
    assert slow / fast == pytest.approx(expected_slow / expected_fast, rel=0.35)


def test_jitter_is_random_access():
    jitter = make_jitter(JitterOptions(), seed=9)
    time_s = np.linspace(0.0, 3.0, 50)
    alone, among = jitter.rotation_vector(time_s[17:18]), jitter.rotation_vector(time_s)[17:18]
    assert np.abs(alone - among).max() < 1e-15


def test_nadir_law_turns_once_each_orbit():
    tai_ns = earth.tai_ns_of_utc(EPOCH)
    observer = make_observer(PlatformOptions(), tai_ns)
    attitude = commanded_attitude(PointingOptions(law="nadir", tilt_deg=-90.0), observer, tai_ns)
    turn = rotation_vector_of(attitude(tai_ns + 10**10) @ attitude(tai_ns).T)
    rate_deg_s = np.degrees(turn) / 10.0
    assert abs(rate_deg_s[2]) == pytest.approx(360.0 / 5926.0, rel=0.01)  # about the boresight
    assert np.hypot(rate_deg_s[0], rate_deg_s[1]) < 1e-3
    zenith = commanded_attitude(PointingOptions(law="nadir", tilt_deg=180.0), observer, tai_ns)(tai_ns)[2]
    position = observer.state(tai_ns)[0]
    assert zenith @ position / np.linalg.norm(position) == pytest.approx(1.0, abs=1e-12)


def test_time_tags_carry_offset_and_drift():
    common = {"seed": 1, "epoch_tai_ns": 10**18, "frame_rate_hz": 4.0, "rows": 100, "row_step": 1}
    clock = ClockOptions(offset_us=500.0, drift_ppm=2.0, jitter_us=0.0)
    timing = frame_timing(ShutterOptions(), clock, frame=40, **common)
    assert timing.clock_tai_ns - timing.t_start_tai_ns == 500_000 + 20_000  # 10 s at 2 ppm
    tags = [frame_timing(ShutterOptions(), ClockOptions(jitter_us=3.0), frame=k, **common) for k in range(400)]
    spread_us = np.std([t.clock_tai_ns - t.t_start_tai_ns for t in tags]) / 1e3
    assert spread_us == pytest.approx(3.0, rel=0.12)


# --------------------------------------------------------------------- light


def test_lambert_sphere_at_zero_phase():
    """V = -26.76 - 2.5 log10(a d^2 / 6 R^2): 10 cm at 1000 km, albedo 0.1, is 12.7."""
    sun = np.array([[-earth.AU_KM, 0.0, 0.0]])
    flux = lambert_flux(0.1, 0.1, np.array([[1000.0, 0.0, 0.0]]), np.zeros((1, 3)), sun)
    assert -2.5 * np.log10(flux[0]) == pytest.approx(12.7, abs=0.05)
    half = lambert_flux(0.1, 0.1, np.array([[0.0, 1000.0, 0.0]]), np.zeros((1, 3)), sun)
    assert half[0] / flux[0] == pytest.approx(1.0 / np.pi, rel=1e-3)  # phase 90 deg


def test_lambert_phase_function_conserves_light():
    """The mean of the scattered flux over all directions is albedo times the intercepted light: 2/3 a phi integrates to a/4."""
    angle = np.linspace(0.0, np.pi, 20001)
    phase = (np.sin(angle) + (np.pi - angle) * np.cos(angle)) / np.pi
    assert np.trapezoid(phase * np.sin(angle), angle) == pytest.approx(0.75, rel=1e-6)  # phase integral q = 2 x this = 3/2


def test_shadow_umbra_penumbra_and_light():
    sun = np.array([earth.AU_KM, 0.0, 0.0])
    x = -42164.0
    umbra = earth.EARTH_RADIUS_KM + x * 0.004609
    penumbra = earth.EARTH_RADIUS_KM - x * 0.004694
    points = np.array(
        [[x, y, 0.0] for y in (0.0, umbra - 20.0, umbra + 20.0, 0.5 * (umbra + penumbra), penumbra - 20.0, penumbra + 20.0)]
    )
    share = sunlit_fraction(points, sun)
    assert share[0] == share[1] == 0.0
    assert 0.0 < share[2] < 0.05
    assert share[3] == pytest.approx(0.5, abs=0.05)
    assert 0.95 < share[4] < 1.0
    assert share[5] == 1.0
    assert sunlit_fraction(np.array([[42164.0, 0.0, 0.0]]), sun)[0] == 1.0


def test_the_earth_hides_what_is_behind_it():
    observer = np.array([[7000.0, 0.0, 0.0]] * 3)
    things = np.array([[-7000.0, 0.0, 0.0], [20000.0, 0.0, 0.0], [0.0, 9000.0, 0.0]])
    assert in_sight(things, observer).tolist() == [False, True, False]  # the last line passes 5525 km from the centre
    site = np.array([[6378.0, 0.0, 0.0]])
    assert in_sight(np.array([[7000.0, 500.0, 0.0]]), site)[0]


def test_light_time_of_a_far_object():
    elements = elements_deg(42164.0, 0.0, 5.0, 0.0, 0.0, 0.0)
    thing = kepler_object("x", "orbit", 1.0, 0.1, elements, 0.0)
    observer = np.zeros((1, 3))
    seen = thing.seen(np.zeros(1), observer, np.array([earth.AU_KM, 0.0, 0.0]), LightOptions()).vector_km[0]
    delay_s = 42164.0 / earth.LIGHT_KM_S
    assert np.abs(seen - orbit_positions(elements)(np.array([-delay_s]))[0]).max() < 1e-6
    assert np.linalg.norm(seen - orbit_positions(elements)(np.zeros(1))[0]) == pytest.approx(3.0747 * delay_s, rel=1e-3)


def test_tumbling_and_glints():
    curve = LightCurve(period_s=2.0, amplitude=0.4, glint_factor=30.0, glint_width_s=0.01)
    time_s = np.linspace(0.0, 20.0, 200001)
    factor = curve.factor(time_s)
    assert np.trapezoid(factor, time_s) / 20.0 == pytest.approx(1.0 + 30.0 * 0.01 * np.sqrt(2 * np.pi) / 2.0, rel=1e-3)
    assert factor.max() == pytest.approx(31.0, abs=0.5)


def test_sky_path_keeps_its_rate():
    path = sky_path(SkyPathOptions(ra_deg=50.0, dec_deg=60.0, east_arcsec_s=300.0, north_arcsec_s=400.0))
    seen = path.seen(np.array([0.0, 100.0]), np.zeros((2, 3)), np.zeros(3), LightOptions()).vector_km
    cosine = seen[0] @ seen[1] / np.linalg.norm(seen[0]) / np.linalg.norm(seen[1])
    assert np.degrees(np.arccos(cosine)) * 3600.0 == pytest.approx(50000.0, rel=1e-6)


@pytest.mark.parametrize(
    ("beta_deg", "from_sun_deg", "mag"),
    [
        (0.0, 180.0, 22.15),
        (5.0, 180.0, 22.23),
        (20.0, 180.0, 22.52),
        (60.0, 180.0, 23.25),
        (90.0, 180.0, 23.33),
        (0.0, 150.0, 22.42),
    ],
)
def test_zodiacal_light_of_leinert(beta_deg, from_sun_deg, mag):
    obliquity = np.radians(23.4392911)
    c, s = np.cos(obliquity), np.sin(obliquity)
    to_equator = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    direction = to_equator @ unit_vectors(np.array(from_sun_deg), np.array(beta_deg))
    flux = sky.diffuse_flux(sky.SkyOptions(unresolved=0.0), direction[None], np.array([earth.AU_KM, 0.0, 0.0]))
    assert -2.5 * np.log10(flux[0]) == pytest.approx(mag, abs=0.012)


def test_every_cell_of_the_zodiacal_table():
    """Sums over latitudes and over longitudes (from 15 deg on) of the copy of Leinert's table 17 in EXOSIMS 3.6.6 (BSD-3)."""
    table = sky._ZODIACAL[3:]
    assert table.sum(axis=1).astype(int).tolist() == [
        26544,
        17253,
        11737,
        8372,
        6225,
        4854,
        3984,
        2627,
        2038,
        1719,
        1523,
        1399,
        1353,
        1374,
        1490,
        1597,
    ]
    assert table.sum(axis=0).astype(int).tolist() == [30246, 21066, 12890, 8541, 6144, 4753, 3795, 2391, 1678, 1353, 1232]
    assert sky._ZODIACAL[0, 3:].tolist() == [3140, 1610, 985, 640, 275, 150, 100, 77]


def test_galactic_pole_is_dark_and_the_plane_bright():
    pole = unit_vectors(np.array(192.85948), np.array(27.12825))[None]
    centre = unit_vectors(np.array(266.405), np.array(-28.936))[None]
    assert sky.unresolved_s10(centre)[0] > 5.0 * sky.unresolved_s10(pole)[0]


def test_stars_are_displaced_by_their_errors_and_only_by_their_number():
    direction = unit_vectors(np.random.default_rng(1).uniform(0, 360, 20000), np.random.default_rng(2).uniform(-80, 80, 20000))
    identity = np.arange(20000)
    sigma = np.full(20000, 5e-7)
    moved = displaced(direction, identity, sigma, word=77)
    shift = np.linalg.norm(moved - direction, axis=1)
    assert np.sqrt((shift**2).mean() / 2.0) == pytest.approx(5e-7, rel=0.02)
    part = displaced(direction[100:200], identity[100:200], sigma[100:200], word=77)
    assert np.array_equal(part, moved[100:200])
    assert len(np.unique(_hash64(identity.astype(np.uint64)))) == 20000


def test_faint_counts():
    assert cumulative_counts_deg2(np.array([12.0, 13.75, 15.5])) == pytest.approx([55.4, 249.0, 972.0])


# ------------------------------------------------------------------- shutter


@given(
    speed=st.floats(-6000.0, 6000.0).filter(lambda v: abs(v) > 1.0),
    start=st.floats(200.0, 800.0),
    line_us=st.floats(0.0, 150.0),
)
def test_exposed_time_of_a_steady_mover(speed, start, line_us):
    """A point at r0 + v t is exposed for T / |1 - v tau|."""
    exposure_s, line_s = 0.01, line_us * 1e-6
    if abs(1.0 - speed * line_s) < 0.1:
        return
    shutter = RowShutter(open_s=0.0, line_s=line_s, exposure_s=exposure_s, rows=1000, cols=1000)
    opens = line_s * start / (1.0 - speed * line_s)

    def place(t):
        return start + speed * t, np.full_like(t, 500.0)

    intervals = exposed_intervals(place, shutter, 1e6, opens - 0.2, opens + 0.2)
    (only,) = intervals
    assert only.end_s - only.start_s == pytest.approx(exposure_s / abs(1.0 - speed * line_s), abs=1e-8)
    assert not only.edge_start
    assert not only.edge_end


# ----------------------------------------------------------------- population


def test_size_law():
    assert number_larger(0.1) == pytest.approx(3.65e4)
    assert number_larger(0.01) == pytest.approx(1.04e6, rel=0.02)
    assert number_larger(0.001) / 1.04e6 == pytest.approx(10**2.10)
    sizes = np.geomspace(0.002, 0.5, 200)
    assert np.abs(-np.gradient(number_larger(sizes), np.log(sizes)) / number_density(sizes) - 1.0)[10:50].max() < 0.01


def test_histogram_sums():
    cells, share, altitude, _, inclination = orbit_histogram()
    assert len(cells) == 1800
    assert share[-1] == 1.0
    assert (altitude[0], inclination[-1]) == (200.0, 144.0)


def test_drawn_orbits_stay_above_the_air():
    rng = np.random.default_rng(1)
    a, e, _ = draw_orbits(rng, np.full(5000, 0.002), spread=True)
    assert (a * (1 - e)).min() > earth.EARTH_RADIUS_KM + 150.0
    narrow, _, _ = draw_orbits(rng, np.full(5000, 0.002), spread=False)
    assert a.std() > 1.3 * narrow.std()


def test_kessler_density_against_counting():
    """Objects on one orbit with random angles, counted in a shell of radius and latitude."""
    rng = np.random.default_rng(2)
    n, a, e, i = 1_000_000, 7300.0, 0.03, np.radians(70.0)
    angles = rng.uniform(0.0, 2 * np.pi, (3, n))
    full = np.ones(n)
    position, _ = state_of(
        Elements(a_km=a * full, e=e * full, i_rad=i * full, node_rad=angles[0], argp_rad=angles[1], mean_anomaly_rad=angles[2])
    )
    radius = np.linalg.norm(position, axis=1)
    sine = position[:, 2] / radius
    inside = (np.abs(radius - 7350.0) < 10.0) & (np.abs(sine - 0.5) < 0.02)
    volume = 4.0 / 3.0 * np.pi * (7360.0**3 - 7340.0**3) * 0.02
    point = 7350.0 * np.array([[np.sqrt(0.75), 0.0, 0.5]])
    density = spatial_density(point, np.array([a]), np.array([e]), np.array([i]))[0]
    assert inside.sum() / n / volume == pytest.approx(density, rel=0.05)


def default_window():
    tai_ns = earth.tai_ns_of_utc(EPOCH)
    observer = make_observer(PlatformOptions(), tai_ns)
    attitude = commanded_attitude(PointingOptions(), observer, tai_ns)(tai_ns)
    position, velocity = observer.state(tai_ns)
    return Window(
        observer_km=position, velocity_km_s=velocity, attitude=attitude, sun_km=earth.sun_position_km(tai_ns),
        half_row=2048 * 9e-6 / 0.4, half_col=2048 * 9e-6 / 0.4, duration_s=6.0, exposure_s=0.2, flux_e_s=4.7e8,
        focal_px=44444.0, sigma_px=0.85, noise_variance_e2=8.1, aperture_m=0.2, effects=LightOptions(),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("from_mm", "to_mm", "low", "high"),
    # detectable objects (S/N 8) in 6 s: sub-centimetre 0.04 to 0.06 within a factor of two; all of them 1.1 to 1.5 within
    # a factor of three, slow ones that share the camera's type of orbit left out
    [(1.0, 10.0, 0.02, 0.12), (10.0, 3000.0, 0.5, 4.0)],
)
def test_natural_encounters_of_a_run(from_mm, to_mm, low, high):
    options = PopulationOptions(candidates=60000)
    found = draw_candidates(options, SizeClass(from_mm=from_mm, to_mm=to_mm), default_window(), np.random.default_rng(1))
    detectable = (found.snr >= 8.0) & (found.rate_deg_s > 0.1)
    assert low < found.natural[detectable].sum() < high


def test_sampler_counts_what_brute_force_counts():
    """Share of the population inside a wide pyramid at one instant: importance sampling against drawing everybody."""
    wide = replace(default_window(), half_row=np.tan(np.radians(15.0)), half_col=np.tan(np.radians(15.0)), duration_s=1e-3)
    rng = np.random.default_rng(5)
    n = 600_000
    a, e, i = draw_orbits(rng, np.full(n, 0.2), spread=True)
    angles = rng.uniform(0.0, 2 * np.pi, (3, n))
    position, _ = state_of(Elements(a_km=a, e=e, i_rad=i, node_rad=angles[0], argp_rad=angles[1], mean_anomaly_rad=angles[2]))
    camera = (position - wide.observer_km) @ wide.attitude.T
    within = (np.abs(camera[:, :2]) < camera[:, 2:] * wide.half_row).all(axis=1) & (np.linalg.norm(camera, axis=1) < 1500.0)
    options = PopulationOptions(candidates=100000, farthest_km=1500.0, nearest_km=1.0, snr_min=1e-3)
    size_class = SizeClass(from_mm=199.99, to_mm=200.01)
    found = draw_candidates(options, size_class, wide, np.random.default_rng(6))
    everybody = number_density(np.array([0.2]))[0] * np.log(200.01 / 199.99) * 0.8
    share = found.natural.sum() / everybody
    counting_error = np.sqrt(within.sum()) / n
    assert within.sum() > 150
    assert abs(share - within.mean()) < 4.0 * counting_error + 0.04 * share


def test_ranges_of_options_are_checked_together():
    with pytest.raises(UserError, match="nearest"):
        PopulationOptions(nearest_km=100.0, farthest_km=10.0)
    with pytest.raises(UserError, match="perigee"):
        PlatformOptions(kind="kepler", semi_major_axis_km=7000.0, eccentricity=0.3)
    with pytest.raises(UserError, match="jitter"):
        JitterOptions(lowest_hz=10.0, highest_hz=1.0)


@pytest.mark.parametrize(
    ("from_mm", "to_mm", "range_km", "rate_deg_s"),
    # medians of detected objects as they enter the field, of an independent calculation good to a factor of two
    [(1.0, 1.5, 7.0, 8.5), (3.0, 5.0, 13.0, 48.0), (10.0, 15.0, 74.0, 10.0), (50.0, 100.0, 680.0, 1.1)],
)
def test_median_range_and_rate_of_entering_debris(from_mm, to_mm, range_km, rate_deg_s):
    options = PopulationOptions(candidates=40000)
    found = draw_candidates(options, SizeClass(from_mm=from_mm, to_mm=to_mm), default_window(), np.random.default_rng(4))
    entering = np.where((found.snr >= 8.0) & (found.rate_deg_s > 0.1), found.per_day, 0.0)

    def median(values):
        order = np.argsort(values)
        total = np.cumsum(entering[order])
        return values[order][np.searchsorted(total, 0.5 * total[-1])]

    assert 0.5 < median(found.range_km) / range_km < 2.0
    assert 0.5 < median(found.rate_deg_s) / rate_deg_s < 2.0


def test_half_of_sub_centimetre_debris_crosses_within_one_exposure():
    found = draw_candidates(PopulationOptions(), SizeClass(from_mm=1.0, to_mm=10.0), default_window(), np.random.default_rng(4))
    entering = np.where((found.snr >= 8.0) & (found.rate_deg_s > 0.1), found.per_day, 0.0)
    assert 0.3 < entering[found.stay_s < 0.2].sum() / entering.sum() < 0.7
