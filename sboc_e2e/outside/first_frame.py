"""The first frame from outside: read once, beside the loading of libraries; its stars measured in a process beside this one.

Where no camera is given, the width of the stars is wanted before anything else is done.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from sboc_e2e.outside import second_processor
from sboc_e2e.outside.border_slopes import WithoutSlopes
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.fixed_pattern import MutuallyCalibrated
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.outside.star_width import star_sigma_px


@dataclass(kw_only=True)
class FirstFrame:
    """A calibrated source whose first frame is being read.

    is_beside : it is so large that work beside it is worth its start. _read : waits for the frame.
    """

    source: FrameSource
    is_beside: bool
    _others: Iterator[SourcedFrame]
    _read: Callable[[], SourcedFrame]

    @classmethod
    def of(cls, source: FrameSource) -> "FirstFrame":
        """Of a source as it comes. Raises `UserError` where it holds no frame, as `frame` does where none can be read.

        One large frame alone is read in a thread. Of several others are looked at too, by which they are calibrated.
        """
        calibrated = WithoutSlopes(source=MutuallyCalibrated(source=source))
        frames = calibrated.frames()
        if not isinstance(source, FitsFolder):
            return cls(source=calibrated, is_beside=False, _others=frames, _read=partial(next, frames))
        is_beside = second_processor.is_worth(source.places[0].rows * source.places[0].cols)
        if is_beside and source.n_frames == 1:
            source.open_first()
            pool = ThreadPoolExecutor(max_workers=1)
            read = pool.submit(next, frames).result
            pool.shutdown(wait=False)
        else:
            read = partial(next, frames)
        return cls(source=calibrated, is_beside=is_beside, _others=frames, _read=read)

    def wait(self) -> None:
        """Wait for the frame. Raises `UserError` where it cannot be read."""
        _ = self.frame

    @cached_property
    def frame(self) -> SourcedFrame:
        """The frame, once it is read. Raises `UserError` where it cannot be."""
        return self._read()

    def star_sigma_px(self) -> Callable[[], float | None]:
        """Begin to measure the width of the stars; what waits for it. It gives None where they do not tell it."""
        pixels = np.asarray(self.frame.frame.pixels, dtype=np.float32)
        return (second_processor.forked if self.is_beside else partial)(star_sigma_px, pixels)

    def frames(self) -> Iterator[SourcedFrame]:
        """All frames, once; this one forgets its own."""
        first, others = self.frame, self._others
        del self.frame, self._read, self._others
        yield first
        del first
        yield from others
