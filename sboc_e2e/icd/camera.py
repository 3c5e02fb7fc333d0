"""The camera of a frame solution: pixels to directions and back, for any camera model.

The camera holds the geometry only. Attitude, its rate and its covariance stay in `FrameSolution`, so that one rule moves
every model's directions to the epochs of rows, and the covariance has one meaning.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CameraParameter:
    """One number of a camera model, which becomes a column of the published table of frames.

    name : of the column, in small letters, digits and underscores. unit : of astropy; None for numbers without one.
    """

    name: str
    value: float | bool
    unit: str | None = None
    description: str = ""


@runtime_checkable
class CameraModel(Protocol):
    """Directions in the camera frame (+Z boresight, +X to growing col, +Y to growing row) of pixels, and back.

    Pure functions of their arguments. An object is a frozen dataclass of plain values, arrays and such dataclasses, so that it
    can be kept between stages and travel to other processes. Rows and cols are 0-based positions in delivered pixels, the
    centre of pixel (0, 0) is (0.0, 0.0); positions up to a tenth of the frame outside it are asked for too. The directions are
    apparent ones (all aberration in) turned into the camera frame, without the motion of the camera while rows are read.
    """

    def unproject(self, row: Array, col: Array) -> Array:
        """Unit vectors (n, 3) of pixels, row and col (n,) float64."""
        ...

    def project(self, vectors: Array) -> tuple[Array, Array]:
        """Rows and cols (n,) of vectors (n, 3) of any length; NaN where the camera cannot see or the model cannot place a vector.

        The inverse of `unproject` to 1e-3 px inside the frame.
        """
        ...

    def parameters(self) -> tuple[CameraParameter, ...]:
        """The model's numbers for the published table; the same names in all frames of a run."""
        ...
