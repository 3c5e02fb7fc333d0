"""What a tracker keeps of a frame's search, and how the frames of a window lie on each other in place and time."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.image import registration
from onboard.track.packed import halved
from sboc_e2e.icd.frame import FrameHeader

NO_SEEDS: Final = np.zeros((0, 5), np.float32)  # `KeptSearch.seeds` when they have been followed
NONE_WAIT: Final = np.zeros((0, 6))  # `KeptSearch.waiting` without seeds
NO_TRAILS: Final = np.zeros((0, 4))  # `KeptSearch.trails` of a frame that shows none
NONE_REMOVED: Final = np.zeros((0, 2), np.uint16)  # `KeptSearch.removed` of a frame without stars


@dataclass(frozen=True, kw_only=True, eq=False)
class KeptSearch:
    """What stays of a frame. transform : (2, 3) of the frame before into it; unused for the first.

    image : `Searched.smooth` in half a byte a pixel. seeds : to 2e-4 px, for memory. halves : the image at half resolution, and
    that transposed, while the frame is next to one whose seeds are being followed. waiting (n, 6) : seeds that fell short, and
    their senses of motion. trails (n, 4) : row0, col0, row1, col1 of the frame's own detections. removed : as
    `Searched.removed`, by growing row; without what lies before the window.
    """

    header: FrameHeader
    image: NDArray[np.uint64]
    seeds: NDArray[np.float32]
    transform: NDArray[np.float64]
    waiting: NDArray[np.float64] = field(default_factory=lambda: NONE_WAIT)
    halves: tuple[NDArray[np.uint64], NDArray[np.uint64]] | None = None
    trails: NDArray[np.float64] = field(default_factory=lambda: NO_TRAILS)
    removed: NDArray[np.uint16] = field(default_factory=lambda: NONE_REMOVED)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame."""
        return self.header.rows, self.header.cols

    def with_halves(self) -> "KeptSearch":
        """The same with its halves."""
        return self if self.halves is not None else replace(self, halves=halved(self.image))


def from_centre(window: tuple[KeptSearch, ...], centre: int) -> NDArray[np.float64]:
    """Transforms (n, 2, 3) of (row, col) of the centre frame into each frame of the window."""
    out = np.empty((len(window), 2, 3))
    out[centre] = registration.IDENTITY
    for k in range(centre + 1, len(window)):
        out[k] = joined(out[k - 1], window[k].transform)
    for k in range(centre - 1, -1, -1):
        out[k] = joined(out[k + 1], registration.inverse(window[k + 1].transform))
    return out


def joined(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """The (2, 3) transform that does one after the other."""
    return np.column_stack([second[:, :2] @ first[:, :2], second[:, :2] @ first[:, 2] + second[:, 2]])


def exposures_from(window: tuple[KeptSearch, ...], centre: int, transforms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Start of each frame's exposure after that of the centre frame, in exposures, on the row that a star has moved to."""
    own = window[centre].header
    middle = np.array([[0.5 * own.rows, 0.5 * own.cols]])
    out = np.empty(len(window))
    for k, frame in enumerate(window):
        shift = float(registration.apply(transforms[k], middle)[0, 0] - middle[0, 0])
        out[k] = (frame.header.t_start_tai_ns - own.t_start_tai_ns + own.line_time_ns * shift) / max(own.exposure_ns, 1)
    return out
