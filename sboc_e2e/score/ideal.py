"""The ideal detector's threshold and half-completeness S/N: a continuous bank of all segments in white noise.

Expected Euler characteristic of the four-parameter S/N field (Adler & Taylor 2007, theorem 15.10.1, leading term),
with the Fisher metric of a straight uniform trail: each end 1/(2 sqrt(pi) s L), cross-track 1/(2 s^2), angle
L^2/(24 s^2) for unit S/N. The formula assumes a smooth field, but the ends of a segment make the field rough; the
factor that a rare-event Monte Carlo gave for the rough ends (0.1 at 2,000 px to 1.09 at 20 px) corrects it.
"""

import math
from typing import Final

import numpy as np
from scipy import optimize

_ROUGHNESS_LENGTH_PX: Final = (20.0, 50.0, 100.0, 200.0, 400.0, 1000.0, 2000.0)
"""Lengths at which the rare-event Monte Carlo was run; between them the factor is interpolated in ln L."""
_ROUGHNESS_FACTOR: Final = (1.09, 0.87, 0.69, 0.48, 0.24, 0.13, 0.10)
"""Its factors at these lengths; the Monte Carlo is not kept here. Twice as much raises the threshold from 6.99 to 7.09 (0.1 false
a frame of 4096 x 4096 px, sigma 0.9 px)."""
MIN_LENGTH_PX: Final = 10.0  # Definition of `ideal_threshold` (docs/scoring.md): shorter trails look like points.
FREE_PARAMETERS: Final = 4  # Of a straight segment: row and column of both ends. Its light is maximised over in closed form.
LEAST_THRESHOLD: Final = 3.0
"""The Euler characteristic u**3 exp(-u**2 / 2) falls above u = sqrt(3) only, and is the false-alarm rate only where u is high."""
MOST_THRESHOLD: Final = 15.0
"""Between these the formula, which holds for high thresholds and falls there, is solved."""


def expected_false(threshold: float, rows: int, cols: int, sigma_px: float) -> float:
    """Expected false maxima above a threshold (sigma) in one frame, over all segments longer than 10 px."""
    length = np.geomspace(MIN_LENGTH_PX, max(rows, cols), 400)
    metric = (1 / (2 * math.sqrt(math.pi) * sigma_px * length)) * (1 / (math.sqrt(2) * sigma_px)) * length
    metric = metric / (math.sqrt(24) * sigma_px)
    metric = metric * np.interp(np.log(length), np.log(_ROUGHNESS_LENGTH_PX), _ROUGHNESS_FACTOR)
    angle = np.linspace(0, math.pi / 2, 91)
    room = np.maximum(cols - np.outer(length, np.cos(angle)), 0) * np.maximum(rows - np.outer(length, np.sin(angle)), 0)
    volume = np.trapezoid(room.mean(axis=1) * math.pi * metric, length)
    d = FREE_PARAMETERS
    return float(threshold ** (d - 1) * math.exp(-(threshold**2) / 2) * (2 * math.pi) ** (-(d + 1) / 2) * volume)


def ideal_threshold(false_per_frame: float, rows: int, cols: int, sigma_px: float) -> float | None:
    """Threshold (sigma) at which the ideal detector has the given false alarms in each frame.

    None for a frame so small beside the PSF, or without room for a segment, that fewer are expected above 3 sigma.
    """
    if max(rows, cols) <= MIN_LENGTH_PX or expected_false(LEAST_THRESHOLD, rows, cols, sigma_px) < false_per_frame:
        return None
    limits = (LEAST_THRESHOLD, MOST_THRESHOLD)
    return float(optimize.brentq(lambda u: expected_false(u, rows, cols, sigma_px) - false_per_frame, *limits))


def ideal_snr50(false_per_frame: float, rows: int, cols: int, sigma_px: float) -> float | None:
    """True S/N at which the ideal detector finds half. The maximised statistic is d/(2 S) above the true S/N.

    None where there is no threshold.
    """
    threshold = ideal_threshold(false_per_frame, rows, cols, sigma_px)
    if threshold is None:
        return None
    snr = threshold
    for _ in range(20):
        snr = threshold - FREE_PARAMETERS / (2 * snr)
    return snr
