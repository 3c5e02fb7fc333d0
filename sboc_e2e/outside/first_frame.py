"""The first frame from outside: read once, its stars measured in a process beside this one.

Where no camera is given, the width of the stars is wanted before anything else is done. In a frame of 4096 x 4096 that takes as
long as loading the libraries does, and neither needs the other.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from sboc_e2e.outside import beside
from sboc_e2e.outside.border_slopes import WithoutSlopes
from sboc_e2e.outside.fixed_pattern import MutuallyCalibrated
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.outside.star_width import star_sigma_px


@dataclass(kw_only=True)
class FirstFrame:
    """A calibrated source, its first frame and what gives the width of the frame's stars (None where they do not tell it).

    is_beside : the stars are being measured in a process beside this one.
    """

    source: FrameSource
    frame: SourcedFrame
    star_sigma_px: Callable[[], float | None]
    is_beside: bool
    others: Iterator[SourcedFrame]

    @classmethod
    def of(cls, source: FrameSource, *, measured: bool) -> "FirstFrame":
        """Of a source as it comes. measured : the width of the stars will be asked for. Raises `UserError` without frames."""
        source = WithoutSlopes(source=MutuallyCalibrated(source=source))
        frames = source.frames()
        first = next(frames)
        pixels = np.asarray(first.frame.pixels, dtype=np.float32)
        is_beside = measured and beside.is_worth(pixels.size)
        begin = beside.forked if is_beside else partial
        return cls(source=source, frame=first, star_sigma_px=begin(star_sigma_px, pixels), is_beside=is_beside, others=frames)

    def frames(self) -> Iterator[SourcedFrame]:
        """All frames, once; this one forgets its own."""
        first, others = self.frame, self.others
        del self.frame, self.star_sigma_px, self.others
        yield first
        del first
        yield from others
