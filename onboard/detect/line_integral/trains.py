"""A row of equal trails one behind the other, found as one line, taken apart: satellite trains, rows of geostationary satellites.

Summed along their common line they are a trail with holes, and as even in its quarters as any. Trails of one exposure and speed
are equally long, with nothing between them; a tumbling object's light rises and falls.
"""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import whiten
from onboard.detect.line_integral.segments import with_edges
from onboard.detect.line_integral.static_sky import lit_pixels
from sboc_e2e.icd.signals import Detection, DetectorView

LEAST_PIECES: Final = 3  # two even pieces are a gap in one trail; of three even ones each gap is alike. Chosen, not measured
LEAST_SNR: Final = 20.0  # three pieces of S/N 6 make 10; their gaps must be seen to be empty, too. Chosen, not measured
LEAST_LENGTH_PX: Final = 30.0  # three pieces and two gaps need so much room. Chosen, not measured

LIT_SHARE: Final = 0.4
"""A line of pixels belongs to a piece from this share of the bright ones' light on."""

EMPTY_SHARE: Final = 0.12
"""Between pieces there is less than this share of their light."""

EVEN: Final = 0.3
"""Scatter of the pieces' lengths over their mean, at most."""

LEAST_GAP_PX: Final = 4.0  # px: two at either side are the pieces' own rim
BEYOND_PX: Final = 12.0  # px beyond either end that are looked at, so that outer pieces are whole. Chosen, not measured


def light_along(
    detection: Detection, view: DetectorView, blocked: NDArray[np.uint8], psf_sigma_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Matched sums and their weights (n,) for each px along a detection's axis, and their distances from end 0 (px)."""
    length = detection.length_px
    u_row, u_col = (detection.row1 - detection.row0) / length, (detection.col1 - detection.col0) / length
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    ends += BEYOND_PX * np.array([-u_row, -u_col, u_row, u_col])
    at_row, at_col, profile = lit_pixels(blocked, whiten.FOUND_BIT, ends, psf_sigma_px)
    good = view.mask[at_row, at_col] == 0
    at_row, at_col, profile = at_row[good], at_col[good], profile[good]
    tile, nodes = view.background.tile_px, view.background.sigma_adu
    sigma = nodes[np.minimum(at_row // tile, nodes.shape[0] - 1), np.minimum(at_col // tile, nodes.shape[1] - 1)]
    value = view.residual_adu[at_row, at_col] / np.maximum(sigma, 1e-9)
    major, slope = (at_row, u_row) if abs(u_row) >= abs(u_col) else (at_col, u_col)
    if not len(major):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    first = int(major.min())
    n = int(major.max()) - first + 1
    signal = np.bincount(major - first, profile * value, n).astype(np.float64)
    weight = np.bincount(major - first, profile**2, n).astype(np.float64)
    start = detection.row0 if slope == u_row and abs(u_row) >= abs(u_col) else detection.col0
    return signal, weight, np.asarray((np.arange(n) + first - start) / slope, dtype=np.float64)


def pieces(signal: NDArray[np.float64], weight: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Runs [first, stop) of equally long lit lines with nothing between; empty when they are not those of a row of trails."""
    light = np.convolve(signal, np.ones(3), "same") / np.maximum(np.convolve(weight, np.ones(3), "same"), 1e-6)
    bright = float(np.sort(light)[math.ceil(0.95 * (len(light) - 1))])
    lit = np.concatenate(([False], light > LIT_SHARE * bright, [False]))
    edges = np.flatnonzero(lit[1:] != lit[:-1])
    runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    power = [signal[a:b].sum() / math.sqrt(max(float(weight[a:b].sum()), 1e-9)) for a, b in runs]
    runs = [run for run, snr in zip(runs, power, strict=True) if snr > 6.0]
    if len(runs) < LEAST_PIECES:
        return []
    lengths = np.array([b - a for a, b in runs], dtype=np.float64)
    gaps = [(a, b) for (_, a), (b, _) in pairwise(runs)]
    if lengths.std() > EVEN * lengths.mean() or min(b - a for a, b in gaps) < LEAST_GAP_PX:
        return []
    # the rim of two lines on each side is the pieces' own
    between = np.concatenate([np.arange(a + 2, b - 2) for a, b in gaps])
    empty = signal[between].sum() / max(float(weight[between].sum()), 1e-9) if len(between) else math.inf
    return runs if empty < EMPTY_SHARE * bright else []


def taken_apart(detection: Detection, view: DetectorView, blocked: NDArray[np.uint8], psf_sigma_px: float) -> list[Detection]:
    """The trails of a row as detections of their own; anything else as it is."""
    if detection.snr < LEAST_SNR or detection.length_px < LEAST_LENGTH_PX:
        return [detection]
    signal, weight, along = light_along(detection, view, blocked, psf_sigma_px)
    runs = pieces(signal, weight) if len(signal) else []
    if not runs:
        return [detection]
    u_row = (detection.row1 - detection.row0) / detection.length_px
    u_col = (detection.col1 - detection.col0) / detection.length_px
    rows, cols = view.mask.shape
    out = []
    for first, stop in runs:
        low, high = sorted((float(along[first]), float(along[stop - 1])))
        snr = float(signal[first:stop].sum() / math.sqrt(max(float(weight[first:stop].sum()), 1e-9)))
        row0, row1 = (float(np.clip(detection.row0 + x * u_row, 0, rows - 1)) for x in (low, high))
        col0, col1 = (float(np.clip(detection.col0 + x * u_col, 0, cols - 1)) for x in (low, high))
        piece = replace(detection, row0=row0, col0=col0, row1=row1, col1=col1, snr=snr, sagitta_px=0.0)
        out.append(with_edges(piece, (rows, cols)))
    return out
