"""Odds of a line in a frame from outside: the vetter's own, weighed with what held for cameras that it had not seen.

A vetter's classes are those of one simulated camera, and a frame's look-alikes are few. How far both can be trusted, and what the
line's contrast, length and width, the other lines about it and the picture about it add, was fitted to lines of real frames
(logistic regression). With each repository judged by a fit to the others, 439 of 518 measured trails were published and 26 other
lines, in 541 frames (docs/vetting-record.md).
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ground.streaks.centre_line import effective_width_px
from ground.vetting.contrast import Contrast, Tiles
from ground.vetting.distance import told_at_distance
from ground.vetting.features import is_aligned
from ground.vetting.readout import odds_of_readout
from sboc_e2e.icd.products import StreakFit

LARGEST: Final = 7.0
"""Log odds of the vetter count up to this: beyond, they say how far its classes lie apart and not how often it errs."""
LONGEST_WIDTHS: Final = 200.0
"""Longer lines count as this long."""
WIDTHS: Final = 40.0
"""Length over width at which the length says nothing."""
LONG_PX: Final = 40.0
"""Other lines of a frame from this length on are counted, whatever they are: where there are many, few of them are trails."""
FEW: Final = 20
"""So many of them say nothing yet: simulated skies have as many."""
USUAL: Final = (0.9, -0.1, -0.15, 0.6, -2.2, 2.7, 0.17)
"""Numbers of the picture about a line (`surroundings.NAMES`) that say nothing: the means of the lines of real frames."""
LOWEST: Final = (0.4, -1.2, -0.85, 0.1, -3.1, 0.0, 0.0)
"""They count from these on, and"""
HIGHEST: Final = (3.6, 0.6, 0.3, 2.5, -0.9, 5.4, 0.46)
"""up to these: 98 % of the lines lie between."""
LEAST_PROBABILITY: Final = 1e-3
"""What the vetter finds less probable stays so: the other terms add 5 to the log odds at most."""

UNMODELLED_PIECES: Final = 40
"""Pieces of a line that may be a trail of a kind that no class describes, at least: 160 widths of it."""
UNMODELLED_SHARE: Final = 0.7
"""Its wins and its peak, at least: stars beside a trail take up to three pieces in ten. In 265 frames of other cameras 58 lines
off rows and columns have these, of S/N 100 and more: 46 lie on trails as an eye marked them, nine on such trails with other ends,
and three are none, one of them a spike."""
UNMODELLED_SNR: Final = 100.0
"""Its S/N, at least."""
UNMODELLED_PROBABILITY: Final = 0.1
"""The vetter's probability counts as this at least: a satellite of S/N 892 across a stack, where stars take a fifth of the places
beside it, had 0.005 for its width and texture. Lines of no more do not tell the optics (`look_alikes.LEAST_TELLING`)."""

GLARING_SNR: Final = 500.0
"""S/N from which a line's own glow is what the picture about it shows, and full pixels widen it, if nothing there comes near its
light:"""
GLARING_WINS: Final = 0.99
"""its wins and"""
GLARING_PEAK: Final = 0.8
"""its peak, at least. Then neither the picture nor its width speaks against it. In 371 frames 78 lines on 54 trails have all
three. So have 1,029 that are none, most of them stars: these have 0.18 at most by the other terms."""

CONSTANT: Final = -3.58
"""Weights of the logistic regression follow, to 7,985 lines (489 trails) in frames of 368 repositories, 151 of them with trails,
and to 467 lines (240 satellites) in 96 frames of six simulated skies. The trails of a repository count as four at most and its
other lines as 40, those of a sky as 24. This is the constant, with which the probabilities of lines that count once each are
right in the mean; one sigma over repositories drawn again is 0.8."""
PER_LOG_ODDS: Final = 0.78
"""Of the vetter's log odds; one sigma 0.1."""
PER_WINS: Final = 0.76
"""Of ln(pieces) (wins - 1/2); one sigma 0.4."""
PER_PEAK: Final = 3.63
"""Of the peak; one sigma 0.8."""
PER_LN_WIDTHS: Final = 1.91
"""Of ln(length / (`WIDTHS` widths)); one sigma 0.3."""
PER_LN_READOUT: Final = -4.43
"""Of ln(1 + odds of a line of the readout); one sigma 1.4."""
PER_LN_SHARPER: Final = 6.21
"""Of ln(width / that of the optics) where it is negative; one sigma 1.8."""
PER_LN_WIDER: Final = -1.43
"""Of the same where it is positive; one sigma 0.7."""
PER_LN_OTHERS: Final = -0.69
"""Of ln(other long lines about it / `FEW`) where it is positive; one sigma 0.2."""
PER_SURROUNDINGS: Final = (-1.69, 1.7, 1.5, -1.76, -2.63, 0.75, 5.44)
"""Of the numbers of the picture about it, in the order of `surroundings.NAMES`, above `USUAL`; one sigma 0.7, 0.8, 0.7,
1.3, 0.7, 0.15 and 1."""
PER_TERM: Final = (
    PER_LOG_ODDS, PER_WINS, PER_PEAK, PER_LN_WIDTHS, PER_LN_READOUT, PER_LN_SHARPER, PER_LN_WIDER, PER_LN_OTHERS,
    *PER_SURROUNDINGS,
)  # fmt: skip
"""In the order of `terms_of`."""


def contrasts_of(fits: Sequence[StreakFit], probability: NDArray[np.float64], tiles: Tiles) -> list[Contrast | None]:
    """Contrast of each fit of a frame that may be a trail, as far as a vetter (n,) and the tiles tell, or one of no class."""
    return [
        Contrast.of(fit, tiles) if p >= LEAST_PROBABILITY or fit.snr >= UNMODELLED_SNR else None
        for fit, p in zip(fits, probability.tolist(), strict=True)
    ]


def others_near(fits: Sequence[StreakFit], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Number (n,) of other long lines about each fit of a frame (rows, columns), those far from it counting less."""
    long = np.flatnonzero([fit.length_px >= LONG_PX for fit in fits])
    middles = np.array([(0.5 * (fits[k].row0 + fits[k].row1), 0.5 * (fits[k].col0 + fits[k].col1)) for k in long.tolist()])
    told = told_at_distance(fits, middles.reshape(-1, 2), shape)
    told[long, np.arange(long.size)] = 0.0
    return np.asarray(told.sum(axis=1))


def as_unmodelled(
    fits: Sequence[StreakFit], probability: NDArray[np.float64], contrasts: Sequence[Contrast | None]
) -> NDArray[np.float64]:
    """A vetter's probabilities (n,), raised for long bright lines that stand out all along, whatever their width and texture.

    Lines that run along rows or columns keep theirs: so do columns of the readout, which stand out as well.
    """
    clear = [
        contrast is not None
        and contrast.pieces >= UNMODELLED_PIECES
        and min(contrast.wins, contrast.peak) >= UNMODELLED_SHARE
        and fit.snr >= UNMODELLED_SNR
        and not is_aligned(fit.angle_deg)
        for fit, contrast in zip(fits, contrasts, strict=True)
    ]
    return np.where(clear, np.maximum(probability, UNMODELLED_PROBABILITY), probability)


def probability_in_any_camera(
    fits: Sequence[StreakFit],
    probability: NDArray[np.float64],
    sharpness: Sequence[float],
    contrasts: Sequence[Contrast | None],
    tracks: NDArray[np.float64],
    others: NDArray[np.float64],
    surroundings: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(n,) of the fits of a frame, given a vetter's own (n,).

    sharpness : ln of each fit's width over that of the optics, NaN where nothing tells the optics. contrasts : of the fits, None
        where they keep their probability; what was refused keeps its 0 whatever it has. tracks : odds (n,) of a particle's track
        for lines that are sharper than the optics; infinite for others. others : number (n,) of other long lines about each, see
        `others_near`. surroundings : numbers (n, 7) of the picture about each, see `surroundings.NAMES`; NaN where they are not
        known.
    """
    readout = np.log1p(odds_of_readout(fits))
    out = probability.astype(np.float64)
    for k, contrast in enumerate(contrasts):
        if contrast is not None and probability[k] > 0.0:
            own = math.log(probability[k] / max(1.0 - probability[k], 1e-9))
            widths = fits[k].length_px / effective_width_px(fits[k].width_px)
            told = sharpness[k] if math.isfinite(sharpness[k]) else 0.0
            given = [own, contrast.pieces, contrast.wins, contrast.peak, widths, readout[k]]
            pictures: list[ArrayLike] = [surroundings[k]]
            if _is_glaring(fits[k], contrast):
                # the picture counts where it speaks for the line
                told, pictures = min(told, 0.0), [*pictures, USUAL]
            as_told, as_light = (
                max(_probability(*given, sharper, others[k], picture) for picture in pictures)
                for sharper in (told, max(told, 0.0))
            )  # fmt: skip
            # a sharper line is the track of a particle, or light of optics that are sharper than was told
            out[k] = as_told + (as_light - as_told) / (1.0 + tracks[k])
    return out


def _is_glaring(fit: StreakFit, contrast: Contrast) -> bool:
    """Whether a line outshines all that is about it."""
    return fit.snr >= GLARING_SNR and contrast.wins >= GLARING_WINS and contrast.peak >= GLARING_PEAK


def _probability(*terms: ArrayLike) -> float:
    """Of a line with these terms; see `terms_of`."""
    return 1.0 / (1.0 + math.exp(-(CONSTANT + float(terms_of(*terms)[0] @ PER_TERM))))


def terms_of(
    own: ArrayLike, pieces: ArrayLike, wins: ArrayLike, peak: ArrayLike, widths: ArrayLike, ln_readout: ArrayLike,
    ln_sharpness: ArrayLike, others: ArrayLike, surroundings: ArrayLike,
) -> NDArray[np.float64]:  # fmt: skip
    """Terms (n, 15) of the log odds of lines, in the order of `PER_TERM`.

    own : log odds of the vetter. pieces, wins, peak : see `Contrast`. widths : length over width. ln_readout : of one plus the
    odds of a line of the readout. ln_sharpness : ln of the width over that of the optics, 0 where nothing tells these.
    others : number of other long lines about each. surroundings : (n, 7) of the picture about each.
    """
    picture = np.clip(np.asarray(surroundings, dtype=np.float64).reshape(-1, len(USUAL)), LOWEST, HIGHEST) - USUAL
    columns = (
        np.clip(own, -LARGEST, LARGEST), np.log(pieces) * (np.asarray(wins) - 0.5), peak,
        np.log(np.minimum(widths, LONGEST_WIDTHS) / WIDTHS), ln_readout, np.minimum(ln_sharpness, 0.0),
        np.maximum(ln_sharpness, 0.0), np.log(np.maximum(others, FEW) / FEW), *np.nan_to_num(picture).T,
    )  # fmt: skip
    return np.column_stack([np.atleast_1d(np.asarray(column, dtype=np.float64)) for column in columns])
