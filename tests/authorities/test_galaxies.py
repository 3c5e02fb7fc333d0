"""Galaxies against survey counts, closed forms of their profiles, and the light they add."""

import numpy as np
import pytest
from astropy_healpix import HEALPix
from scipy.integrate import quad
from scipy.special import gamma

from simulator.optics.instrument import InstrumentOptions
from simulator.scene.galaxies import (
    Galaxies,
    GalaxyOptions,
    GalaxySky,
    cumulative_galaxies_deg2,
    draw_galaxies,
    points_of,
    radius_of_light,
    thinned_by_dust,
)

POLE = np.array([-0.8676661356833737, -0.1980763872750533, 0.4559837919562393])


def test_counts_are_those_of_surveys():
    """SDSS: 92 a square degree to r = 17.77 (Strauss et al. 2002); Euclidean sum of a luminosity function (Blanton et al.); 15 %.

    A Euclidean law overestimates the faint end by what redshift takes, so 9 lies between the two.
    """
    assert float(cumulative_galaxies_deg2(17.77 + 0.36)) == pytest.approx(92.0, rel=0.15)
    # phi* = 0.0149 h^3 Mpc^-3, M* = -20.44 + 5 log h, alpha = -1.05: a third of the integral of phi 10^(0.6 (m - M - 25)).
    per_sr = 0.0149 * gamma(2.5 - 1.05) * 10.0 ** (0.6 * (16.0 + 20.44 - 25.0)) / 3.0
    assert float(cumulative_galaxies_deg2(16.0 + 0.36)) == pytest.approx(per_sr * np.radians(1.0) ** 2, rel=0.15)


def test_drawn_galaxies_follow_the_counts_and_hide_behind_dust():
    """Numbers to Poisson's error, magnitudes at 10^(0.6 V), fewer at low latitudes by the closed form."""
    options, healpix = GalaxyOptions(density=1.0, faint_limit_mag=17.0), HEALPix(nside=32, order="nested")
    drawn = [draw_galaxies(options, 1, pixel) for pixel in range(0, 12288, 24)]
    direction, v_mag = np.concatenate([g.direction for g in drawn]), np.concatenate([g.v_mag for g in drawn])
    lon, lat = healpix.healpix_to_lonlat(np.arange(0, 12288, 24))
    middle = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    expected = float(cumulative_galaxies_deg2(17.0)) * healpix.pixel_area.to_value("deg2") * thinned_by_dust(middle).sum()
    assert len(v_mag) == pytest.approx(expected, abs=4.0 * expected**0.5 + 0.01 * expected)
    assert np.log10((v_mag < 17.0).sum() / (v_mag < 16.0).sum()) == pytest.approx(0.6, abs=0.03)
    assert thinned_by_dust(POLE[None])[0] == pytest.approx(1.0)
    assert (np.abs(np.degrees(np.arcsin(direction @ POLE))) < 3.0).sum() < 0.01 * len(v_mag)


@pytest.mark.parametrize("sersic", [1.0, 4.0])
def test_points_lie_as_the_light_of_a_sersic_profile_does(sersic):
    """Half within the effective radius; the share within twice it by integrating exp(-b r^(1/n)); axis ratio 0.4 at 30 deg."""
    assert radius_of_light(sersic, np.array([0.5]))[0] == pytest.approx(1.0, rel=1e-6)
    b = 2.0 * sersic - 1.0 / 3.0 + 4.0 / 405.0 / sersic  # Ciotti & Bertin 1999, A&A 352, 447
    law = [quad(lambda r: r * np.exp(-b * r ** (1.0 / sersic)), 0.0, top)[0] for top in (2.0, np.inf)]
    assert radius_of_light(sersic, np.array([law[0] / law[1]]))[0] == pytest.approx(2.0, rel=2e-3)
    one = {"v_mag": 13.0, "radius_rad": 1e-4, "ratio": 0.4, "angle_rad": np.radians(30.0), "sersic": sersic, "b_v": 0.8}
    made = Galaxies(direction=np.array([[0.6, 0.8, 0.0]]), **{k: np.array([v]) for k, v in one.items()})
    seen = points_of(made, 0, 4000)
    east, north = seen @ np.array([-0.8, 0.6, 0.0]), seen[:, 2]
    along, across = np.sin(np.pi / 6) * east + np.cos(np.pi / 6) * north, np.cos(np.pi / 6) * east - np.sin(np.pi / 6) * north
    radius = np.hypot(along, across / 0.4) / 1e-4
    assert np.median(radius) == pytest.approx(radius_of_light(sersic, np.array([0.49]))[0], rel=0.01)
    near = radius < 3.0
    assert np.std(across[near]) / np.std(along[near]) == pytest.approx(0.4, rel=0.03)
    assert abs(seen.mean(axis=0) @ np.array([-0.8, 0.6, 0.0])) < 2e-6


def test_the_points_carry_the_light_of_their_galaxies():
    """98 % of zero point times 10^(-0.4 V) times colour, however many points; the same whichever direction was asked first."""
    instrument, options = InstrumentOptions(), GalaxyOptions(density=1.0, faint_limit_mag=15.0)
    fresh, used = (GalaxySky(options, instrument, seed=2) for _ in range(2))
    used.around(np.array([0.0, 0.1, 0.995]), 1.0)
    field = fresh.around(POLE, 4.0)
    for name in ("direction", "flux_e_s", "star_id"):
        assert np.array_equal(getattr(field, name), getattr(used.around(POLE, 4.0), name))
    for identity in np.unique(field.star_id)[:20]:
        own = field.star_id == identity
        expected = 0.98 * instrument.true_zero_point_e_s * 10.0 ** (-0.4 * float(field.v_mag[own][0]))
        expected *= float(instrument.colour_factor(field.b_v[own][:1].astype(float))[0])
        assert field.flux_e_s[own].sum() == pytest.approx(expected, rel=1e-4)
