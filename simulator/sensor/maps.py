"""The fixed pattern of a sensor, drawn once from its seed: response, dark current and read noise of every pixel.

A pixel belongs to one of 256 classes of each property, one byte each: three maps of a 4096 x 4096 sensor take 48 MB. A class
is a standard normal deviate in fine steps; what it means in electrons follows from options and temperature in a table.
"""

import math
from dataclasses import dataclass
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.randomness import Effect, generator, seed_word
from simulator.sensor.counter import GAMMA, NORMAL_TABLE, mix, normal, row_key
from simulator.sensor.options import SensorOptions

_BOLTZMANN_EV_K: Final = 8.617333262e-5  # CODATA 2018; a literal, so that frames do not change with the library's edition

_MIDDLE: Final = 128  # class of the median pixel
_RESPONSE_STEP: Final = 1.0 / 20.0  # sigmas of PRNU from one class to the next; classes 1-255, 0 is dead
_NORMAL_STEP: Final = 1.0 / 16.0  # sigmas of ln(dark), ln(read noise); dark classes 64-192 are ordinary pixels
_WARM: Final = (0, 64)  # dark classes of warm pixels
_HOT: Final = (193, 256)  # dark classes of hot pixels
_DEFECT_SPREAD: Final = 0.6
"""Sigma of ln(dark current) among warm and among hot pixels; their classes span +-2.5 sigma."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPattern:
    """Classes of all pixels of a detector, (rows, cols) uint8 each, and the sparse and per-column structure.

    telegraph_row, telegraph_col, telegraph_e : pixels that jump, sorted by row, and the height of their jump in electrons.
    column_e : (cols,) fixed offset of each column in electrons.
    aged_row, aged_col, aged_class : pixels that became hot since the calibration frames, and their dark class before.
    """

    response: NDArray[np.uint8]
    dark: NDArray[np.uint8]
    noise: NDArray[np.uint8]
    aged_row: NDArray[np.int64]
    aged_col: NDArray[np.int64]
    aged_class: NDArray[np.uint8]
    telegraph_row: NDArray[np.int32]
    telegraph_col: NDArray[np.int32]
    telegraph_e: NDArray[np.float32]
    column_e: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelModel:
    """Pixels of the read-out window: maps of classes, (rows, cols) uint8 each, and what each of the 256 classes means.

    response_of : relative response. dark_rate_of_e_s : dark current. noise_of_e : read noise. column_e : (cols,) offsets.
    """

    response: NDArray[np.uint8]
    dark: NDArray[np.uint8]
    noise: NDArray[np.uint8]
    response_of: NDArray[np.float64]
    dark_rate_of_e_s: NDArray[np.float64]
    noise_of_e: NDArray[np.float64]
    column_e: NDArray[np.float64]

    @property
    def median_dark_e_s(self) -> float:
        """Dark current of the median pixel."""
        return float(self.dark_rate_of_e_s[_MIDDLE])

    @property
    def median_noise_e(self) -> float:
        """Read noise of the median pixel."""
        return float(self.noise_of_e[_MIDDLE])


def pixel_model(options: SensorOptions, pattern: FixedPattern, rows: slice, cols: slice) -> PixelModel:
    """The window ``[rows, cols]`` of a sensor."""
    return PixelModel(
        response=pattern.response[rows, cols],
        dark=pattern.dark[rows, cols],
        noise=pattern.noise[rows, cols],
        response_of=response_of_class(options),
        dark_rate_of_e_s=dark_rate_of_class_e_s(options),
        noise_of_e=read_noise_of_class_e(options),
        column_e=np.ascontiguousarray(pattern.column_e[cols]),
    )


def draw_fixed_pattern(options: SensorOptions, rows: int, cols: int, seed: int) -> FixedPattern:
    """The fixed pattern of a sensor of (rows, cols) pixels from its seed."""
    response, dark, noise = (np.empty((rows, cols), dtype=np.uint8) for _ in range(3))
    word = [np.uint64(seed_word(seed, Effect.SENSOR_MAP, block=block)) for block in range(3)]
    _draw_classes((word[0], word[1], word[2]), NORMAL_TABLE, response, dark, noise)
    rng = generator(seed, Effect.DEFECTS)
    for fraction, (low, high) in ((options.dark.warm_fraction, _WARM), (options.dark.hot_fraction, _HOT)):
        pixels = _draw_pixels(rng, rows * cols, fraction)
        deviate = np.clip(rng.standard_normal(pixels.size), -2.49, 2.49)
        dark.ravel()[pixels] = (low + (deviate + 2.5) / 5.0 * (high - low)).astype(np.uint8)
    response.ravel()[_draw_pixels(rng, rows * cols, options.dark.dead_fraction)] = 0
    telegraph = np.sort(_draw_pixels(rng, rows * cols, options.telegraph.fraction))
    jump = options.telegraph.amplitude_e * np.exp(0.7 * rng.standard_normal(telegraph.size))
    aged = _draw_pixels(rng, rows * cols, min(options.dark.hot_growth_per_year * options.calibration.age_years, 0.5))
    before = dark.ravel()[aged].copy()
    deviate = np.clip(rng.standard_normal(aged.size), -2.49, 2.49)
    dark.ravel()[aged] = (_HOT[0] + (deviate + 2.5) / 5.0 * (_HOT[1] - _HOT[0])).astype(np.uint8)
    column = options.readout.column_offset_e * generator(seed, Effect.SENSOR_MAP, block=3).standard_normal(cols)
    return FixedPattern(
        response=response,
        dark=dark,
        noise=noise,
        aged_row=aged // cols,
        aged_col=aged % cols,
        aged_class=before,
        telegraph_row=(telegraph // cols).astype(np.int32),
        telegraph_col=(telegraph % cols).astype(np.int32),
        telegraph_e=jump.astype(np.float32),
        column_e=column,
    )


def response_of_class(options: SensorOptions) -> NDArray[np.float64]:
    """Relative response of each class: normal with the PRNU as sigma; class 0 is dead."""
    out = 1.0 + options.prnu * (np.arange(256) - _MIDDLE) * _RESPONSE_STEP
    out[0] = 0.0
    return np.clip(out, 0.0, None)


def dark_rate_of_class_e_s(options: SensorOptions) -> NDArray[np.float64]:
    """Dark current of each class at the sensor's temperature.

    Lognormal over ordinary pixels; Arrhenius law in temperature, ``exp(-E/k (1/T - 1/T0))`` (Widenhorn et al. 2002,
    Proc. SPIE 4669, 193, where E ~ 0.63 eV is the generation current of the depletion zone).
    """
    dark = options.dark
    out = dark.median_e_s * np.exp(dark.spread * (np.arange(256) - _MIDDLE) * _NORMAL_STEP)
    for (low, high), median in ((_WARM, dark.warm_e_s), (_HOT, dark.hot_e_s)):
        classes = np.arange(low, high)
        deviate = (classes - low + 0.5) / (high - low) * 5.0 - 2.5
        out[classes] = median * np.exp(_DEFECT_SPREAD * deviate)
    return out * math.exp(-dark.activation_ev / _BOLTZMANN_EV_K * (1.0 / options.temperature_k - 1.0 / dark.reference_k))


def median_pixel(options: SensorOptions) -> tuple[float, float]:
    """Dark current (e-/s) and read noise (e-) of the median pixel at the sensor's temperature, as a `PixelModel` has them."""
    return float(dark_rate_of_class_e_s(options)[_MIDDLE]), float(read_noise_of_class_e(options)[_MIDDLE])


def read_noise_of_class_e(options: SensorOptions) -> NDArray[np.float64]:
    """Read noise of each class in electrons, reset (kTC) noise included where it is not subtracted.

    Lognormal over the pixels of a CMOS sensor with the given rms over the sensor; a CCD reads all pixels through one
    amplifier. kTC noise is ``sqrt(k T C) / e`` (e.g. Janesick 2001, Scientific Charge-Coupled Devices, section 6.2).
    """
    readout = options.readout
    spread = readout.read_noise_spread if options.type == "cmos" else 0.0
    median = readout.read_noise_e * math.exp(-(spread**2))
    out = median * np.exp(spread * (np.arange(256) - _MIDDLE) * _NORMAL_STEP)
    return np.hypot(out, 0.0 if readout.correlated_double_sampling else reset_noise_e(options))


def reset_noise_e(options: SensorOptions) -> float:
    """kTC noise of the sense node in electrons."""
    return math.sqrt(1.380649e-23 * options.temperature_k * options.readout.sense_node_ff * 1e-15) / 1.602176634e-19


def telegraph_charge_e(pattern: FixedPattern, options: SensorOptions, seed: int, frame: int) -> NDArray[np.float32]:
    """Extra electrons of each telegraph pixel in a frame: zero or its jump.

    A pixel keeps its state for `dwell_frames` frames, then draws it anew with even odds (dwell times are geometric in these
    units); the phase differs from pixel to pixel, and any frame can be asked for alone.
    """
    n = pattern.telegraph_e.size
    dwell = options.telegraph.dwell_frames
    state = _telegraph_state(np.uint64(seed_word(seed, Effect.TELEGRAPH)), n, frame, dwell)
    return np.asarray(np.where(state, pattern.telegraph_e, np.float32(0.0)), dtype=np.float32)


def _draw_pixels(rng: np.random.Generator, n_pixels: int, fraction: float) -> NDArray[np.int64]:
    """Pixels without repetition, each chosen with the given probability on average."""
    count = rng.binomial(n_pixels, fraction)
    return np.asarray(rng.choice(n_pixels, size=count, replace=False, shuffle=False), dtype=np.int64)


@numba.njit(cache=True)
def _telegraph_state(word: np.uint64, n: int, frame: int, dwell: int) -> NDArray[np.bool_]:
    state = np.empty(n, np.bool_)
    for i in range(n):
        key = row_key(word, i)
        phase = np.int64(mix(key) >> np.uint64(33)) % dwell
        block = (frame + phase) // dwell
        state[i] = (mix(key + np.uint64(block + 1) * GAMMA) >> np.uint64(63)) == np.uint64(1)
    return state


@numba.njit(cache=True)
def _draw_classes(
    words: tuple[np.uint64, np.uint64, np.uint64],
    normals: NDArray[np.float32],
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    noise: NDArray[np.uint8],
) -> None:
    rows, cols = response.shape
    for r in range(rows):
        key0, key1, key2 = row_key(words[0], r), row_key(words[1], r), row_key(words[2], r)
        for c in range(cols):
            step = (np.uint64(c) + np.uint64(1)) * GAMMA
            z = normal(mix(key0 + step), normals)
            response[r, c] = min(max(round(z / _RESPONSE_STEP) + _MIDDLE, 1), 255)
            z = normal(mix(key1 + step), normals)
            dark[r, c] = min(max(round(z / _NORMAL_STEP) + _MIDDLE, 64), 192)
            z = normal(mix(key2 + step), normals)
            noise[r, c] = min(max(round(z / _NORMAL_STEP) + _MIDDLE, 0), 255)
