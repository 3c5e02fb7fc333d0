"""The sensor measured as a laboratory would: photon transfer curve, read noise, entropy against brute force."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from simulator.sensor import Sensor, SensorOptions
from simulator.sensor.options import BinningOptions, ConverterOptions, DarkOptions, ReadoutOptions, TelegraphOptions
from simulator.sensor.statistics import entropy_bits, pixel_probabilities

LINEAR = replace(SensorOptions(), converter=ConverterOptions(nonlinearity=0.0))


def test_photon_transfer_curve_recovers_gain_and_read_noise_to_1_percent():
    """Janesick 2007, Photon Transfer, chapter 5: variance of differences of two flats against their mean."""
    sensor = Sensor(LINEAR, rows=1024, cols=1024, seed=12)
    levels = np.linspace(50.0, 4000.0, 9)
    mean, variance = [], []
    dark = [sensor.digitise(np.zeros((1024, 1024), dtype=np.float32), k, 0.01).astype(float) for k in (0, 1)]
    for k, level in enumerate(levels):
        flats = [
            sensor.digitise(np.full((1024, 1024), level, dtype=np.float32), 10 + 2 * k + i, 0.01).astype(float) for i in (0, 1)
        ]
        usable = (flats[0] + flats[1] - dark[0] - dark[1]) > levels[k] / 1.2
        mean.append(0.5 * (flats[0] + flats[1] - dark[0] - dark[1])[usable].mean())
        variance.append(0.5 * (flats[0] - flats[1])[usable].var())
    inverse_gain, offset = np.polyfit(mean, variance, 1, w=1.0 / np.array(variance))
    assert 1.0 / inverse_gain == pytest.approx(1.2, rel=0.01)
    # Temporal noise in the dark, telegraph and hot pixels left out by a clipped variance of the difference of two darks.
    difference = dark[0] - dark[1]
    good = np.abs(difference) < 30.0
    read_noise_e = 1.2 * np.sqrt(0.5 * difference[good].var() - 1.0 / 12.0)
    assert read_noise_e == pytest.approx(sensor.delivered.read_noise_e, rel=0.01)
    assert offset == pytest.approx((2.3 / 1.2) ** 2, abs=8.0)


def test_the_low_gain_channel_has_its_own_transfer_curve():
    sensor = Sensor(replace(LINEAR, prnu=0.0), rows=512, cols=512, seed=12)
    variance, levels = [], (10000.0, 20000.0, 30000.0)
    for k, level in enumerate(levels):
        a, b = (sensor.digitise(np.full((512, 512), level, dtype=np.float32), 10 + 2 * k + i, 0.01).astype(float) for i in (0, 1))
        good = (a > 0.7 * level / 1.2) & (b > 0.7 * level / 1.2)
        variance.append(0.5 * (a - b)[good].var() * 1.2**2)
    expected = np.array(levels) + 8.0**2 + (10.0**2 + 1.2**2) / 12.0
    assert np.array(variance) == pytest.approx(expected, rel=0.012)


def test_variance_model_matches_the_scatter_of_frames():
    sensor = Sensor(LINEAR, rows=256, cols=256, seed=3)
    mean_e = np.tile(np.linspace(0.0, 400.0, 256, dtype=np.float32), (256, 1))
    frames = np.array([sensor.digitise(mean_e, k, 0.2) for k in range(60)], dtype=float) * 1.2
    measured = frames.var(axis=0, ddof=1)
    model = sensor.variance_e2(mean_e, 0.2)
    # A sample variance of 60 frames scatters by sqrt(2/59); the mean of 65,536 ratios by 0.07 %.
    assert np.median(measured / model) == pytest.approx(stats.chi2.median(59) / 59, rel=0.01)
    patch = sensor.variance_e2(mean_e[20:40, 30:70], 0.2, row0=20, col0=30)
    assert np.array_equal(patch, model[20:40, 30:70])


def test_variance_of_charge_summed_on_the_chip_holds_one_read_noise_for_a_block():
    """A delivered pixel of 4 x 4: 16 shot noises of 3 e- and one read noise of 15 e-, in the model as in frames."""
    options = replace(
        LINEAR, type="ccd", prnu=0.0, binning=BinningOptions(rows=4, cols=4, method="sum"),
        readout=ReadoutOptions(read_noise_e=15.0), dark=DarkOptions(median_e_s=0.0, warm_fraction=0.0, hot_fraction=0.0),
        telegraph=TelegraphOptions(fraction=0.0),
    )  # fmt: skip
    sensor = Sensor(options, rows=512, cols=512, seed=3)
    mean_e = np.full((512, 512), 3.0, dtype=np.float32)
    a, b = (sensor.digitise(mean_e, k, 0.2).astype(float) * 1.2 for k in (0, 1))
    expected = 16 * 3.0 + 15.0**2 + 0.1**2 + 1.2**2 / 12.0
    # 16,384 pixels: their variance scatters by 1.1 %
    assert 0.5 * (a - b).var() == pytest.approx(expected, rel=0.04)
    assert sensor.variance_e2(mean_e, 0.2)[:4, :4].sum() == pytest.approx(expected, rel=1e-4)
    assert 16.0 * float(sensor.variance_e2(3.0, 0.2)) == pytest.approx(expected, rel=1e-4)


def test_sky_noise_of_the_preset_is_2_84_electrons_and_3_29_bits():
    sensor = Sensor(SensorOptions(), rows=64, cols=64, seed=1)
    noise_e = np.sqrt(2.80 + 2.3**2)
    assert noise_e == pytest.approx(2.844, abs=0.001)
    bits = entropy_bits(pixel_probabilities(2.80, 2.3, 1.2))
    assert bits == pytest.approx(3.29, abs=0.015)
    mean_e = np.full((64, 64), 2.80, dtype=np.float32)
    assert sensor.entropy_bits(mean_e, 0.0) == pytest.approx(bits, abs=0.03)


@pytest.mark.parametrize(("mean_e", "read_noise_e"), [(0.0, 2.3), (2.8, 2.3), (40.0, 1.0), (300.0, 3.0)])
def test_entropy_agrees_with_counting_drawn_pixels(mean_e, read_noise_e):
    rng = np.random.default_rng(5)
    n = 2_000_000
    drawn = np.floor((rng.poisson(mean_e, n) + rng.normal(0.0, read_noise_e, n)) / 1.2 + 0.5).astype(int)
    share = np.bincount(drawn - drawn.min()) / n
    exact = pixel_probabilities(mean_e, read_noise_e, 1.2)
    assert exact.sum() == pytest.approx(1.0, abs=1e-9)
    # Counting n draws underestimates entropy by (cells - 1) / (2 n ln 2) (Miller 1955).
    bias = (np.count_nonzero(share) - 1) / (2.0 * n * np.log(2.0))
    assert entropy_bits(exact) == pytest.approx(entropy_bits(share) + bias, abs=3e-3)


def test_entropy_of_an_image_is_the_mean_over_its_pixels():
    sensor = Sensor(replace(SensorOptions(), readout=ReadoutOptions(read_noise_spread=0.0)), rows=32, cols=32, seed=1)
    levels = np.array([0.0, 1.7, 30.0, 250.0, 900.0])
    mean_e = np.repeat(levels, 2).astype(np.float32)[None, :].repeat(4, axis=0)
    exact = [entropy_bits(pixel_probabilities(m, 2.3, 1.2)) for m in levels]
    assert sensor.entropy_bits(mean_e, 0.0) == pytest.approx(np.mean(exact), abs=2e-3)
