"""Directions of pixels of one frame: through a solved camera, or through a WCS that came with the frame."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ground.sky.apparent import apparent_directions, mid_frame_tai_ns, observer_at
from ground.sky.published import without_observer_aberration
from ground.sky.rotation import matrix_of, turn
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution

Array = NDArray[np.float64]


class PixelSky(Protocol):
    """Directions of the pixels of a frame. turn_rad_s : (3,) angular velocity of the camera, GCRS axes."""

    @property
    def turn_rad_s(self) -> Array:
        """A pixel's direction u moves by ``turn x u``."""
        ...

    def apparent(self, row: Array, col: Array, tai_ns: NDArray[np.int64]) -> Array:
        """Apparent unit vectors (n, 3), GCRS axes, of pixels at the given epochs."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedSky:
    """Directions through the solution of a frame; the attitude moves with the solution's rate."""

    header: FrameHeader
    solution: FrameSolution

    @cached_property
    def _matrix(self) -> Array:
        return matrix_of(np.asarray(self.solution.quaternion))

    @property
    def turn_rad_s(self) -> Array:
        """The solution's rate, GCRS axes."""
        return np.asarray(self.solution.rate_rad_s) @ self._matrix

    def apparent(self, row: Array, col: Array, tai_ns: NDArray[np.int64]) -> Array:
        """Apparent unit vectors (n, 3): a frame that turns by +angle sees directions turned by -angle."""
        seconds = (np.asarray(tai_ns) - mid_frame_tai_ns(self.header)) * 1e-9
        camera_frame = self.solution.camera.unproject(row, col)
        turned = np.outer(seconds, self.solution.rate_rad_s)
        return turn(camera_frame, turned) @ self._matrix


@dataclass(frozen=True, kw_only=True, eq=False)
class HeaderSky:
    """Directions through an astropy WCS (ICRS, catalogue-relative) that came with the frame.

    A WCS holds for the frame as a whole and does not describe motion inside it. All rows and both ends of a streak have one
    attitude. If the camera turns during the exposure, ends are off by half of the angle.
    """

    header: FrameHeader
    wcs: Any

    @property
    def turn_rad_s(self) -> Array:
        """Zero, because a WCS does not give the rate."""
        return np.zeros(3)

    def apparent(self, row: Array, col: Array, tai_ns: NDArray[np.int64]) -> Array:
        """Apparent unit vectors (n, 3): the catalogue-relative direction with aberration put back, as for a star."""
        ra, dec = self.wcs.all_pix2world(col, row, 0)
        middle = mid_frame_tai_ns(self.header)
        return apparent_directions(np.asarray(ra), np.asarray(dec), middle, *observer_at(self.header.observer, middle))


def sky_of(header: FrameHeader, solution: FrameSolution, wcs: Any) -> PixelSky | None:
    """Directions of a frame's pixels, if any are known. wcs : one that came with the frame, or None."""
    if wcs is not None:
        return HeaderSky(header=header, wcs=wcs)
    if solution.flags & FrameFlag.NO_SOLUTION:
        return None
    return SolvedSky(header=header, solution=solution)


def mid_frame_directions(solution: FrameSolution, row: Array, col: Array) -> Array:
    """Apparent unit vectors (n, 3), GCRS axes, of pixels, all at the epoch of the frame's attitude."""
    return np.asarray(solution.camera.unproject(row, col) @ matrix_of(np.asarray(solution.quaternion)))


def mid_frame_pixels(solution: FrameSolution, apparent: Array) -> tuple[Array, Array]:
    """Rows and cols (n,) of apparent directions (n, 3), GCRS axes, at the epoch of the frame's attitude; NaN where unseen."""
    return solution.camera.project(apparent @ matrix_of(np.asarray(solution.quaternion)).T)


def published_directions(sky: PixelSky, header: FrameHeader, row: Array, col: Array, tai_ns: NDArray[np.int64]) -> Array:
    """Published unit vectors (n, 3) of pixels: apparent, less the aberration of the observer's geocentric velocity."""
    apparent = sky.apparent(np.asarray(row, dtype=np.float64), np.asarray(col, dtype=np.float64), tai_ns)
    velocity = np.array([observer_at(header.observer, int(t))[1] for t in np.atleast_1d(tai_ns)])
    return without_observer_aberration(apparent, velocity)


def row_mid_exposure_tai_ns(header: FrameHeader, row: Array) -> NDArray[np.int64]:
    """Mid-exposure epochs of (fractional) rows."""
    delay = np.rint(header.line_time_ns * np.asarray(row, dtype=np.float64)).astype(np.int64)
    return header.t_start_tai_ns + delay + header.exposure_ns // 2
