"""Dark, flat and defect maps as a calibration campaign would reduce them, with the noise that its frames leave.

The averages of N dark and N flat frames are not made frame by frame: each pixel's average is drawn from the normal
distribution that the average of N independent frames has (mean of the pixel, its variance over N), which differs from the
frame-by-frame result only in higher moments that fall as 1/N.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit
from simulator.optics.vignetting import IlluminationGrid, illumination_of_row
from simulator.randomness import Effect, generator, seed_word
from simulator.sensor.binning import bin_flags, bin_means
from simulator.sensor.counter import GAMMA, NORMAL_TABLE, mix, normal, row_key
from simulator.sensor.maps import PixelModel
from simulator.sensor.options import SensorOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationMaps:
    """Maps of delivered pixels: dark_adu (pedestal and dark signal of one exposure), flat (1 on axis), defects (`MaskBit`)."""

    dark_adu: NDArray[np.float32]
    flat: NDArray[np.float32]
    defects: NDArray[np.uint8]


def reduce_calibration(
    options: SensorOptions,
    pixels: PixelModel,
    exposure_s: float,
    illumination: IlluminationGrid,
    jumps: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]],
    seed: int,
) -> CalibrationMaps:
    """Maps of the pixels of a window.

    illumination : of the flat field, 1 on axis.
    jumps : row, col and mean electrons of telegraph pixels over the dark frames.

    The dark map of a CCD's on-chip sums is that of frames read as such: charge of all pixels of a sum, one pedestal and one
    read-out. Its defects and its flat are those of frames whose pixels are read one by one.
    """
    calibration, converter = options.calibration, options.converter
    known = (converter.true_gain_e_adu, float(converter.pedestal_adu), converter.full_well_e, converter.true_nonlinearity)
    known_of_sums = (*known[:2], options.read_well_e, known[3])
    frames = (float(calibration.dark_frames), float(calibration.flat_frames))
    word = np.uint64(seed_word(seed, Effect.CALIBRATION))
    flat_e = calibration.flat_level * converter.full_well_e
    dark_adu = np.empty(pixels.response.shape, dtype=np.float32)
    flat = np.empty(pixels.response.shape, dtype=np.float32)
    _average_frames(
        (pixels.response, pixels.dark, pixels.noise),
        (pixels.response_of, pixels.dark_rate_of_e_s * exposure_s, pixels.noise_of_e),
        pixels.column_e,
        *illumination,
        flat_e,
        known,
        frames,
        word,
        NORMAL_TABLE,
        dark_adu,
        flat,
    )
    depart_flat(flat, options, seed)
    row, col, jump_e = jumps
    dark_adu[row, col] += jump_e / np.float32(converter.true_gain_e_adu)
    median_noise_adu = pixels.median_noise_e / converter.gain_e_adu
    typical_adu = float(np.median(dark_adu[::13, ::7]))
    defects = np.zeros(flat.shape, dtype=np.uint8)
    hot_adu = typical_adu + calibration.hot_sigma * median_noise_adu
    _flag_defects(dark_adu, flat, *illumination, hot_adu, defects)
    binning = options.binning
    if binning.rows * binning.cols > 1:
        defects = bin_flags(defects, binning)
        flat = bin_means(flat, binning)
        if options.on_chip_sum:
            dark_of_e = np.minimum(pixels.dark_rate_of_e_s * exposure_s, converter.full_well_e).astype(np.float32)
            charge_e = bin_means(np.take(dark_of_e, pixels.dark), binning) * np.float32(binning.rows * binning.cols)
            dark_adu = np.empty(charge_e.shape, dtype=np.float32)
            noise_of_e, column_e = pixels.noise_of_e, pixels.column_e
            _average_sums(charge_e, pixels.noise, noise_of_e, column_e, known_of_sums, frames[0], word, NORMAL_TABLE, dark_adu)
            np.add.at(dark_adu, (row // binning.rows, col // binning.cols), jump_e / np.float32(converter.true_gain_e_adu))
        else:
            dark_adu = bin_means(dark_adu, binning)
            if binning.method == "sum":
                dark_adu *= np.float32(binning.rows * binning.cols)  # with a pedestal for each pixel
    return CalibrationMaps(dark_adu=dark_adu, flat=flat, defects=defects)


def depart_flat(flat: NDArray[np.float32], options: SensorOptions, seed: int) -> None:
    """What a flat of another date and lamp gets wrong, in place: the lamp's unevenness, changed responses, the linearity curve.

    The lamp's error is a plane and a quadratic over the window with coefficients drawn by seed, of the given rms on average.
    Responses have changed by a normal share, rms in proportion to the years. Flats are made linear by the nominal curve.
    """
    calibration, converter = options.calibration, options.converter
    change = calibration.flat_change_per_year * calibration.age_years
    bend = (converter.true_nonlinearity - converter.nonlinearity) * calibration.flat_level
    if calibration.flat_error == 0.0 and change == 0.0 and bend == 0.0:
        return
    unit_rms = np.array([1.0 / np.sqrt(3.0), 1.0 / np.sqrt(3.0), np.sqrt(4.0 / 45.0), 1.0 / 3.0, np.sqrt(4.0 / 45.0)])
    lamp = generator(seed, Effect.FLAT_ERRORS).standard_normal(5) * calibration.flat_error / (np.sqrt(5.0) * unit_rms)
    _depart(flat, lamp, change, bend, np.uint64(seed_word(seed, Effect.FLAT_ERRORS, 0, 1)), NORMAL_TABLE)


@numba.njit(cache=True)
def _depart(
    flat: NDArray[np.float32],
    lamp: NDArray[np.float64],
    change: float,
    bend: float,
    word: np.uint64,
    normals: NDArray[np.float32],
) -> None:
    """lamp : factors of y, x, y^2 - 1/3, x y, x^2 - 1/3 on [-1, 1]^2. bend : loss of a flat of 1, relative."""
    rows, cols = flat.shape
    for r in range(rows):
        y = 2.0 * r / max(rows - 1, 1) - 1.0
        position = row_key(word, r)
        for c in range(cols):
            x = 2.0 * c / max(cols - 1, 1) - 1.0
            position += GAMMA
            light = 1.0 + y * (lamp[0] + lamp[2] * y + lamp[3] * x) + x * (lamp[1] + lamp[4] * x) - (lamp[2] + lamp[4]) / 3.0
            value = flat[r, c] * light * (1.0 + change * normal(mix(position), normals))
            flat[r, c] = value * (1.0 - bend * (value - 1.0))


@numba.njit(cache=True)
def _average_frames(
    classes: tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]],
    meanings: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    column_e: NDArray[np.float64],
    light_nodes: NDArray[np.float32],
    light_step_px: int,
    flat_e: float,
    converter: tuple[float, float, float, float],
    frames: tuple[float, float],
    word: np.uint64,
    normals: NDArray[np.float32],
    dark_adu: NDArray[np.float32],
    flat: NDArray[np.float32],
) -> None:
    """classes : of the pixels' response, dark current and read noise; meanings : what each class means, in electrons or 1."""
    (response, dark, noise), (response_of, dark_of, noise_of) = classes, meanings
    gain, pedestal, full_well, bend = converter
    dark_frames, flat_frames = frames
    rounding = 1.0 / 12.0
    light, light_ends = np.empty(flat.shape[1], np.float32), np.empty((2, flat.shape[1]), np.float32)
    for r in range(response.shape[0]):
        illumination_of_row(light_nodes, light_step_px, r, light_ends, light)
        position = row_key(word, r)
        for c in range(response.shape[1]):
            dark_e = min(dark_of[dark[r, c]], full_well)
            read_variance = noise_of[noise[r, c]] ** 2
            position += GAMMA
            sigma = np.sqrt(((dark_e + read_variance) / gain**2 + rounding) / dark_frames)
            linear = dark_e - bend / full_well * dark_e**2
            dark_adu[r, c] = pedestal + (linear + column_e[c]) / gain + sigma * normal(mix(position), normals)
            position += GAMMA
            signal = flat_e * response_of[response[r, c]] * light[c]
            sigma = np.sqrt((signal + dark_e + read_variance) / flat_frames)
            flat[r, c] = (signal + sigma * normal(mix(position), normals)) / flat_e


@numba.njit(cache=True)
def _average_sums(
    charge_e: NDArray[np.float32],
    noise: NDArray[np.uint8],
    noise_of_e: NDArray[np.float64],
    column_e: NDArray[np.float64],
    converter: tuple[float, float, float, float],
    frames: float,
    word: np.uint64,
    normals: NDArray[np.float32],
    dark_adu: NDArray[np.float32],
) -> None:
    """Averages of dark frames of on-chip sums. charge_e : (rows, cols) mean charge of each; noise, column_e : as it is read."""
    gain, pedestal, full_well, bend = converter
    for r in range(charge_e.shape[0]):
        position = row_key(word, r)
        for c in range(charge_e.shape[1]):
            position += GAMMA
            dark_e = min(charge_e[r, c], full_well)
            sigma = np.sqrt(((dark_e + noise_of_e[noise[r, c]] ** 2) / gain**2 + 1.0 / 12.0) / frames)
            signal = dark_e - bend / full_well * dark_e**2 + column_e[c]
            dark_adu[r, c] = pedestal + signal / gain + sigma * normal(mix(position), normals)


_HOT = int(MaskBit.HOT)
_DEAD = int(MaskBit.DEAD)


@numba.njit(cache=True)
def _flag_defects(
    dark_adu: NDArray[np.float32],
    flat: NDArray[np.float32],
    light_nodes: NDArray[np.float32],
    light_step_px: int,
    hot_adu: float,
    defects: NDArray[np.uint8],
) -> None:
    """Hot: dark signal above `hot_adu`. Dead: less than half of the response that the illumination asks for."""
    light, light_ends = np.empty(flat.shape[1], np.float32), np.empty((2, flat.shape[1]), np.float32)
    for r in range(flat.shape[0]):
        illumination_of_row(light_nodes, light_step_px, r, light_ends, light)
        for c in range(flat.shape[1]):
            bits = _HOT if dark_adu[r, c] > hot_adu else 0
            if flat[r, c] < 0.5 * light[c]:
                bits |= _DEAD
            defects[r, c] = bits
