"""Periods, classes and phase laws of bodies of plane faces, whose light is computed apart (tests/characterisation/facets.py)."""

from dataclasses import replace

import numpy as np
import pytest

from ground.characterisation.judge import characterise, flashes_of
from ground.characterisation.passes import LightPass, light_pass, split_by, sun_km
from ground.characterisation.period import find_period
from ground.characterisation.phase_law import phase_law
from tests.characterisation.facets import Body, box, magnitude, noisy, sight

SIGMA = 0.05


def passes_of(rng: np.random.Generator, body: Body, n: int = 3, sigma: float = SIGMA, slow: float = 0.03) -> list[LightPass]:
    made = []
    for _ in range(n):
        seen = sight(rng)
        mag = noisy(rng, magnitude(body, seen.t_s, seen.to_observer_km, rng.uniform(0, 2 * np.pi)), sigma, slow=slow)
        made.append(
            LightPass(
                t_s=seen.t_s - seen.t_s[0],
                mag=mag - 5.0 * np.log10(seen.range_km / 1000.0),
                mag_err=np.full(len(mag), sigma),
                phase_rad=seen.phase_rad,
            )
        )
    return made


def period_of(rng: np.random.Generator) -> float:
    """Log-uniform from 6 to 100 s."""
    return float(np.exp(rng.uniform(np.log(6.0), np.log(100.0))))


@pytest.mark.parametrize("n", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_periods_of_tumblers_are_right_to_a_percent(n: int) -> None:
    """Boxes in three passes of 400 s; at least nine in ten. A wrong one is a multiple of the period."""
    rng = np.random.default_rng(40 + n)
    right, pulls = 0, []
    for _ in range(n):
        period_s = period_of(rng)
        found = characterise(passes_of(rng, box(rng, period_s))).period
        if abs(found.period_s / period_s - 1.0) < 0.01:
            right += 1
            pulls.append((found.period_s - period_s) / found.period_err_s)
    assert right >= 0.9 * n
    assert 0.4 < np.median(np.abs(pulls)) < 1.1  # 0.67 for normal errors


@pytest.mark.parametrize("n", [20, pytest.param(100, marks=pytest.mark.slow)])
def test_bodies_at_rest_have_no_period(n: int) -> None:
    rng = np.random.default_rng(60 + n)
    found = [characterise(passes_of(rng, box(rng, np.inf))) for _ in range(n)]
    assert sum(np.isfinite(c.period.period_s) for c in found) <= 0.05 * n
    assert sum(c.kind == "stable" for c in found) >= 0.95 * n


def test_false_alarms_are_as_probable_as_they_say() -> None:
    """White noise alone: a false alarm below 0.1 in at most a tenth of 50 objects (95 % limit of the binomial: 9)."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 120.0, 2.0)
    flat = [
        LightPass(t_s=t, mag=rng.normal(0, SIGMA, 100), mag_err=np.full(100, SIGMA), phase_rad=np.ones(100)) for _ in range(100)
    ]
    assert sum(find_period([one]).false_alarm < 0.1 for one in flat) <= 9


def test_flashes_of_mirrors_make_an_object_glinting() -> None:
    """Truth is the same body without its mirrors: a flash adds a magnitude and is one above the bright quarter of that curve."""
    rng = np.random.default_rng(8)
    flashing = found = diffuse = called = 0
    for _ in range(60):
        body, seen, start = box(rng, period_of(rng), mirror=2.0), sight(rng), rng.uniform(0, 2 * np.pi)
        bright = magnitude(body, seen.t_s, seen.to_observer_km, start)
        dull = magnitude(replace(body, mirror=0.0 * body.mirror), seen.t_s, seen.to_observer_km, start)
        flashes = bool(np.any((dull - bright > 1.0) & (np.percentile(dull, 25) - bright > 1.0)))
        for mag, is_diffuse in ((bright, False), (dull, True)):
            one = LightPass(
                t_s=seen.t_s - seen.t_s[0], mag=noisy(rng, mag, SIGMA), mag_err=np.full(len(mag), SIGMA), phase_rad=seen.phase_rad
            )
            if is_diffuse:
                diffuse, called = diffuse + 1, called + (flashes_of(one) > 0)
            elif flashes:
                flashing, found = flashing + 1, found + (flashes_of(one) > 0)
    assert flashing >= 15
    assert found >= 0.8 * flashing
    assert called <= 0.1 * diffuse


@pytest.mark.parametrize("diffuse", [0.0, 0.5, 1.0])
def test_phase_laws_of_spheres(diffuse: float) -> None:
    """Spheres in closed form: Lambert's, and a mirror that is as bright at every phase; eight passes, 3 % scatter."""
    rng = np.random.default_rng(9)
    phases = np.radians(rng.uniform(15, 110, 8))
    passes = []
    for phase in phases:
        law = diffuse * (np.sin(phase) + (np.pi - phase) * np.cos(phase)) + (1 - diffuse)
        mag = 12.0 - 2.5 * np.log10(law) + rng.normal(0, 0.03)
        passes.append(
            LightPass(t_s=np.arange(30.0), mag=np.full(30, mag), mag_err=np.full(30, 0.03), phase_rad=np.full(30, phase))
        )
    law_found = phase_law(passes)
    assert law_found.standard_mag == pytest.approx(12.0, abs=0.04)
    assert law_found.diffuse == pytest.approx(diffuse, abs=max(3.0 * law_found.diffuse_err, 0.02))
    assert np.isnan(phase_law(passes[:1]).diffuse)


def test_range_and_phase_are_taken_out() -> None:
    """An object between Sun and observer's direction: closed form, and the Sun against astropy."""
    from astropy.coordinates import get_sun
    from astropy.time import Time

    from sboc_e2e.icd import tai

    now = Time("2027-03-01T00:00:00", scale="utc").tai
    t = np.array([tai.from_jd_parts(now.jd1, now.jd2)])
    want = get_sun(now).cartesian.xyz.to_value("km")
    sun = sun_km(t)[0]
    assert np.degrees(np.arccos(sun @ want / np.linalg.norm(sun) / np.linalg.norm(want))) * 3600 < 30.0
    along = sun / np.linalg.norm(sun)
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    place = np.zeros((1, 3))
    one = light_pass(t, np.array([10.0]), np.array([0.1]), place, across[None] * 10_000.0)
    assert one.mag[0] == pytest.approx(5.0)
    assert np.degrees(one.phase_rad[0]) == pytest.approx(90.0, abs=0.01)
    assert len(light_pass(t, np.array([np.nan]), np.array([0.1]), place, place + 1.0).t_s) == 0
    assert [list(k) for k in split_by([7, 3, 7, 3])] == [[0, 2], [1, 3]]


def test_samples_that_are_no_pass_are_refused() -> None:
    good = np.arange(3.0)
    with pytest.raises(ValueError, match="rising"):
        LightPass(t_s=np.zeros(3), mag=good, mag_err=good + 1, phase_rad=good)
    assert characterise([]).kind == "unknown"
