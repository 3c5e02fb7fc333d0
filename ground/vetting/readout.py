"""Lines of the readout: columns, borders of amplifiers and steps of the overscan stay on one row or column of the frame."""

from typing import Final

READOUT_WIDTHS: Final = 2.5
"""Largest extent across, in widths (or px), of a line on one row or column: a Gaussian has 1 % of its light farther out. Chosen,
not measured."""

READOUT_SPAN: Final = 0.7
"""Least share of the frame along it. Both together take in one of 500 lines of any direction and place in frames of 4,096 px,
and one of eight in cut-outs of 100 px (docs/real-frames.md). Chosen, not measured."""


def is_of_readout(drow: float, dcol: float, width_px: float, shape: tuple[int, int]) -> bool:
    """Whether a line from one end to the other (px) stays on one row or column over most of a frame.

    width_px : sigma of the line's profile, that of the PSF where it was not measured. shape : rows and columns of the frame.
    """
    along, side = max((abs(drow), shape[0]), (abs(dcol), shape[1]), key=lambda pair: pair[0])
    return min(abs(drow), abs(dcol)) < READOUT_WIDTHS * max(width_px, 1.0) and along > READOUT_SPAN * side
