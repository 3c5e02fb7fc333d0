"""Broad trails that were found in pieces: collinear fits, wider than the optics, become one from the first end to the last.

Objects follow each other in a line too, but those are as sharp as stars; only light that is broad for another reason (defocus,
a near satellite's size) breaks into pieces where its texture does.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.streaks.fit_record import in_pixel_order, reversed_ends
from ground.streaks.trail_frame import TrailFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit

BROAD: Final = 2.0
"""Least width of a piece over that of the PSF."""

LEAST_SNR: Final = 50.0
"""Fainter pieces are not told from a slope of the background; chosen, not measured."""
LEAST_WIDTHS: Final = 8.0
"""Least length over width of a piece, which gives its direction; chosen, not measured."""
BESIDE_WIDTHS: Final = 1.5
"""How far the ends of a piece may lie from the line of the others."""

LARGEST_GAP: Final = 1.0
"""Between a piece and the line so far, over the longer of both."""

LEAST_COVERED: Final = 0.6
"""Share of a joined trail in which light was measured."""


def with_joined_pieces(fits: Sequence[StreakFit], psf_sigma_px: float) -> list[StreakFit]:
    """The same fits, except that the longest piece of each broken broad trail is extended from its first end to its last.

    The other pieces stay. They lie in the light of the joined one, and `repeated` recognises them by that.
    """
    out = list(fits)
    pieces = [
        k
        for k, fit in enumerate(fits)
        if not fit.flags & StreakFlag.FIT_FAILED
        and fit.width_px > BROAD * psf_sigma_px
        and fit.snr >= LEAST_SNR
        and fit.length_px > LEAST_WIDTHS * fit.width_px
    ]
    pieces.sort(key=lambda k: -fits[k].length_px)
    used: set[int] = set()
    for seed in pieces:
        if seed in used:
            continue
        chain = _chain(fits, seed, [k for k in pieces if k not in used and k != seed])
        used.update(chain)
        joined = _joined([fits[k] for k in chain])
        if joined is not None:
            out[seed] = joined
    return out


def _ends(fit: StreakFit) -> NDArray[np.float64]:
    return np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]])


def _chain(fits: Sequence[StreakFit], seed: int, others: Sequence[int]) -> list[int]:
    """Fits on the line of a seed, which grows with each; the nearest first."""
    chain, line = [seed], _ends(fits[seed])
    left = list(others)
    while True:
        middle, length = line.mean(axis=0), float(np.linalg.norm(line[1] - line[0]))
        along = (line[1] - line[0]) / length
        best: tuple[float, int] | None = None
        for k in left:
            offset = _ends(fits[k]) - middle
            across, place = offset @ np.array([-along[1], along[0]]), offset @ along
            gap = max(0.0, float(np.abs(place).min()) - 0.5 * length)
            near = np.abs(across).max() < BESIDE_WIDTHS * max(fits[k].width_px, fits[seed].width_px)
            if near and gap < LARGEST_GAP * max(length, fits[k].length_px) and (best is None or gap < best[0]):
                best = gap, k
        if best is None:
            return chain
        left.remove(best[1])
        chain.append(best[1])
        points = np.vstack((line, _ends(fits[best[1]])))
        order = np.argsort((points - middle) @ along)
        line = points[order[[0, -1]]]


def _joined(pieces: Sequence[StreakFit]) -> StreakFit | None:
    """One fit of all pieces; None where none reaches beyond the first, or too little of the line holds light."""
    first = pieces[0]
    along = (_ends(first)[1] - _ends(first)[0]) / first.length_px
    # ends go by growing column, so those of nearly vertical pieces may be either way round
    forward = [piece if (_ends(piece)[1] - _ends(piece)[0]) @ along > 0.0 else reversed_ends(piece) for piece in pieces]
    spans = np.array([(_ends(piece) - _ends(first)[0]) @ along for piece in forward])
    low, high = int(np.argmin(spans[:, 0])), int(np.argmax(spans[:, 1]))
    length = spans[high, 1] - spans[low, 0]
    steps = np.arange(spans[low, 0], spans[high, 1])
    lit = np.any((steps[:, None] >= spans[:, 0]) & (steps[:, None] <= spans[:, 1]), axis=1)
    if length < first.length_px + LEAST_WIDTHS * first.width_px or lit.mean() < LEAST_COVERED:
        return None
    flux = length * float(np.median([piece.flux_e / piece.length_px for piece in forward]))
    covariance = np.zeros((4, 4))
    covariance[:2, :2], covariance[2:, 2:] = forward[low].covariance_px2[:2, :2], forward[high].covariance_px2[2:, 2:]
    edges = forward[low].flags & StreakFlag.EDGE0 | forward[high].flags & StreakFlag.EDGE1
    growth = float(length * lit.mean() / first.length_px)
    sagitta, sagitta_err = _sagitta_px(forward, forward[low], forward[high])
    joined = replace(
        first,
        row0=forward[low].row0,
        col0=forward[low].col0,
        row1=forward[high].row1,
        col1=forward[high].col1,
        covariance_px2=covariance,
        end_interval_px=np.stack((forward[low].end_interval_px[0], forward[high].end_interval_px[1])),
        light_interval_px=np.stack((forward[low].light_ends_px[0], forward[high].light_ends_px[1])),
        flux_e=flux,
        flux_err_e=abs(flux) * first.flux_err_e / max(abs(first.flux_e), 1e-9),
        flash_e=0.0,
        snr=first.snr * max(growth, 1.0) ** 0.5,
        flags=first.flags & ~(StreakFlag.EDGE0 | StreakFlag.EDGE1) | edges,
        light_curve_e_px=np.zeros(0, dtype=np.float32),
        light_curve_err_e_px=np.zeros(0, dtype=np.float32),
        period_fraction=None,
        sagitta_px=sagitta,
        sagitta_err_px=sagitta_err,
    )
    return in_pixel_order(joined)


def _sagitta_px(pieces: Sequence[StreakFit], first: StreakFit, last: StreakFit) -> tuple[float, float]:
    """Height of the parabola over the chord from the first piece's start to the last one's end, by all ends, and its error.

    A piece's own height, carried on to the whole length, would be far more uncertain.
    """
    chord = TrailFrame.of_chord(first.row0, first.col0, last.row1, last.col1)
    ends = np.concatenate([_ends(piece) for piece in pieces])
    along, across = chord.to_trail(ends[:, 0], ends[:, 1])
    half = 0.5 * math.hypot(last.row1 - first.row0, last.col1 - first.col0)
    height = 1.0 - (along / half) ** 2
    weight = float(height @ height)
    return float(height @ across) / weight, max(piece.sigma_cross_px for piece in pieces) / math.sqrt(weight)
