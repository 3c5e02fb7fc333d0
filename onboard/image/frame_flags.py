"""Flags of a frame: gaps in its header, its place in the run, its pixels."""

import zlib

import numpy as np
from numpy.typing import NDArray

from onboard.image.calibrate import Counts
from sboc_e2e.icd.flags import FrameFlag, MaskBit
from sboc_e2e.icd.frame import FrameHeader

CHECKED_ROWS = 64
"""Rows of a frame that go into the checksum which recognises a repeated frame."""


def checksum(pixels: NDArray[np.uint16] | NDArray[np.float32]) -> int:
    """Checksum of some rows, enough to recognise the same frame again."""
    return zlib.crc32(np.ascontiguousarray(pixels[:: max(1, pixels.shape[0] // CHECKED_ROWS)]).data)


def header_flags(header: FrameHeader) -> FrameFlag:
    """Flags of unknown values in the header."""
    missing = (
        (header.gain_e_adu, FrameFlag.GAIN_ASSUMED),
        (header.read_noise_e, FrameFlag.READ_NOISE_ASSUMED),
        (header.attitude, FrameFlag.NO_ATTITUDE),
        (header.observer, FrameFlag.NO_OBSERVER),
    )
    flags = FrameFlag(0)
    for value, flag in missing:
        flags |= flag if value is None else FrameFlag(0)
    return flags


def sequence_flags(header: FrameHeader, check: int, previous: FrameHeader | None, previous_check: int | None) -> FrameFlag:
    """Flags of a frame's place in the run. check, previous_check : `checksum` of this frame and of the last one."""
    flags = FrameFlag(0)
    if previous is None:
        return flags
    if header.t_start_tai_ns < previous.t_start_tai_ns + previous.exposure_ns:
        flags |= FrameFlag.TIME_BACKWARDS
    if check == previous_check or header.frame == previous.frame:
        flags |= FrameFlag.REPEATED_FRAME
    return flags


def content_flags(mask: NDArray[np.uint8], counts: Counts, n_masked: int) -> FrameFlag:
    """Flags of a frame's pixels."""
    flags, size = FrameFlag(0), mask.size
    if n_masked > 0.9 * size:
        flags |= FrameFlag.ALL_MASKED
    if n_masked > 0.5 * size and np.count_nonzero(mask & MaskBit.SATURATED) > 0.5 * size:
        flags |= FrameFlag.SATURATED
    first = counts.pixels[0, 0]
    if (counts.pixels[0] == first).all() and (counts.pixels == first).all():
        flags |= FrameFlag.EMPTY_SIGNAL
    return flags


def continues(last: FrameHeader | None, header: FrameHeader) -> bool:
    """Whether a frame continues the sequence of the last one: next number, later start, same exposure and readout."""
    return (
        last is not None
        and header.frame == last.frame + 1
        and header.t_start_tai_ns > last.t_start_tai_ns
        and (header.exposure_ns, header.line_time_ns) == (last.exposure_ns, last.line_time_ns)
        and (header.rows, header.cols, header.bin_rows, header.bin_cols) == (last.rows, last.cols, last.bin_rows, last.bin_cols)
        and (header.window_row0, header.window_col0) == (last.window_row0, last.window_col0)
    )
