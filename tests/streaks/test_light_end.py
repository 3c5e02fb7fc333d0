"""Where light ends: steps keep the fit's end, falls have a stretch, light of others beyond a gap is none of the trail's."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.streaks.light_end import LightEnd, light_end
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_pixels import TrailPixels

WIDTH_PX, NOISE_E, REACH, BORDER_PX = 1.3, 20.0, 20, 300.0


def outwards(seed: int, density: NDArray[np.float64]) -> TrailPixels:
    """Half of a trail of this light (e-/px) at each px from the middle, in noise."""
    v, u = (each.ravel().astype(float) for each in np.mgrid[-REACH : REACH + 1, : density.size])
    profile = np.exp(-0.5 * (v / WIDTH_PX) ** 2) / (math.sqrt(2.0 * math.pi) * WIDTH_PX)
    noise = np.random.default_rng(seed).normal(0.0, NOISE_E, v.size)
    return TrailPixels(
        frame=TrailFrame.of_chord(0.0, 0.0, 0.0, 10.0),
        u=u,
        v=v,
        value_e=density[u.astype(int)] * profile + noise,
        variance_e2=np.full(v.size, NOISE_E**2),
        index=np.arange(v.size),
    )


def snr_of(density: NDArray[np.float64]) -> float:
    """Matched-filter S/N of all of a trail with two such halves."""
    return math.sqrt(2.0 * float(density @ density) / (2.0 * math.sqrt(math.pi) * WIDTH_PX)) / NOISE_E


def ends(density: NDArray[np.float64], end_px: float) -> list[LightEnd]:
    return [light_end(outwards(seed, density), end_px, WIDTH_PX, BORDER_PX) for seed in range(12)]


def test_where_light_stops_all_three_places_are_the_fit_s_end() -> None:
    """A step of S/N 15 in 12 px: nothing is lost before it, and nothing seen beyond."""
    u = np.arange(280)
    for light in ends(np.where(u < 150, 200.0, 0.0), 150.2):
        assert (light.place_px, light.bright_px, light.faint_px) == (150.2, 150.2, 150.2)


def test_a_fall_has_a_stretch_that_holds_the_place_where_it_is_lost() -> None:
    """Light that falls by e in 20 px: the S/N of 12 px is 12, 4 and 2 at places known in closed form."""
    u = np.arange(280)
    density = 300.0 * np.exp(-np.maximum(u - 100.0, 0.0) / 20.0)
    per_snr = NOISE_E * math.sqrt(2.0 * math.sqrt(math.pi) * WIDTH_PX / 12.0)
    bright, seen, faint = (100.0 + 20.0 * math.log(300.0 / (snr * per_snr)) for snr in (12.0, 4.0, 2.0))
    found = ends(density, 120.0)
    assert np.median([light.place_px for light in found]) == pytest.approx(seen, abs=8.0)
    assert np.median([light.bright_px for light in found]) == pytest.approx(bright, abs=8.0)
    assert np.median([light.faint_px for light in found]) == pytest.approx(faint, abs=10.0)
    assert sum(light.bright_px - 2.0 <= seen <= light.faint_px + 2.0 for light in found) >= 10


def test_a_star_beyond_a_gap_is_none_of_the_trail_s() -> None:
    """A source of ten times the trail's light 40 px beyond its end, on the line."""
    u = np.arange(280)
    density = np.where(u < 150, 200.0, 0.0) + 2000.0 * np.exp(-0.5 * ((u - 190.0) / WIDTH_PX) ** 2)
    assert all(light.faint_px < 165.0 for light in ends(density, 150.2))


def test_a_gap_within_a_trail_is_no_end() -> None:
    """20 px without light, 30 px before the end."""
    u = np.arange(280)
    for light in ends(np.where((u < 150) & ((u < 100) | (u > 120)), 200.0, 0.0), 150.2):
        assert light.place_px == 150.2


def test_whatever_the_light_is_the_three_places_are_in_order() -> None:
    """Light that changes at random, also lost from the middle on: no block is left before the place, and nothing fails."""
    u = np.arange(120)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        density = rng.normal(0.0, 300.0, u.size)
        end_px = rng.uniform(13.0, 60.0)
        light = light_end(outwards(seed, density), end_px, WIDTH_PX, BORDER_PX)
        assert 0.0 <= light.bright_px <= light.place_px <= light.faint_px <= BORDER_PX


def test_a_faint_trail_is_judged_in_longer_windows_or_not_at_all() -> None:
    """S/N 16 on 600 px: its 12 px hold an S/N of 2 and would end anywhere. S/N 6: no window tells."""
    u = np.arange(290)
    density = np.where(u < 280, 29.0, 0.0)
    assert 12.0 < snr_of(density) < 20.0
    assert np.median([abs(light.place_px - 280.0) for light in ends(density, 280.0)]) <= 40.0
    faint = np.where(u < 280, 11.0, 0.0)
    assert all(light == LightEnd(place_px=280.0, bright_px=280.0, faint_px=280.0) for light in ends(faint, 280.0))
