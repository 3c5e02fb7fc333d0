"""Structure of the unresolved light against the published spectrum of interstellar dust."""

import numpy as np
import pytest

from simulator.scene.backdrop import refined
from simulator.scene.cirrus import SLOPE, make_cirrus
from simulator.scene.stars import unit_vectors


def test_the_mean_of_the_sky_and_the_rms_of_its_logarithm_are_those_asked_for():
    """Over the whole sky, forty seeds; the longest waves are few, hence 2 and 5 %."""
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    made = [make_cirrus(0.4, seed).factor(directions) for seed in range(40)]
    assert np.mean(made) == pytest.approx(1.0, rel=0.02)
    assert np.std(np.log(made)) == pytest.approx(0.4, rel=0.05)
    assert np.min(made) > 0.0


def test_a_field_has_the_power_spectrum_of_dust():
    """k^-2.9 +- 0.1 (Miville-Deschenes et al. 2007) from 2.5 to 0.3 deg; fields of 8 deg with Hann's window, 40 seeds."""
    n, side_deg = 96, 8.0
    step = (np.arange(n) - 0.5 * n) * side_deg / n
    ra, dec = np.meshgrid(40.0 + step, step)
    directions = unit_vectors(ra.ravel(), dec.ravel())
    window = np.hanning(n)[:, None] * np.hanning(n)
    power = np.zeros((n, n))
    for seed in range(40):
        light = np.log(make_cirrus(1.0, seed).factor(directions)).reshape(n, n)
        power += np.abs(np.fft.fft2((light - light.mean()) * window)) ** 2
    number = np.hypot(*np.meshgrid(np.fft.fftfreq(n, side_deg / n), np.fft.fftfreq(n, side_deg / n)))
    inside = (number > 0.4) & (number < 3.0)
    bins = np.geomspace(0.4, 3.0, 9)
    which = np.digitize(number[inside], bins)
    mean = [power[inside][which == k].mean() for k in range(1, 9)]
    middle = [number[inside][which == k].mean() for k in range(1, 9)]
    assert np.polyfit(np.log(middle), np.log(mean), 1)[0] == pytest.approx(-SLOPE, abs=0.2)
    assert pytest.approx(2.9) == SLOPE


def test_no_structure_is_no_object():
    assert make_cirrus(0.0, 1) is None


def test_nodes_between_nodes_are_linear():
    """A plane and a product of lines stay what they are; nodes that are there already keep their values."""
    row, col = np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij")
    fine_row, fine_col = np.meshgrid(np.linspace(0.0, 8.0, 65), np.linspace(0.0, 8.0, 65), indexing="ij")
    assert refined(3.0 + 2.0 * row - col + row * col, 65) == pytest.approx(3.0 + 2.0 * fine_row - fine_col + fine_row * fine_col)
    assert refined(row, 9) is row
    uneven = np.random.default_rng(2).random((9, 9))
    assert refined(uneven, 65)[::8, ::8] == pytest.approx(uneven)
