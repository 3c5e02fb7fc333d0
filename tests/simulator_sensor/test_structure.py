"""Structure of read-out chains, charge that moves, and calibrations that are not of the flight's state, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from sboc_e2e.icd.flags import MaskBit
from simulator.as_built import with_drawn_errors
from simulator.options import SimulatorOptions
from simulator.sensor import Sensor, SensorOptions
from simulator.sensor.calibration import depart_flat
from simulator.sensor.options import (
    CalibrationOptions,
    CcdOptions,
    ConverterOptions,
    DarkOptions,
    ReadoutOptions,
    TelegraphOptions,
)
from simulator.sensor.structure import (
    StructureOptions,
    bloom,
    column_offsets_e,
    couple,
    defer_charge,
    row_offsets_e,
    spread_charge,
)

SIZE = 512
QUIET = SensorOptions(
    prnu=0.0,
    dark=DarkOptions(median_e_s=0.0, warm_fraction=0.0, hot_fraction=0.0, dead_fraction=0.0),
    telegraph=TelegraphOptions(fraction=0.0),
    readout=ReadoutOptions(read_noise_e=0.0, row_noise_e=0.0, column_offset_e=0.0, low_gain_read_noise_e=0.0),
    converter=ConverterOptions(nonlinearity=0.0),
)


def sensor(seed=1, size=SIZE, **changes) -> Sensor:
    return Sensor(replace(QUIET, **changes), rows=size, cols=size, seed=seed)


def flat(electrons: float, size=SIZE) -> np.ndarray:
    return np.full((size, size), electrons, np.float32)


def test_row_offsets_have_a_1_over_f_spectrum_of_their_rms():
    options = StructureOptions(row_flicker_e=2.0)
    rows = np.array([row_offsets_e(options, 3, frame, 4096) for frame in range(200)])
    assert np.sqrt(np.mean(rows**2)) == pytest.approx(2.0, rel=0.04)
    power = np.mean(np.abs(np.fft.rfft(rows, axis=1)) ** 2, axis=0)[1:2000]
    slope = np.polyfit(np.log(np.arange(1, 2000)), np.log(power), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.03)
    assert np.array_equal(rows[7], row_offsets_e(options, 3, 7, 4096))


def test_the_black_level_drifts_slowly_with_its_rms():
    options = StructureOptions(black_drift_e=5.0, black_drift_frames=400.0)
    level = np.array([[row_offsets_e(options, seed, f, 4)[0] for f in range(0, 4000, 40)] for seed in range(40)])
    assert np.sqrt(np.mean(level**2)) == pytest.approx(5.0, rel=0.1)
    next_one = np.array([row_offsets_e(options, seed, 1, 4)[0] for seed in range(40)])
    assert np.abs(next_one - level[:, 0]).max() < 0.4


def test_column_offsets_are_new_in_each_frame():
    options = StructureOptions(column_noise_e=1.5)
    first, second = (column_offsets_e(options, 3, frame, 20_000) for frame in (0, 1))
    assert first.std() == pytest.approx(1.5, rel=0.03)
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(0.0, abs=0.03)


def test_frames_show_rows_and_columns():
    plain, noisy = (
        sensor(shot_noise=False, structure=s).digitise(flat(200.0), 5, 0.2).astype(float)
        for s in (StructureOptions(), StructureOptions(row_flicker_e=20.0, column_noise_e=10.0))
    )
    moved = (noisy - plain) * 1.2
    assert moved.mean(axis=1).std() == pytest.approx(
        row_offsets_e(StructureOptions(row_flicker_e=20.0), 1, 5, SIZE).std(), rel=0.02
    )
    assert moved.mean(axis=0).std() == pytest.approx(10.0, rel=0.1)


def test_coupled_pixels_exchange_a_share_and_lose_nothing():
    charge, out = np.zeros((9, 9)), np.empty((9, 9))
    charge[4, 4] = 1000.0
    couple(charge, 0.01, out)
    assert out[4, 4] == pytest.approx(960.0)
    assert [out[3, 4], out[5, 4], out[4, 3], out[4, 5]] == pytest.approx([10.0] * 4)
    assert out.sum() == pytest.approx(1000.0)


def test_coupling_correlates_shot_noise_by_its_closed_form():
    """Signal c(1 - 4a) + a sum of neighbours: variance (1 - 4a)^2 + 4 a^2, covariance of neighbours 2 a (1 - 4a)."""
    a = 0.02
    options = StructureOptions(coupling=a)
    adu = sensor(structure=options, converter=replace(QUIET.converter, gain_e_adu=0.3, bits=16)).digitise(flat(400.0), 2, 0.2)
    noise = adu.astype(float)[1:-1, 1:-1] * 0.3
    noise -= noise.mean()
    variance = (1 - 4 * a) ** 2 + 4 * a * a
    assert noise.var() == pytest.approx(400.0 * variance, rel=0.02)
    assert (noise[1:] * noise[:-1]).mean() / 400.0 == pytest.approx(2 * a * (1 - 4 * a), abs=0.006)


def test_bands_of_coupled_rows_leave_no_seam():
    options = replace(QUIET, shot_noise=False, structure=StructureOptions(coupling=0.02))
    made = Sensor(options, rows=600, cols=32, seed=1)
    image = np.zeros((600, 32), np.float32)
    image[255, 9] = image[256, 20] = 4000.0
    adu = (made.digitise(image, 0, 0.2).astype(float) - 100.0) * 1.2
    assert [adu[255, 9], adu[256, 9], adu[254, 9], adu[255, 20]] == pytest.approx([3680.0, 80.0, 80.0, 80.0], abs=0.7)


def test_blooming_gives_each_neighbour_a_quarter_of_the_share():
    image = np.zeros((21, 21), np.float32)
    image[10, 10] = 50_000.0
    bloom(image, 39_000.0, 0.8)
    assert image[10, 10] == 39_000.0
    assert [image[9, 10], image[11, 10], image[10, 9], image[10, 11]] == pytest.approx([2200.0] * 4)
    image[10, 10] = 5e6
    bloom(image, 39_000.0, 0.8)
    assert image.max() <= 39_000.0
    full = np.argwhere(image >= 38_999.0) - 10
    assert 2.9 < np.hypot(*full.T).max() < 6.0
    assert abs(full.mean()) < 0.2


def test_transfers_leave_a_tail_behind():
    """Charge q of row r loses q n CTI, n = r + 1 transfers; the tail falls as exp(-k / tail), holding what is missing."""
    charge = np.zeros((3000, 2))
    charge[1999, 0] = 10_000.0
    defer_charge(charge, 1e-5, 3.0)
    assert charge[1999, 0] == pytest.approx(10_000.0 * (1 - 2000e-5))
    assert charge[:, 0].sum() == pytest.approx(10_000.0, rel=1e-4)
    # the tail is moved too, with a loss of 2 % of its own
    assert charge[2002, 0] / charge[2000, 0] == pytest.approx(np.exp(-2.0 / 3.0), rel=0.02)
    assert not charge[:, 1].any()


def test_a_ccd_trails_away_from_its_register():
    loss = CcdOptions(row_transfer_us=0.0, transfer_loss=1e-4)
    image = np.zeros((SIZE, SIZE), np.float32)
    image[400, 100] = 4000.0
    adu = sensor(type="ccd", shot_noise=False, ccd=loss).digitise(image, 0, 0.2).astype(float) - 100.0
    assert adu[400, 100] * 1.2 == pytest.approx(4000.0 * (1 - 401e-4), abs=1.0)
    assert adu[401, 100] > 20.0
    assert adu[399, 100] == 0.0


def test_true_gains_differ_from_those_of_the_camera_file():
    gains = replace(QUIET.converter, gain_error=0.03, low_gain_error=-0.02)
    made = sensor(shot_noise=False, converter=gains)
    assert made.delivered.gain_e_adu == 1.2
    faint, bright = (made.digitise(flat(e), 0, 0.2).astype(float).mean() - 100.0 for e in (2000.0, 20_000.0))
    assert faint * 1.2 == pytest.approx(2000.0 / 1.03, rel=1e-3)
    assert bright * 1.2 == pytest.approx(20_000.0 / 0.98, rel=1e-3)


def test_dark_frames_of_another_temperature_follow_arrhenius():
    dark = DarkOptions(median_e_s=100.0, spread=0.0, warm_fraction=0.0, hot_fraction=0.0, dead_fraction=0.0)
    levels = []
    for warmer in (0.0, 6.0):
        made = sensor(dark=dark, calibration=CalibrationOptions(warmer_k=warmer, dark_frames=1000))
        levels.append(float(np.mean(made.calibration_maps(1.0).dark_adu)) - 100.0)
    kelvin = QUIET.temperature_k
    law = np.exp(-0.63 / 8.617333262e-5 * (1 / (kelvin + 6.0) - 1 / kelvin))
    assert levels[1] / levels[0] == pytest.approx(law, rel=0.02)


def test_pixels_that_became_hot_in_flight_are_in_no_map():
    dark = replace(QUIET.dark, median_e_s=0.1, hot_growth_per_year=1e-3)
    noisy = replace(QUIET.readout, read_noise_e=2.3)
    made = sensor(dark=dark, readout=noisy, calibration=CalibrationOptions(age_years=4.0), shot_noise=False)
    hot = made.digitise(flat(0.0), 0, 1.0) > 400
    assert hot.sum() == pytest.approx(4e-3 * SIZE**2, rel=0.15)
    maps = made.calibration_maps(1.0)
    assert not ((maps.defects & MaskBit.HOT) != 0)[hot].any()
    assert maps.dark_adu[hot].max() < 110.0


def test_departures_of_the_built_camera_are_draws_of_the_seed():
    base = SimulatorOptions()
    base = replace(
        base,
        instrument=replace(base.instrument, as_built=replace(base.instrument.as_built, drawn=True, colour_term=0.02)),
        sensor=replace(base.sensor, converter=replace(base.sensor.converter, gain_error=0.02)),
    )
    made = [with_drawn_errors(base, seed) for seed in range(300)]
    for name in ("focal_length_ppm", "center_row_px", "zero_point_mag", "psf_width", "colour_term"):
        values = np.array([getattr(m.instrument.as_built, name) for m in made])
        assert values.std() == pytest.approx(getattr(base.instrument.as_built, name), rel=0.15), name
        assert abs(values.mean()) < 0.25 * values.std(), name
    assert np.std([m.sensor.converter.gain_error for m in made]) == pytest.approx(0.02, rel=0.15)
    assert with_drawn_errors(base, 7) == made[7]
    fixed = SimulatorOptions()
    assert with_drawn_errors(fixed, 7) is fixed


def calibration(**calibration):
    """Flats of many frames of a sensor that has only what is given."""
    converter = calibration.pop("converter", QUIET.converter)
    options = CalibrationOptions(flat_frames=100_000, **calibration)
    return sensor(calibration=options, converter=converter).calibration_maps(0.2).flat.astype(np.float64)


def test_flats_of_another_date_have_other_responses_of_the_stated_rms():
    """Three years at 0.3 % leave 0.9 % from pixel to pixel; flats of the flight's date none beyond their photon noise."""
    noise = 1.0 / np.sqrt(0.4 * QUIET.converter.full_well_e * 100_000)
    fresh = calibration(flat_change_per_year=3e-3)
    assert fresh.std() == pytest.approx(noise, rel=0.05)
    old = calibration(flat_change_per_year=3e-3, age_years=3.0)
    assert old.std() == pytest.approx(9e-3, rel=0.01)
    assert old.mean() == pytest.approx(1.0, abs=1e-4)
    assert np.corrcoef(old[:, :-1].ravel(), old[:, 1:].ravel())[0, 1] == pytest.approx(0.0, abs=0.01)


def test_an_uneven_lamp_leaves_a_smooth_error_of_the_stated_rms():
    rms = []
    for seed in range(60):
        options = CalibrationOptions(flat_frames=100_000, flat_error=0.01)
        flat = sensor(seed=seed, size=48, calibration=options).calibration_maps(0.2).flat.astype(np.float64)
        rms.append(np.mean((flat - 1.0) ** 2))
        assert np.abs(np.diff(flat, 2, axis=0)).max() < 2e-3
    assert np.sqrt(np.mean(rms)) == pytest.approx(0.01, rel=0.12)


def test_the_linearity_error_is_drawn_and_bends_signal_and_flat():
    """A loss of 2 % at full well where the laboratory found 1 %: half of full well loses 1 % instead of 0.5 %."""
    bent = ConverterOptions(nonlinearity=0.01, nonlinearity_error=1.0, dual_gain=False, bits=16, gain_e_adu=1.0)
    half = 0.5 * bent.full_well_e
    adu = sensor(size=64, converter=bent, shot_noise=False).digitise(flat(half, 64), 0, 0.2).astype(float)
    assert adu.mean() - bent.pedestal_adu == pytest.approx(half * (1.0 - 0.02 * 0.5), abs=1.0)
    # What is 30 % fainter than the axis loses less: by the 1 % that the curve misses, times 0.4 of full well, times 0.3.
    light = np.array([[1.0, 0.7]], dtype=np.float32)
    depart_flat(light, replace(QUIET, converter=bent, calibration=CalibrationOptions(flat_level=0.4)), 1)
    assert light[0] == pytest.approx([1.0, 0.7 * (1.0 + 0.01 * 0.4 * 0.3)], rel=1e-6)
    options = SimulatorOptions()
    built = replace(options.instrument, as_built=replace(options.instrument.as_built, drawn=True))
    converter = replace(options.sensor.converter, nonlinearity_error=0.3)
    options = replace(options, instrument=built, sensor=replace(options.sensor, converter=converter))
    errors = [with_drawn_errors(options, seed).sensor.converter.nonlinearity_error for seed in range(300)]
    assert np.std(errors) == pytest.approx(0.3, rel=0.12)
    assert np.mean(errors) == pytest.approx(0.0, abs=0.06)


@pytest.mark.parametrize("peak", [0.25, 0.5, 1.0])
def test_bright_images_are_wider_by_the_closed_form(peak):
    """A Gaussian's variance along each axis grows by 2 share / full well x sum Q^2 / sum Q; no electron is lost (1 %)."""
    full, share = 39000.0, 0.01
    offset = np.arange(41) - 20.2
    image = (peak * full * np.exp(-0.5 * (offset[:, None] ** 2 + offset**2) / 1.3**2)).astype(np.float32)
    before = image.astype(np.float64)
    spread_charge(image, full, share)
    after = image.astype(np.float64)
    assert after.sum() == pytest.approx(before.sum(), rel=1e-6)
    expected = 2.0 * share / full * (before**2).sum() / before.sum()
    for axis in (0, 1):
        moments = [(q.sum(axis=1 - axis) * offset**2).sum() / q.sum() for q in (before, after)]
        centres = [(q.sum(axis=1 - axis) * offset).sum() / q.sum() for q in (before, after)]
        assert moments[1] - moments[0] == pytest.approx(expected, rel=0.01)
        assert centres[1] == pytest.approx(centres[0], abs=1e-5)
