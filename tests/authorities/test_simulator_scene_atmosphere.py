"""Refraction against ERFA `refco`, air mass and Young's scintillation formula."""

import erfa
import numpy as np
import pytest

from simulator.scene.atmosphere import Atmosphere, AtmosphereOptions, air_mass, clouds_of, scintillation_rms

ARCSEC = np.pi / 648000.0
UP = np.array([0.0, 0.0, 1.0])


def air_over(options, height_m, *, seed=1, time_s=0.0, up=UP):
    return Atmosphere(options=options, up=up, height_m=height_m, clouds=clouds_of(options, seed), time_s=time_s)


def at_zenith_distance(degrees):
    z = np.radians(np.atleast_1d(degrees))
    return np.stack([np.sin(z), np.zeros_like(z), np.cos(z)], axis=-1)


def zenith_distance(directions):
    return np.arccos(directions @ UP)


@pytest.mark.parametrize(("height_m", "celsius"), [(0.0, 15.0), (565.0, 5.0), (2400.0, -5.0)])
def test_refraction_within_a_hundredth_of_refco(height_m, celsius):
    options = AtmosphereOptions(temperature_k=celsius + 273.15, humidity=0.4, wavelength_nm=600.0)
    air = air_over(options, height_m)
    pressure_hpa = 1013.25 * (1.0 - 2.25577e-5 * height_m) ** 5.25588
    a, b = erfa.refco(pressure_hpa, celsius, 0.4, 0.6)
    true = np.array([10.0, 30.0, 45.0, 60.0, 70.0])
    observed = zenith_distance(air.refracted(at_zenith_distance(true)))
    own = np.radians(true) - observed
    reference = a * np.tan(observed) + b * np.tan(observed) ** 3
    assert np.abs(own - reference).max() < 0.5 * ARCSEC
    assert np.abs(own / reference - 1.0).max() < 0.01
    assert 55.0 * ARCSEC < own[2] * 1013.25 / pressure_hpa < 62.0 * ARCSEC  # about 58 arcsec at 45 deg


def test_refraction_and_its_inverse_cancel():
    air = air_over(AtmosphereOptions(), 565.0)
    directions = at_zenith_distance(np.linspace(0.0, 75.0, 31))
    assert np.abs(air.unrefracted(air.refracted(directions)) - directions).max() < 1e-3 * ARCSEC


def test_near_objects_are_lifted_less():
    """Parallactic refraction: 435 arcsec tan z sec z / range in km (Brown 1957), here with an 8 km scale height."""
    air = air_over(AtmosphereOptions(pressure=1.0, temperature_k=273.15, humidity=0.0), 0.0)
    far = zenith_distance(air.refracted(at_zenith_distance(45.0)))
    near = zenith_distance(air.refracted(at_zenith_distance(45.0), 1000.0))
    expected = 435.0 / 1000.0 * np.tan(np.radians(45.0)) / np.cos(np.radians(45.0)) * ARCSEC
    assert near[0] - far[0] == pytest.approx(expected, rel=0.15)


def test_air_mass():
    # 85 deg true is 84.84 deg apparent, where Kasten & Young (1989, Appl. Opt. 28, 4735) give 10.04
    assert air_mass(np.cos(np.radians([0.0, 60.0, 85.0]))) == pytest.approx([1.0, 1.994, 10.04], abs=0.03)


def test_scintillation_of_young_1967():
    # Dravins et al. 1998 (PASP 110, 610): 0.09 D^(-2/3) for T = 0.5 s at sea level in the zenith
    assert scintillation_rms(0.4, 1.0, 0.0, 0.5) == pytest.approx(0.09 * 40.0 ** (-2 / 3))
    assert scintillation_rms(0.4, 2.0, 8000.0, 2.0) == pytest.approx(0.09 * 40.0 ** (-2 / 3) * 2.0**1.75 / np.e / 2.0)
    air = air_over(AtmosphereOptions(), 0.0)
    factors = air.flicker(20000, UP, 0.4, 0.5, seed=1, frame=0)
    assert factors.mean() == pytest.approx(1.0, abs=5e-4)
    assert factors.std() == pytest.approx(0.09 * 40.0 ** (-2 / 3), rel=0.03)


@pytest.mark.parametrize(("exposure_s", "diameter_m"), [(20.0, 0.4), (5.0, 0.2)])
def test_brightness_along_a_trail_has_youngs_variance_over_long_exposures(exposure_s, diameter_m):
    """Means over exposures of 500 and 250 crossing times against Young's formula; n = 300, so that 3 sigma are 12 %."""
    air = air_over(AtmosphereOptions(), 565.0)
    means = []
    for k in range(300):
        drawn = air.unsteadiness(UP, diameter_m, 100.0, 100.0 + exposure_s, np.random.default_rng(k))
        means.append(drawn.at(np.linspace(100.0, 100.0 + exposure_s, 4001))[0].mean())
    assert np.mean(means) == pytest.approx(1.0, abs=1e-3)
    assert np.std(means) == pytest.approx(float(scintillation_rms(diameter_m, 1.0, 565.0, exposure_s)), rel=0.13)


def test_brightness_is_steady_within_a_tenth_of_the_crossing_time():
    """Autocorrelation: near 1 within D / 10 V, below 0.2 after three crossings."""
    air = air_over(AtmosphereOptions(wind_m_s=10.0), 0.0)
    drawn = air.unsteadiness(UP, 0.4, 0.0, 60.0, np.random.default_rng(1))
    at = np.arange(0.0, 59.0, 0.004)
    factor = drawn.at(at)[0] - 1.0
    correlation = [float(np.mean(factor[:-k] * factor[k:]) / np.mean(factor**2)) for k in (1, 30)]
    assert correlation[0] > 0.95
    assert abs(correlation[1]) < 0.2


def test_image_motion_has_the_variance_of_sarazin_and_roddier():
    """0.18 lambda^2 r0^(-5/3) D^(-1/3): 0.28 arcsec on each axis for 0.9 arcsec at 500 nm over 1 m."""
    options = AtmosphereOptions(seeing_arcsec=0.9, wavelength_nm=500.0)
    air = air_over(options, 0.0)
    fried_m = 0.98 * 500e-9 / (0.9 * ARCSEC)
    expected = np.sqrt(0.18) * 500e-9 * fried_m ** (-5 / 6) * 1.0 ** (-1 / 6)
    assert expected / ARCSEC == pytest.approx(0.28, abs=0.03)
    drawn = [air.unsteadiness(UP, 1.0, 0.0, 100.0, np.random.default_rng(k)) for k in range(20)]
    assert drawn[0].tilt_sigma_rad == pytest.approx(expected, rel=1e-6)
    spread = np.sqrt(np.mean([d.shift_rad**2 for d in drawn], axis=(0, 1)))
    assert spread == pytest.approx(np.full(2, expected), rel=0.1)


def test_each_half_of_turbulence_has_its_switch():
    def drawn(**options):
        air = air_over(AtmosphereOptions(**options), 0.0)
        return air.unsteadiness(UP, 0.4, 0.0, 10.0, np.random.default_rng(1))

    assert drawn(scintillation=False, image_motion=False) is None
    assert (drawn(scintillation=False).factor == 1.0).all()
    assert drawn(scintillation=False).shift_rad.std() > 0.0
    assert not drawn(image_motion=False).shift_rad.any()
    assert drawn(image_motion=False).tilt_sigma_rad == 0.0
    assert drawn(image_motion=False).factor.std() > 0.0


def test_extinction_and_clouds():
    air = air_over(AtmosphereOptions(extinction_mag=0.2, cloud_transmission=0.5), 0.0)
    assert air.transmission(at_zenith_distance(60.0))[0] == pytest.approx(0.5 * 10 ** (-0.4 * 0.2 * 1.994), rel=1e-3)


SITE_UP = np.array([0.6, 0.0, 0.8])
EAST, NORTH = np.array([0.0, 1.0, 0.0]), np.array([-0.8, 0.0, 0.6])
CLOUDY = AtmosphereOptions(
    extinction_mag=0.0,
    cloud_transmission=0.6,
    cloud_variation=0.1,
    cloud_wind_m_s=20.0,
    cloud_heading_deg=90.0,
    cloud_height_km=5.0,
)


def through_clouds(east_km, north_km, time_s, seed=1, options=CLOUDY):
    """Transmission above places of the layer, 5 km up."""
    vectors = 5.0 * SITE_UP + np.multiply.outer(east_km, EAST) + np.multiply.outer(north_km, NORTH)
    directions = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return air_over(options, 0.0, seed=seed, time_s=time_s, up=SITE_UP).transmission(directions)


def test_clouds_have_structure_of_the_asked_rms():
    """Over layers of 40 seeds: mean and rms as asked, and nearby places are more alike than far ones, by Kolmogorov's 2/3."""
    place_km = np.linspace(-6.0, 6.0, 400)
    zero = np.zeros_like(place_km)
    drawn = np.array([through_clouds(place_km, zero, 0.0, seed=seed) for seed in range(40)])
    assert drawn.mean() == pytest.approx(0.6, abs=0.01)
    assert np.sqrt(((drawn - 0.6) ** 2).mean()) == pytest.approx(0.1, rel=0.1)
    step = 12.0 / 399.0
    growth = [((drawn[:, n:] - drawn[:, :-n]) ** 2).mean() for n in (round(0.2 / step), round(0.8 / step))]
    assert np.log(growth[1] / growth[0]) / np.log(4.0) == pytest.approx(2.0 / 3.0, abs=0.15)
    steady = AtmosphereOptions(extinction_mag=0.0, cloud_transmission=0.6)
    assert (through_clouds(place_km, zero, 0.0, options=steady) == 0.6).all()


def test_clouds_go_with_the_wind():
    """20 m/s to the east move the layer by 2 km in 100 s; the same place sees other clouds then."""
    place_km = np.linspace(-3.0, 3.0, 50)
    north_km = np.full_like(place_km, 0.4)
    before = through_clouds(place_km, north_km, 0.0)
    assert through_clouds(place_km + 2.0, north_km, 100.0) == pytest.approx(before, abs=1e-9)
    assert np.abs(through_clouds(place_km, north_km, 100.0) - before).max() > 0.02
    assert np.abs(through_clouds(place_km, north_km, 0.0, seed=2) - before).max() > 0.02
