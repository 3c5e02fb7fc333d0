"""Structure of a read-out chain that is new in every frame, and charge that does not stay in its pixel."""

from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

from simulator.randomness import Effect, generator

Array = NDArray[np.float64]

_DRIFT_TERMS = 12
"""Waves whose periods lie within a factor of 2 of the given one; more are nearer to Gaussian. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True)
class StructureOptions:
    """Row, column and black-level structure, coupling of pixels, blooming; all of it off by default."""

    row_flicker_e: float = field(
        default=0.0, metadata={"doc": "rms over a frame of row offsets with a 1/f spectrum", "min": 0.0, "max": 100.0}
    )
    column_noise_e: float = field(
        default=0.0, metadata={"doc": "offset of each column, new in each frame", "min": 0.0, "max": 100.0}
    )
    black_drift_e: float = field(
        default=0.0, metadata={"doc": "rms of the slow drift of the black level", "min": 0.0, "max": 1000.0}
    )
    black_drift_frames: float = field(
        default=400.0, metadata={"doc": "frames in which the black level wanders", "min": 2.0, "max": 1e6}
    )
    coupling: float = field(
        default=0.0,
        metadata={
            "doc": "share of a pixel's signal that shows in each of its four neighbours (inter-pixel capacitance)",
            "min": 0.0,
            "max": 0.1,
        },
    )
    blooming: float = field(
        default=0.0,
        metadata={
            "doc": "share of the charge above full well that flows to the four neighbours (CMOS); the drain takes the rest",
            "min": 0.0,
            "max": 0.95,
        },
    )
    lag: float = field(
        default=0.0,
        metadata={"doc": "share of a pixel's charge that shows in the next frame (image lag)", "min": 0.0, "max": 0.5},
    )
    brighter_fatter: float = field(
        default=0.0,
        metadata={
            "doc": "share of its light that a pixel at full well loses to each empty neighbour while charge repels charge",
            "min": 0.0,
            "max": 0.2,
        },
    )


def row_offsets_e(options: StructureOptions, seed: int, frame: int, rows: int) -> Array:
    """Offset of each row of the detector in a frame: black level and 1/f noise, (rows,).

    1/f: normal Fourier amplitudes whose variance falls as 1/f from one cycle in the frame on (Kasdin 1995, Proc. IEEE 83, 802).
    The black level is a sum of slow waves of random phase, so that any frame can be asked for alone.
    """
    out = np.full(rows, _black_level_e(options, seed, frame))
    if options.row_flicker_e > 0.0 and rows > 1:
        rng = generator(seed, Effect.ROW_STRUCTURE, frame)
        k = np.arange(1, rows // 2 + 1)
        amplitude = np.concatenate([[0.0], rng.normal(size=k.size) + 1j * rng.normal(size=k.size)])
        amplitude[1:] /= np.sqrt(2.0 * k)
        wave = np.fft.irfft(amplitude, rows) * rows
        out += options.row_flicker_e * wave / np.sqrt(2.0 * np.sum(1.0 / k))
    return out


def _black_level_e(options: StructureOptions, seed: int, frame: int) -> float:
    if options.black_drift_e == 0.0:
        return 0.0
    rng = generator(seed, Effect.BLACK_LEVEL)
    periods = options.black_drift_frames * np.exp(rng.uniform(-0.7, 0.7, _DRIFT_TERMS))
    phases = rng.uniform(0.0, 2.0 * np.pi, _DRIFT_TERMS)
    return float(options.black_drift_e * np.sqrt(2.0 / _DRIFT_TERMS) * np.sin(2.0 * np.pi * frame / periods + phases).sum())


def column_offsets_e(options: StructureOptions, seed: int, frame: int, cols: int) -> Array:
    """Offset of each column that is new in a frame, (cols,)."""
    if options.column_noise_e == 0.0:
        return np.zeros(cols)
    return np.asarray(options.column_noise_e * generator(seed, Effect.ROW_STRUCTURE, frame, 1).standard_normal(cols))


@numba.njit(cache=True)
def couple(charge_e: NDArray[np.float64], share: float, out: NDArray[np.float64]) -> None:
    """Signal of pixels that show a share of their neighbours' for some of their own (Moore et al. 2006, Opt. Eng. 45, 076402).

    charge_e : (n, cols). out : (n, cols); beyond the edges there is nothing to exchange with.
    """
    rows, cols = charge_e.shape
    for r in range(rows):
        for c in range(cols):
            own = charge_e[r, c]
            flow = 0.0
            if r > 0:
                flow += charge_e[r - 1, c] - own
            if r + 1 < rows:
                flow += charge_e[r + 1, c] - own
            if c > 0:
                flow += charge_e[r, c - 1] - own
            if c + 1 < cols:
                flow += charge_e[r, c + 1] - own
            out[r, c] = own + share * flow


_LEAST_OF_FULL = np.float32(0.005)


@numba.njit(cache=True)
def spread_charge(mean_e: NDArray[np.float32], full_well_e: float, share: float) -> None:
    """Borders between pixels move towards the fuller one and take light with them, in place (brighter-fatter).

    The border moves with the difference of charges, and the light on it is their mean (Guyonnet et al. 2015,
    A&A 575, A41); nearest neighbours alone: a flow of ``share / full well (p^2 - q^2)``. The second moment of any image grows by
    ``2 share / full well x sum Q^2 / sum Q`` along each axis. Pairs below 0.5 % of full well exchange too little to matter.
    """
    rows, cols = mean_e.shape
    full = np.float32(full_well_e)
    least, factor = _LEAST_OF_FULL * full, np.float32(share / full_well_e)
    above, here = np.zeros(cols, np.float32), np.empty(cols, np.float32)
    for r in range(rows):
        for c in range(cols):
            here[c] = min(mean_e[r, c], full)
        for c in range(cols):
            if c + 1 < cols and (here[c] > least or here[c + 1] > least):
                flow = factor * (here[c] * here[c] - here[c + 1] * here[c + 1])
                mean_e[r, c] -= flow
                mean_e[r, c + 1] += flow
            if r > 0 and (here[c] > least or above[c] > least):
                flow = factor * (above[c] * above[c] - here[c] * here[c])
                mean_e[r - 1, c] -= flow
                mean_e[r, c] += flow
        above[:] = here


@numba.njit(cache=True)
def bloom(mean_e: NDArray[np.float32], full_well_e: float, share: float) -> None:
    """Charge above full well flows to the four neighbours, a quarter of the share to each, as often as it takes; in place.

    Each step loses 1 - share into the drain, so that the charge dies out; pixels that overflow are listed, not searched again.
    """
    rows, cols = mean_e.shape
    full = np.float32(full_well_e)
    waiting = []
    for r in range(rows):
        for c in range(cols):
            if mean_e[r, c] > full:
                waiting.append(np.int64(r) * cols + c)
    while len(waiting) > 0:
        place = waiting.pop()
        r, c = place // cols, place % cols
        excess = mean_e[r, c] - full
        if excess <= 0.0:
            continue
        mean_e[r, c] = full
        spread = np.float32(0.25 * share) * excess
        if spread < 0.05:
            continue
        for step in range(4):
            y = r + (1 if step == 0 else (-1 if step == 1 else 0))
            x = c + (1 if step == 2 else (-1 if step == 3 else 0))
            if 0 <= y < rows and 0 <= x < cols:
                mean_e[y, x] += spread
                if mean_e[y, x] > full:
                    waiting.append(np.int64(y) * cols + x)


@numba.njit(cache=True)
def defer_charge(charge_e: NDArray[np.float64], loss: float, tail_rows: float) -> None:
    """Charge that traps hold back from pixels on their way down the columns and release behind them, in place.

    Row r is moved r + 1 times, each time leaving the share `loss`; it comes back with an exponential tail (Janesick 2001,
    section 5.2). To first order in the loss of the whole way.
    """
    rows, cols = charge_e.shape
    release = 1.0 - np.exp(-1.0 / tail_rows)
    held = np.zeros(cols)
    for r in range(rows):
        share = min(loss * (r + 1), 1.0)
        for c in range(cols):
            given = release * held[c]
            taken = share * charge_e[r, c]
            charge_e[r, c] += given - taken
            held[c] += taken - given
