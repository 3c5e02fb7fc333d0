"""One pass over the rows of a detector: photo-electrons -> charge -> volts -> ADU.

Every random number is a function of (word of the frame, row, column), so that blocks of rows may be made in any order by
any worker with the same result.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.sensor.counter import GAMMA, draw, mix, normal, row_key
from simulator.sensor.poisson import draw_poisson


@numba.njit(cache=True)
def collect_row(
    mean_e: NDArray[np.float32],
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    response_of: NDArray[np.float64],
    dark_of: NDArray[np.float64],
    shot_noise: bool,
    key: np.uint64,
    tables: NDArray[np.uint64],
    first: NDArray[np.float64],
    normals: NDArray[np.float32],
    work: tuple[NDArray[np.float64], NDArray[np.uint8]],
    charge_e: NDArray[np.float64],
) -> None:
    """Electrons that light and dark current leave in the pixels of one row."""
    mean, doubt = work
    for c in range(mean_e.size):
        light = mean_e[c] * response_of[response[c]]
        # Not a number and negative light count as none; no pixel sees a gigaelectron.
        mean[c] = min(light if light > 0.0 else 0.0, 1e9) + dark_of[dark[c]]
    if shot_noise:
        draw_poisson(mean, key, tables, first, normals, doubt, charge_e)
    else:
        charge_e[:] = mean


@numba.njit(cache=True)
def convert_row(
    charge_e: NDArray[np.float64],
    noise: NDArray[np.uint8],
    noise_of: NDArray[np.float64],
    column_e: NDArray[np.float64],
    row_e: float,
    key: np.uint64,
    normals: NDArray[np.float32],
    chain: tuple[float, float, float, float, float, float, bool, float, float, float, float],
    out: NDArray[np.uint16],
) -> None:
    """ADU of one row: full well, non-linearity, read noise, two amplifiers with a converter each, merged.

    chain : full well (e-), loss per electron (1/e-), high gain (e-/ADU), highest code, code from which the low-gain channel is
        used, pedestal (ADU), whether there is one, low gain (e-/ADU), its read noise (e-); high and low gain as the merging takes
        them (e-/ADU).
    """
    full_well, bend, gain, top, handover, pedestal, dual, low_gain, low_noise, known_gain, known_low_gain = chain
    inverse_gain = 1.0 / gain
    position = key
    for c in range(charge_e.size):
        position += GAMMA
        charge = min(charge_e[c], full_well)
        signal = charge - bend * charge * charge + column_e[c] + row_e
        bits = mix(position)
        code = math.floor((signal + noise_of[noise[c]] * normal(bits, normals)) * inverse_gain + pedestal + 0.5)
        if code < 0.0:
            code = 0.0
        elif dual and code >= handover:
            low = signal + low_noise * normal(mix(position ^ key), normals)
            code = min(max(math.floor(low / low_gain + pedestal + 0.5), 0.0), top)
            code = min(math.floor((code - pedestal) * known_low_gain / known_gain + pedestal + 0.5), 65535.0)
        elif code > top:
            code = top
        out[c] = np.uint16(code)


@numba.njit(cache=True)
def digitise_rows(
    mean_e: NDArray[np.float32],
    first_row: int,
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    noise: NDArray[np.uint8],
    response_of: NDArray[np.float64],
    dark_of: NDArray[np.float64],
    noise_of: NDArray[np.float64],
    column_e: NDArray[np.float64],
    row_noise_e: float,
    row_offset_e: NDArray[np.float64],
    hit_start: NDArray[np.int64],
    hit_col: NDArray[np.int32],
    hit_e: NDArray[np.float32],
    words: tuple[np.uint64, np.uint64, np.uint64],
    shot_noise: bool,
    tables: NDArray[np.uint64],
    first: NDArray[np.float64],
    normals: NDArray[np.float32],
    chain: tuple[float, float, float, float, float, float, bool, float, float, float, float],
    out: NDArray[np.uint16],
) -> None:
    """Rows of a CMOS detector, each from light to ADU while it stays in the processor's cache.

    mean_e : (n, cols) mean photo-electrons; `first_row` is the detector row of the first.
    response, dark, noise : (n, cols) classes of the pixels; *_of : what a class means (relative response, mean dark
        electrons of this exposure, read noise in electrons).
    column_e : (cols,) fixed offsets; row_noise_e : sigma of the offset of each row, beside row_offset_e, (n,).
    hit_start : (n + 1,) first extra charge of each row in hit_col, hit_e (radiation, telegraph jumps).
    words : of shot noise, read noise, row noise. chain : see `convert_row`.
    """
    shot_word, read_word, row_word = words
    charge_e = np.empty(mean_e.shape[1])
    work = (np.empty(mean_e.shape[1]), np.empty(mean_e.shape[1], np.uint8))
    for r in range(mean_e.shape[0]):
        row = first_row + r
        collect_row(
            mean_e[r], response[r], dark[r], response_of, dark_of, shot_noise, row_key(shot_word, row),
            tables, first, normals, work, charge_e,
        )  # fmt: skip
        for h in range(hit_start[r], hit_start[r + 1]):
            charge_e[hit_col[h]] += hit_e[h]
        row_e = row_noise_e * normal(draw(row_key(row_word, row), 0), normals) + row_offset_e[r]
        convert_row(charge_e, noise[r], noise_of, column_e, row_e, row_key(read_word, row), normals, chain, out[r])


@numba.njit(cache=True)
def collect_rows(
    mean_e: NDArray[np.float32],
    first_row: int,
    response: NDArray[np.uint8],
    dark: NDArray[np.uint8],
    response_of: NDArray[np.float64],
    dark_of: NDArray[np.float64],
    hit_start: NDArray[np.int64],
    hit_col: NDArray[np.int32],
    hit_e: NDArray[np.float32],
    shot_word: np.uint64,
    shot_noise: bool,
    tables: NDArray[np.uint64],
    first: NDArray[np.float64],
    normals: NDArray[np.float32],
    charge_e: NDArray[np.float64],
) -> None:
    """The first half of `digitise_rows` alone, for a CCD, whose charge moves before it is converted."""
    work = (np.empty(mean_e.shape[1]), np.empty(mean_e.shape[1], np.uint8))
    for r in range(mean_e.shape[0]):
        collect_row(
            mean_e[r], response[r], dark[r], response_of, dark_of, shot_noise, row_key(shot_word, first_row + r),
            tables, first, normals, work, charge_e[r],
        )  # fmt: skip
        for h in range(hit_start[r], hit_start[r + 1]):
            charge_e[r, hit_col[h]] += hit_e[h]


@numba.njit(cache=True)
def convert_rows(
    charge_e: NDArray[np.float64],
    first_row: int,
    noise: NDArray[np.uint8],
    noise_of: NDArray[np.float64],
    column_e: NDArray[np.float64],
    row_noise_e: float,
    row_offset_e: NDArray[np.float64],
    words: tuple[np.uint64, np.uint64, np.uint64],
    normals: NDArray[np.float32],
    chain: tuple[float, float, float, float, float, float, bool, float, float, float, float],
    out: NDArray[np.uint16],
) -> None:
    """The second half of `digitise_rows` alone."""
    _, read_word, row_word = words
    for r in range(charge_e.shape[0]):
        row = first_row + r
        row_e = row_noise_e * normal(draw(row_key(row_word, row), 0), normals) + row_offset_e[r]
        convert_row(charge_e[r], noise[r], noise_of, column_e, row_e, row_key(read_word, row), normals, chain, out[r])


@numba.njit(cache=True)
def bleed_columns(charge_e: NDArray[np.float64], full_well_e: float) -> None:
    """Charge above full well flows in equal halves up and down its column until it finds room, in place.

    What reaches the first or last row is lost into the register or the drain.
    """
    rows, cols = charge_e.shape
    for c in range(cols):
        for r in range(rows):
            excess = charge_e[r, c] - full_well_e
            if excess <= 0.0:
                continue
            charge_e[r, c] = full_well_e
            for step in (-1, 1):
                rest = 0.5 * excess
                k = r + step
                while rest > 0.0 and 0 <= k < rows:
                    room = full_well_e - charge_e[k, c]
                    if room > 0.0:
                        taken = min(room, rest)
                        charge_e[k, c] += taken
                        rest -= taken
                    k += step
