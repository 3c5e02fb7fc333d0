"""Noise of the sensor: random numbers against scipy's distributions, blocks of rows against whole frames, switches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sboc_e2e.icd.errors import UserError
from simulator.sensor import Sensor, SensorOptions
from simulator.sensor.counter import NORMAL_TABLE, draw, normal
from simulator.sensor.options import (
    BinningOptions,
    ConverterOptions,
    DarkOptions,
    ReadoutOptions,
    TelegraphOptions,
    WindowOptions,
)
from simulator.sensor.poisson import EXACT_BELOW, draw_poisson, poisson_tables

TABLES, FIRST = poisson_tables()
QUIET = SensorOptions(
    prnu=0.0,
    dark=DarkOptions(median_e_s=0.0, warm_fraction=0.0, hot_fraction=0.0, dead_fraction=0.0),
    telegraph=TelegraphOptions(fraction=0.0),
    readout=ReadoutOptions(read_noise_e=0.0, low_gain_read_noise_e=0.0, row_noise_e=0.0, column_offset_e=0.0),
    converter=ConverterOptions(nonlinearity=0.0),
)


def poisson_numbers(mean, n, key=7):
    count = np.empty(n)
    draw_poisson(np.full(n, mean), np.uint64(key), TABLES, FIRST, NORMAL_TABLE, np.empty(n, np.uint8), count)
    return count


@pytest.mark.parametrize("mean", [0.03, 0.5, 2.8, 7.97, 8.0, 21.3, 31.99, 60.5, 127.7, 128.0, 300.0, 2000.0])
def test_poisson_numbers_follow_the_poisson_distribution(mean):
    n = 400_000
    count = poisson_numbers(mean, n)
    low, high = stats.poisson.ppf([2e-4, 1 - 2e-4], mean).astype(int)
    edges = np.arange(low, high + 1)
    observed = np.array([(count <= edges[0]).sum(), *[(count == k).sum() for k in edges[1:-1]], (count >= edges[-1]).sum()])
    cdf = stats.poisson.cdf(edges, mean)
    expected = n * np.array([cdf[0], *np.diff(cdf)[:-1], 1.0 - cdf[-2]])
    assert stats.chisquare(observed, expected).pvalue > 1e-4


def test_corrected_normal_at_its_lower_limit_errs_by_less_than_1e_4_in_the_distribution_function():
    n = 4_000_000
    count = poisson_numbers(EXACT_BELOW, n, key=11)
    k = np.arange(60, 220)
    empirical = np.searchsorted(np.sort(count), k, side="right") / n
    # 1.95 / sqrt(n) is the 0.1 % point of the Kolmogorov statistic.
    assert np.abs(empirical - stats.poisson.cdf(k, EXACT_BELOW)).max() < 1e-4 + 1.95 / np.sqrt(n)


def test_mean_zero_gives_zero():
    assert not poisson_numbers(0.0, 1000).any()


def test_normal_numbers_follow_the_normal_distribution():
    words = np.random.default_rng(3).integers(0, 2**64, size=100_000, dtype=np.uint64)
    z = np.array([normal(word, NORMAL_TABLE) for word in words])
    assert stats.kstest(z, "norm").pvalue > 1e-4
    assert np.abs(z).max() > 4.0


def test_neighbouring_numbers_and_rows_of_the_counter_are_uncorrelated():
    bits = np.array([[draw(np.uint64(mix_row), i) for i in range(2000)] for mix_row in (1, 2, 3)]).astype(float)
    correlation = np.corrcoef(np.vstack([bits[0, 1:], bits[0, :-1], bits[1, 1:], bits[2, 1:]]))
    assert np.abs(correlation - np.eye(4)).max() < 5.0 / np.sqrt(2000)


def test_blocks_of_rows_give_the_bytes_of_the_whole_frame():
    sensor = Sensor(SensorOptions(), rows=96, cols=64, seed=5)
    mean_e = np.random.default_rng(1).uniform(0.0, 300.0, (96, 64)).astype(np.float32)
    whole = sensor.digitise(mean_e, 3, 0.2)
    blocks = [sensor.digitise(mean_e[a:b], 3, 0.2, first_row=a) for a, b in ((60, 96), (0, 17), (17, 60))]
    assert np.array_equal(whole, np.concatenate([blocks[1], blocks[2], blocks[0]]))
    assert np.array_equal(whole, Sensor(SensorOptions(), rows=96, cols=64, seed=5).digitise(mean_e, 3, 0.2))
    assert not np.array_equal(whole, sensor.digitise(mean_e, 4, 0.2))


def test_a_window_shows_the_same_pixels_of_the_same_sensor():
    mean_e = np.full((96, 64), 2000.0, dtype=np.float32)
    whole = Sensor(replace(QUIET, prnu=0.01, shot_noise=False), rows=96, cols=64, seed=5).digitise(mean_e, 0, 0.2)
    window = WindowOptions(row0=10, col0=20, rows=30, cols=40)
    part = Sensor(replace(QUIET, prnu=0.01, shot_noise=False, window=window), rows=96, cols=64, seed=5)
    assert np.array_equal(part.digitise(mean_e[10:40, 20:60], 0, 0.2), whole[10:40, 20:60])


def test_without_any_noise_the_code_is_the_rounded_signal():
    sensor = Sensor(replace(QUIET, shot_noise=False), rows=32, cols=32, seed=1)
    mean_e = np.linspace(0.0, 4000.0, 32 * 32, dtype=np.float32).reshape(32, 32)
    assert np.array_equal(sensor.digitise(mean_e, 0, 0.2), np.floor(mean_e.astype(float) / 1.2 + 100.5))


def test_low_gain_channel_continues_the_high_one_up_to_full_well():
    sensor = Sensor(replace(QUIET, shot_noise=False), rows=32, cols=64, seed=1)
    mean_e = np.linspace(3000.0, 60000.0, 32 * 64, dtype=np.float32).reshape(32, 64)
    adu = sensor.digitise(mean_e, 0, 0.2).astype(float)
    linear = np.minimum(mean_e, 39000.0) / 1.2 + 100.0
    # Half a unit of the low-gain converter is 5 e- = 4.2 ADU, plus rounding to the common scale.
    assert np.abs(adu - linear).max() <= 5.0 / 1.2 + 1.0
    assert (np.diff(adu.ravel()) >= -5).all()


def test_saturated_pixels_reach_the_stated_saturation():
    sensor = Sensor(SensorOptions(), rows=64, cols=64, seed=1)
    full = sensor.digitise(np.full((64, 64), 1e6, dtype=np.float32), 0, 0.2)
    assert (full >= sensor.delivered.saturation_adu).mean() > 0.99
    below = sensor.digitise(np.full((64, 64), 30000.0, dtype=np.float32), 0, 0.2)
    assert (below < sensor.delivered.saturation_adu).all()


def test_ccd_bleeds_along_its_columns_and_keeps_the_charge():
    options = replace(QUIET, type="ccd", shot_noise=False, converter=ConverterOptions(nonlinearity=0.0, bits=16, dual_gain=False))
    mean_e = np.zeros((101, 16), dtype=np.float32)
    mean_e[50, 8] = 39000.0 * 9
    sensor = Sensor(options, rows=101, cols=16, seed=1)
    e = (sensor.digitise(mean_e, 0, 0.2).astype(float) - 100.0) * 1.2
    assert np.flatnonzero(e[:, 8] > 38000.0).tolist() == list(range(46, 55))
    assert e.sum() == pytest.approx(39000.0 * 9, abs=101 * 16 * 0.6)
    assert not e[:, np.arange(16) != 8].any()
    cmos = Sensor(replace(options, type="cmos"), rows=101, cols=16, seed=1).digitise(mean_e, 0, 0.2)
    assert (cmos != 100).sum() == 1


def test_telegraph_pixels_are_the_same_pixels_and_hold_their_state():
    options = replace(QUIET, telegraph=TelegraphOptions(fraction=0.05, amplitude_e=200.0, dwell_frames=8), shot_noise=False)
    sensor = Sensor(options, rows=64, cols=64, seed=9)
    dark = np.zeros((64, 64), dtype=np.float32)
    frames = np.array([sensor.digitise(dark, k, 0.2) for k in range(64)]) > 100
    jumping = frames.any(axis=0)
    assert 120 < jumping.sum() < 290
    on = frames[:, jumping]
    assert on.mean() == pytest.approx(0.5, abs=0.06)
    # The state is drawn anew once in 8 frames, with even odds: it changes in 1 of 16 steps.
    assert (on[1:] != on[:-1]).mean() == pytest.approx(1.0 / 16.0, abs=0.015)


def test_dark_current_follows_the_arrhenius_law():
    mean_e = np.zeros((64, 64), dtype=np.float32)
    warm = replace(
        QUIET,
        shot_noise=False,
        dark=DarkOptions(median_e_s=100.0, spread=0.0, warm_fraction=0.0, hot_fraction=0.0, dead_fraction=0.0),
    )
    signal = [
        Sensor(replace(warm, temperature_k=t), rows=64, cols=64, seed=1).digitise(mean_e, 0, 10.0).mean() - 100.0
        for t in (263.15, 253.15)
    ]
    # exp(-0.63 eV / k (1/253.15 - 1/263.15)) = 0.3337
    assert signal[1] / signal[0] == pytest.approx(0.3337, rel=0.005)


def test_reset_noise_is_ktc_and_double_sampling_removes_it():
    dark = np.zeros((256, 256), dtype=np.float32)
    readout = replace(QUIET.readout, correlated_double_sampling=False, sense_node_ff=2.0)
    noisy = Sensor(replace(QUIET, readout=readout), rows=256, cols=256, seed=1).digitise(dark, 0, 0.2)
    # sqrt(k T C) / e at 263.15 K and 2 fF is 16.83 e-.
    assert noisy.std() * 1.2 == pytest.approx(np.hypot(16.83, 1.2 / np.sqrt(12)), rel=0.015)
    assert Sensor(QUIET, rows=256, cols=256, seed=1).digitise(dark, 0, 0.2).std() == 0.0


@pytest.mark.parametrize(("method", "rows", "cols"), [("mean", 2, 2), ("sum", 2, 2), ("median", 3, 3), ("weighted", 2, 4)])
def test_delivered_gain_and_read_noise_of_binned_pixels(method, rows, cols):
    options = SensorOptions(
        binning=BinningOptions(rows=rows, cols=cols, method=method),
        telegraph=TelegraphOptions(fraction=0.0),
        readout=ReadoutOptions(column_offset_e=0.0, row_noise_e=0.0, read_noise_e=6.0, read_noise_spread=0.05),
    )
    sensor = Sensor(options, rows=384, cols=384, seed=4)
    dark, lit = (sensor.digitise(np.full((384, 384), level, dtype=np.float32), 0, 0.0).astype(float) for level in (0.0, 400.0))
    delivered = sensor.delivered
    assert dark.shape == (delivered.rows, delivered.cols) == (384 // rows, 384 // cols)
    assert (np.median(lit) - np.median(dark)) * delivered.gain_e_adu == pytest.approx(400.0 * rows * cols, rel=0.005)
    rounding = delivered.gain_e_adu / np.sqrt(12.0)
    assert np.hypot(delivered.read_noise_e, rounding) == pytest.approx(dark.std() * delivered.gain_e_adu, rel=0.04)


def test_defects_are_found_in_the_calibration_maps():
    options = replace(SensorOptions(), dark=DarkOptions(hot_fraction=0.002, hot_e_s=2000.0, dead_fraction=0.001))
    sensor = Sensor(options, rows=256, cols=256, seed=2)
    maps = sensor.calibration_maps(0.2)
    frames = [sensor.digitise(np.zeros((256, 256), dtype=np.float32), k, 0.2).astype(float) for k in range(40)]
    mean = np.mean(frames, axis=0)
    quiet = maps.defects == 0
    assert np.std((mean - maps.dark_adu)[quiet]) < 0.6
    assert np.abs(np.median(mean - maps.dark_adu)) < 0.05
    hot = mean > np.median(mean) + 30.0
    assert hot.sum() > 60
    assert (maps.defects[hot] > 0).mean() > 0.95
    lit = sensor.digitise(np.full((256, 256), 3000.0, dtype=np.float32), 0, 0.2)
    assert (maps.defects[lit < 500] > 0).all()
    flat_frames = np.mean([sensor.digitise(np.full((256, 256), 3000.0, dtype=np.float32), k, 0.2) for k in range(40)], axis=0)
    measured = (flat_frames - mean) / np.median(flat_frames - mean)
    assert np.corrcoef(measured[quiet], maps.flat[quiet])[0, 1] > 0.9


def test_pixels_without_meaning_are_dark_not_a_crash():
    image = np.full((16, 16), np.nan, dtype=np.float32)
    image[3], image[5], image[7] = -50.0, np.inf, 1e30
    sensor = Sensor(QUIET, rows=16, cols=16, seed=1)
    adu = sensor.digitise(image, 0, 0.2)
    assert (adu[[0, 3, 15]] == 100).all()
    assert (adu[[5, 7]] >= sensor.delivered.saturation_adu).all()


def test_impossible_converters_are_refused_by_name():
    with pytest.raises(UserError, match=r"sensor\.converter\.pedestal: 100 ADU; allowed is up to half of 6 bits, 31"):
        ConverterOptions(bits=6)
    with pytest.raises(UserError, match=r"sensor\.converter\.low_gain"):
        ConverterOptions(low_gain_e_adu=0.5)


def test_a_window_beyond_the_detector_is_refused_by_name():
    with pytest.raises(UserError, match=r"sensor\.window.*96 x 64"):
        Sensor(SensorOptions(window=WindowOptions(row0=90, rows=10)), rows=96, cols=64, seed=1)
    with pytest.raises(UserError, match="does not fit"):
        Sensor(SensorOptions(), rows=96, cols=64, seed=1).digitise(np.zeros((96, 63), dtype=np.float32), 0, 0.2)


def test_noise_is_white_in_space():
    options = replace(QUIET, readout=ReadoutOptions(row_noise_e=0.0, column_offset_e=0.0, read_noise_spread=0.0))
    sensor = Sensor(options, rows=512, cols=512, seed=3)
    sky = np.full((512, 512), 2.8, dtype=np.float32)
    power = []
    for frame in range(4):
        noise = sensor.digitise(sky, frame, 0.2).astype(float)
        power.append(np.abs(np.fft.rfft2(noise - noise.mean())) ** 2 / noise.size / noise.var())
    # The mean of four exponential powers is gamma-distributed.
    assert stats.kstest(np.mean(power, axis=0)[1:256, 1:256].ravel(), stats.gamma(4, scale=0.25).cdf).pvalue > 1e-3


def test_weighted_binning_reaches_the_least_variance_of_its_exposure():
    """Pixels of 1e4 e-/s have 10 e-^2 more in a millisecond: blocks have the variance of the best weights, 1 / sum(1 / v)."""
    exposure_s = 1e-3
    options = replace(
        QUIET,
        dark=DarkOptions(median_e_s=0.0, warm_fraction=0.0, hot_fraction=0.3, hot_e_s=1e4, dead_fraction=0.0),
        readout=ReadoutOptions(read_noise_e=2.0, read_noise_spread=0.0, row_noise_e=0.0, column_offset_e=0.0),
        converter=ConverterOptions(nonlinearity=0.0, bits=16, gain_e_adu=0.05, dual_gain=False, pedestal_adu=1000),
        binning=BinningOptions(rows=2, cols=2, method="weighted"),
    )
    sensor = Sensor(options, rows=64, cols=64, seed=3)
    pixels = sensor._pixels
    variance = pixels.dark_rate_of_e_s[pixels.dark] * exposure_s + pixels.noise_of_e[pixels.noise] ** 2
    best = 1.0 / (1.0 / variance).reshape(32, 2, 32, 2).sum(axis=(1, 3))
    dark_e = np.zeros((64, 64), np.float32)
    frames = np.array([sensor.digitise(dark_e, n, exposure_s).astype(np.float64) * 0.05 for n in range(400)])
    # 400 frames know each of 1024 variances to 7 %, their mean ratio to 0.2 %.
    assert (frames.var(axis=0, ddof=1) / best).mean() == pytest.approx(1.0, abs=0.02)


def test_binning_that_does_not_divide_is_refused_with_what_is_allowed():
    """Rows that fill no block were dropped without a word: the frame was smaller than the scenario says."""
    options = replace(SensorOptions(), binning=BinningOptions(rows=3, cols=2))
    with pytest.raises(UserError, match=r"sensor\.binning: 3 x 2 pixels do not divide the 256 x 256 that are read out"):
        Sensor(options, rows=256, cols=256, seed=1)
    assert Sensor(options, rows=258, cols=256, seed=1).delivered.rows == 86


def on_chip(**changes):
    """A CCD that joins 3 x 2 pixels of 10 e- each before one read-out of 6 e-."""
    options = replace(
        QUIET,
        type="ccd",
        dark=DarkOptions(median_e_s=50.0, spread=0.0, warm_fraction=0.0, hot_fraction=0.0, dead_fraction=0.0, reference_k=263.15),
        readout=ReadoutOptions(read_noise_e=6.0, read_noise_spread=0.0, row_noise_e=1.5, column_offset_e=2.0),
        converter=ConverterOptions(nonlinearity=0.0, bits=16, gain_e_adu=0.5, dual_gain=False),
        binning=BinningOptions(rows=3, cols=2, method="sum"),
    )
    return Sensor(replace(options, **changes), rows=96, cols=128, seed=3)


def test_the_dark_map_of_on_chip_sums_is_the_average_of_frames_that_are_read_as_sums():
    sensor = on_chip()
    mean_e = np.zeros((96, 128), np.float32)
    frames_e = np.array([(sensor.digitise(mean_e, k, 0.2).astype(float) - 100.0) * 0.5 for k in range(256)])
    dark_e = (sensor.calibration_maps(0.2).dark_adu.astype(float) - 100.0) * 0.5
    # 6 pixels of 10 e-, one offset of the column that is read, of which the means of all columns keep 2 e- / sqrt(64)
    assert dark_e.mean() == pytest.approx(60.0, abs=4.0 * 2.0 / np.sqrt(64.0))
    assert dark_e.mean() == pytest.approx(frames_e.mean(), abs=0.1)
    column_e = frames_e.mean(axis=(0, 1))
    assert column_e.std() == pytest.approx(2.0, rel=0.3)
    # a column of 32 sums, each the average of 64 frames of variance 60 + 36: 0.22 e-
    assert np.abs(dark_e.mean(axis=0) - column_e).max() < 5.0 * np.sqrt(96.0 / (64.0 * 32.0))
    scatter = (dark_e - dark_e.mean(axis=0)).var() * 32.0 / 31.0
    # closed form: shot noise of 60 e-, one read noise, one rounding, over 64 frames; known to sqrt(2 / 2048) = 3 %
    assert scatter == pytest.approx((60.0 + 6.0**2 + 0.5**2 / 12.0) / 64.0, rel=0.13)


def test_the_noise_model_of_on_chip_sums_counts_one_read_out():
    sensor = on_chip()
    mean_e = np.full((96, 128), 5.0, np.float32)
    frames_e = np.array([sensor.digitise(mean_e, k, 0.2).astype(float) * 0.5 for k in range(300)])
    # 6 pixels of 15 e-, read once with 6 e-, 1.5 e- of the row and a rounding
    closed_e2 = 6.0 * 15.0 + 6.0**2 + 1.5**2 + 0.5**2 / 12.0
    assert frames_e.var(axis=0, ddof=1).mean() == pytest.approx(closed_e2, rel=0.01)
    assert 6.0 * float(sensor.variance_e2(5.0, 0.2)) == pytest.approx(closed_e2, rel=1e-5)
    blocks = sensor.variance_e2(mean_e, 0.2).reshape(32, 3, 64, 2).sum(axis=(1, 3))
    assert blocks == pytest.approx(np.full((32, 64), closed_e2), rel=1e-5)


@pytest.mark.parametrize(("rows", "cols", "wells"), [(3, 2, 4.0), (3, 1, 2.0), (1, 4, 4.0), (1, 2, 2.0), (2, 8, 4.0)])
def test_an_on_chip_sum_holds_two_wells_in_the_register_and_four_in_the_summing_well(rows, cols, wells):
    """Roper Scientific, "Binning": the register twice a pixel, the summing well twice the register. It held one pixel's."""
    converter = ConverterOptions(nonlinearity=0.01, bits=16, gain_e_adu=2.5, dual_gain=False, full_well_e=39000.0)
    sensor = on_chip(
        converter=converter, binning=BinningOptions(rows=rows, cols=cols, method="sum"), shot_noise=False,
        readout=ReadoutOptions(read_noise_e=0.0, read_noise_spread=0.0, row_noise_e=0.0, column_offset_e=0.0),
    )  # fmt: skip
    assert sensor.delivered.full_well_e == pytest.approx(wells * 39000.0)
    full = sensor.digitise(np.full((96, 128), 1e6, np.float32), 0, 0.2)[:32]
    assert (full.astype(float) - 100.0) * 2.5 == pytest.approx(np.full(full.shape, 0.99 * wells * 39000.0), abs=2.5)
    assert (full >= sensor.delivered.saturation_adu).all()
    below = 0.9 * wells * 39000.0 / (rows * cols)
    half = sensor.digitise(np.full((96, 128), below, np.float32), 0, 0.2)[:32]
    # 10 e- of dark current in each pixel, 0.9 % lost to non-linearity
    assert (half.astype(float) - 100.0) * 2.5 == pytest.approx(
        np.full(half.shape, 0.991 * rows * cols * (below + 10.0)), rel=1e-3
    )
    assert (half < sensor.delivered.saturation_adu).all()


@pytest.mark.parametrize(
    ("kind", "method", "mean_e"), [("ccd", "sum", 3.0), ("ccd", "sum", 300.0), ("cmos", "mean", 3.0), ("cmos", "sum", 300.0)]
)
def test_entropy_of_binned_pixels_is_that_of_what_is_delivered(kind, method, mean_e):
    """Against the counts of 400,000 drawn pixels, whose entropy is too low by (cells - 1) / (2 n ln 2) (Miller 1955)."""
    sensor = on_chip(
        type=kind, binning=BinningOptions(rows=3, cols=2, method=method),
        readout=ReadoutOptions(read_noise_e=6.0, read_noise_spread=0.0, row_noise_e=0.0, column_offset_e=0.0),
    )  # fmt: skip
    light = np.full((96, 128), mean_e, np.float32)
    drawn = np.concatenate([sensor.digitise(light, k, 0.2).ravel() for k in range(200)])
    counts = np.bincount(drawn)
    share = counts[counts > 0] / drawn.size
    counted = -(share * np.log2(share)).sum() + (share.size - 1) / (2.0 * drawn.size * np.log(2.0))
    assert sensor.entropy_bits(light, 0.2) == pytest.approx(counted, abs=0.01)
    assert sensor.entropy_bits(light, 0.2, every=16) == pytest.approx(counted, abs=0.01)


@pytest.mark.parametrize(("kind", "method"), [("cmos", "sum"), ("ccd", "mean")])
def test_pixels_that_are_read_one_by_one_each_have_a_read_noise(kind, method):
    sensor = on_chip(type=kind, binning=BinningOptions(rows=3, cols=2, method=method))
    assert float(sensor.variance_e2(5.0, 0.2)) == pytest.approx(15.0 + 6.0**2 + 1.5**2 + 0.5**2 / 12.0, rel=1e-5)


def test_a_telegraph_pixel_lifts_its_on_chip_sum_in_the_dark_map():
    still, jumping = (
        on_chip(telegraph=TelegraphOptions(fraction=f, amplitude_e=300.0, dwell_frames=1)).calibration_maps(0.2).dark_adu
        for f in (0.0, 0.02)
    )
    # 246 of the pixels jump, in half of the frames, by 300 e- times a lognormal number of mean exp(0.7^2 / 2)
    lifted_e = (jumping.astype(float) - still).sum() * 0.5
    assert lifted_e == pytest.approx(0.02 * 96 * 128 * 0.5 * 300.0 * np.exp(0.5 * 0.7**2), rel=0.25)
