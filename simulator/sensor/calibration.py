"""Dark, flat and defect maps as a calibration campaign would reduce them, with the noise that its frames leave.

The averages of N dark and N flat frames are not made frame by frame: each pixel's average is drawn from the normal
distribution that the average of N independent frames has (mean of the pixel, its variance over N), which differs from the
frame-by-frame result only in higher moments that fall as 1/N.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import MaskBit
from simulator.sensor.counter import GAMMA, NORMAL_TABLE, mix, normal, row_key
from simulator.sensor.options import BinningOptions, SensorOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationMaps:
    """Maps of delivered pixels: dark_adu (pedestal and dark signal of one exposure), flat (1 on axis), defects (`MaskBit`)."""

    dark_adu: NDArray[np.float32]
    flat: NDArray[np.float32]
    defects: NDArray[np.uint8]


def reduce_calibration(
    options: SensorOptions,
    response_of: NDArray[np.float64],
    dark_of_e: NDArray[np.float64],
    noise_of_e: NDArray[np.float64],
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    noise: NDArray[np.uint8],
    column_e: NDArray[np.float64],
    illumination: NDArray[np.float32] | None,
    word: int,
    bin_means: Callable[[NDArray[np.float32], BinningOptions], NDArray[np.float32]],
) -> CalibrationMaps:
    """Maps from the classes of all pixels; see `Sensor.calibration_maps`."""
    calibration, converter = options.calibration, options.converter
    flat_e = calibration.flat_level * converter.full_well_e
    dark_adu = np.empty(response.shape, dtype=np.float32)
    flat = np.empty(response.shape, dtype=np.float32)
    light = illumination if illumination is not None else np.ones((1, 1), dtype=np.float32)
    _average_frames(
        response,
        dark,
        noise,
        response_of,
        dark_of_e,
        noise_of_e,
        column_e,
        light,
        illumination is not None,
        flat_e,
        (converter.gain_e_adu, float(converter.pedestal_adu), converter.full_well_e, converter.nonlinearity),
        (float(calibration.dark_frames), float(calibration.flat_frames)),
        np.uint64(word),
        NORMAL_TABLE,
        dark_adu,
        flat,
    )
    median_noise_adu = float(noise_of_e[128]) / converter.gain_e_adu
    typical_adu = float(np.median(dark_adu[::13, ::7]))
    defects = np.zeros(response.shape, dtype=np.uint8)
    hot_adu = typical_adu + calibration.hot_sigma * median_noise_adu
    _flag_defects(dark_adu, flat, light, illumination is not None, hot_adu, defects)
    binning = options.binning
    if binning.rows * binning.cols > 1:
        rows, cols = response.shape[0] // binning.rows, response.shape[1] // binning.cols
        blocks = defects[: rows * binning.rows, : cols * binning.cols].reshape(rows, binning.rows, cols, binning.cols)
        defects = np.bitwise_or.reduce(np.bitwise_or.reduce(blocks, axis=3), axis=1)
        dark_adu, flat = bin_means(dark_adu, binning), bin_means(flat, binning)
        if binning.method == "sum":
            n = binning.rows * binning.cols
            offset = np.float32(converter.pedestal_adu)
            # On-chip sums carry one pedestal, sums of converted pixels carry one for each.
            dark_adu = (dark_adu - offset) * n + (offset if options.type == "ccd" else n * offset)
    return CalibrationMaps(dark_adu=dark_adu, flat=flat, defects=defects)


@numba.njit(cache=True)
def _average_frames(
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    noise: NDArray[np.uint8],
    response_of: NDArray[np.float64],
    dark_of: NDArray[np.float64],
    noise_of: NDArray[np.float64],
    column_e: NDArray[np.float64],
    light: NDArray[np.float32],
    lit: bool,
    flat_e: float,
    converter: tuple[float, float, float, float],
    frames: tuple[float, float],
    word: np.uint64,
    normals: NDArray[np.float32],
    dark_adu: NDArray[np.float32],
    flat: NDArray[np.float32],
) -> None:
    gain, pedestal, full_well, bend = converter
    dark_frames, flat_frames = frames
    rounding = 1.0 / 12.0
    for r in range(response.shape[0]):
        position = row_key(word, r)
        for c in range(response.shape[1]):
            dark_e = min(dark_of[dark[r, c]], full_well)
            read_variance = noise_of[noise[r, c]] ** 2
            position += GAMMA
            sigma = np.sqrt(((dark_e + read_variance) / gain**2 + rounding) / dark_frames)
            linear = dark_e - bend / full_well * dark_e**2
            dark_adu[r, c] = pedestal + (linear + column_e[c]) / gain + sigma * normal(mix(position), normals)
            position += GAMMA
            signal = flat_e * response_of[response[r, c]]
            if lit:
                signal *= light[r, c]
            sigma = np.sqrt((signal + dark_e + read_variance) / flat_frames)
            flat[r, c] = (signal + sigma * normal(mix(position), normals)) / flat_e


_HOT = int(MaskBit.HOT)
_DEAD = int(MaskBit.DEAD)


@numba.njit(cache=True)
def _flag_defects(
    dark_adu: NDArray[np.float32],
    flat: NDArray[np.float32],
    light: NDArray[np.float32],
    lit: bool,
    hot_adu: float,
    defects: NDArray[np.uint8],
) -> None:
    """Hot: dark signal above `hot_adu`. Dead: less than half of the response that the illumination asks for."""
    for r in range(flat.shape[0]):
        for c in range(flat.shape[1]):
            expected = light[r, c] if lit else np.float32(1.0)
            bits = _HOT if dark_adu[r, c] > hot_adu else 0
            if flat[r, c] < 0.5 * expected:
                bits |= _DEAD
            defects[r, c] = bits
