"""Asteroids against published counts, the H, G system's own integral, and closed forms of their motion."""

import erfa
import numpy as np
import pytest

from simulator.optics.instrument import InstrumentOptions
from simulator.platform.earth import AU_KM, DAY_S, earth_velocity_km_s, sun_position_km, tai_ns_of_utc
from simulator.platform.kepler import Elements
from simulator.scene.asteroids import (
    ELEMENTS_UTC,
    AsteroidOptions,
    AsteroidSky,
    Belt,
    asteroid_magnitude,
    cumulative_number,
    draw_belt,
    seen_from,
    whole,
)

TO_ECLIPTIC = erfa.ecm06(2451545.0, 0.0)
NOTHING = np.zeros(3)


def one(a_au, mean_anomaly_rad):
    """A belt of one asteroid in the ecliptic."""
    values = [np.array([x]) for x in (a_au, 0.0, 0.0, 0.0, 0.0, mean_anomaly_rad)]
    names = ("a_km", "e", "i_rad", "node_rad", "argp_rad", "mean_anomaly_rad")
    return Belt(elements=Elements(**dict(zip(names, values, strict=True))), h_mag=np.array([10.0]), b_v=np.array([0.7]))


def test_the_sky_at_opposition_is_as_dense_as_surveys_found_it():
    """SKADS (Gladman et al. 2009): 210 a square degree within 1 deg of the ecliptic to R = 23 (V = 23.4), growing as 10^(0.27 R).

    DECam (Heinze et al. 2019, AJ 158, 232) has 10^((0.28 +- 0.02) R). Six dates, a fiftieth of the belt.
    """
    share, limits = 0.02, (21.4, 22.4, 23.4)
    belt, found = whole(draw_belt(AsteroidOptions(density=share, faint_limit_mag=limits[-1]), 3)), np.zeros(3)
    for month in range(1, 7):
        tai_ns = tai_ns_of_utc(f"2026-{month:02d}-22T00:00:00")
        seen, v_mag = seen_from(belt, tai_ns, NOTHING)
        x, y, z = (seen @ TO_ECLIPTIC.T).T
        sun = TO_ECLIPTIC @ sun_position_km(tai_ns)
        apart = (np.arctan2(y, x) - np.arctan2(-sun[1], -sun[0]) + np.pi) % (2 * np.pi) - np.pi
        inside = (np.abs(np.degrees(apart)) < 5.0) & (np.abs(np.degrees(np.arcsin(z))) < 1.0)
        found += [np.count_nonzero(inside & (v_mag < limit)) for limit in limits]
    per_deg2 = found / (6 * 20.0 * share)
    assert per_deg2[-1] == pytest.approx(210.0, rel=0.1)
    assert np.log10(per_deg2[-1] / per_deg2[0]) / 2.0 == pytest.approx(0.28, abs=0.04)


def test_there_are_as_many_kilometre_asteroids_as_infrared_counts_say():
    """(1.2 +- 0.5) million above 1 km (Tedesco & Desert 2002, AJ 123, 2070): H = 18.1 at their typical albedo of 0.1."""
    h_mag = 5.0 * np.log10(1329.0 / np.sqrt(0.1))
    assert abs(float(cumulative_number(h_mag)) - 1.2e6) < 0.5e6


def test_brightness_integrates_to_the_phase_integral_of_the_system():
    """q = 0.290 + 0.684 G (Bowell et al. 1989): twice the integral of phase function times sine; 3 %."""
    span = np.radians(150.0)
    phase = (np.arange(20_000) + 0.5) / 20_000 * span
    law = 10.0 ** (-0.4 * asteroid_magnitude(np.zeros(1), np.ones(1), np.ones(1), phase))
    assert 2.0 * np.mean(law * np.sin(phase)) * span == pytest.approx(0.290 + 0.684 * 0.15, rel=0.03)
    assert asteroid_magnitude(np.array([12.0]), np.array([2.5]), np.array([1.5]), np.array([0.0]))[0] == pytest.approx(
        12.0 + 5.0 * np.log10(2.5 * 1.5)
    )


@pytest.mark.parametrize("a_au", [2.2, 2.7, 3.9])
def test_an_asteroid_at_opposition_moves_backwards_at_the_closed_form(a_au):
    """A circle of radius a against the Earth's true motion: (k / sqrt(a) - v) / (a - r) on the sky, 1 %.

    It stays in the ecliptic within 1 arcsec. 17 to 42 arcsec an hour: nothing in an exposure, pixels in an hour.
    """
    tai_ns = tai_ns_of_utc(ELEMENTS_UTC)
    sun = TO_ECLIPTIC @ sun_position_km(tai_ns) / AU_KM
    belt = one(a_au, float(np.arctan2(-sun[1], -sun[0])))
    step_s = 1800.0
    first, second = (TO_ECLIPTIC @ seen_from(belt, tai_ns + round(k * step_s * 1e9), NOTHING)[0][0] for k in (-1, 1))
    turned = np.arctan2(np.cross(first, second)[2], first @ second) / (2.0 * step_s)
    away = -sun / np.linalg.norm(sun)
    earth_au_s = np.cross(away, TO_ECLIPTIC @ earth_velocity_km_s(tai_ns))[2] / AU_KM
    expected = (0.01720209895 / DAY_S / np.sqrt(a_au) - earth_au_s) / (a_au - np.linalg.norm(sun))
    assert turned == pytest.approx(expected, rel=0.01)
    assert -42.0 < np.degrees(turned) * 3600.0 * 3600.0 < -17.0
    assert abs(np.degrees(first[2]) * 3600.0) < 1.0 + np.degrees(abs(sun[2])) * 3600.0


def test_a_frame_gets_the_same_asteroids_whichever_came_before():
    """Directions and light at an instant do not depend on what was asked before; light follows V."""
    options, instrument = AsteroidOptions(density=1.0, faint_limit_mag=16.0), InstrumentOptions()
    asked = [tai_ns_of_utc(f"2027-01-29T00:{minute:02d}:00") for minute in (0, 20)]
    away = -sun_position_km(asked[1])
    away /= np.linalg.norm(away)
    fresh, used = (AsteroidSky(options, instrument, seed=5) for _ in range(2))
    used.around(away, 6.0, asked[0], NOTHING)
    one_, other = (sky.around(away, 6.0, asked[1], NOTHING) for sky in (fresh, used))
    within = [f.direction @ away > np.cos(np.radians(6.0)) for f in (one_, other)]
    assert within[0].sum() > 10
    for name in ("star_id", "direction", "flux_e_s"):
        assert np.array_equal(getattr(one_, name)[within[0]], getattr(other, name)[within[1]]), name
    assert one_.v_mag.max() < 16.0
