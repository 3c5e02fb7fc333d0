"""Frames and what is known about them when they leave the camera."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import ContractError

LARGEST_ADU: Final = 1e15
"""Largest value of a float frame. Squares of values up to here fit into a 32-bit float."""
GAINS_E_ADU: Final = (1e-6, 1e6)
"""Least and largest gain of a frame or a camera, e-/ADU."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObserverState:
    """Position and velocity of the camera, GCRS axes, origin at the geocentre (GPS, as telemetered)."""

    tai_ns: int
    position_m: NDArray[np.float64]
    velocity_m_s: NDArray[np.float64]
    sigma_position_m: float
    sigma_velocity_m_s: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", validate.finite_array("observer.position_m", self.position_m, (3,)))
        object.__setattr__(self, "velocity_m_s", validate.finite_array("observer.velocity_m_s", self.velocity_m_s, (3,)))
        validate.within("observer.sigma_position_m", self.sigma_position_m, 0.0, 1e9)
        validate.within("observer.sigma_velocity_m_s", self.sigma_velocity_m_s, 0.0, 1e6)


@dataclass(frozen=True, kw_only=True, eq=False)
class AttitudeEstimate:
    """Attitude at mid-exposure of the middle row, as telemetered.

    quaternion : (4,) scalar last, rotates apparent GCRS directions into the camera frame.
    rate_rad_s : (3,) angular velocity of the camera frame, expressed in the camera frame; zero if not measured.
    covariance_rad2 : (3, 3) of the small rotation vector in the camera frame.
    """

    quaternion: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]
    covariance_rad2: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "quaternion", validate.unit_quaternion("attitude.quaternion", self.quaternion))
        object.__setattr__(self, "rate_rad_s", validate.finite_array("attitude.rate_rad_s", self.rate_rad_s, (3,)))
        object.__setattr__(
            self, "covariance_rad2", validate.finite_array("attitude.covariance_rad2", self.covariance_rad2, (3, 3))
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameHeader:
    """What travels with the pixels. Unknown values are None.

    t_start_tai_ns : start of exposure of delivered row 0 as the on-board clock reads it.
    exposure_ns : exposure of each row.
    line_time_ns : row r starts at ``t_start + r * line_time``; signed by readout direction; 0 = global shutter.
    bin_rows, bin_cols : detector pixels per delivered pixel; window_row0, window_col0: detector pixel of (0, 0).
    gain_e_adu, read_noise_e : of a delivered pixel.
    """

    frame: int
    t_start_tai_ns: int
    exposure_ns: int
    line_time_ns: int
    rows: int
    cols: int
    bin_rows: int = 1
    bin_cols: int = 1
    window_row0: int = 0
    window_col0: int = 0
    gain_e_adu: float | None = None
    read_noise_e: float | None = None
    saturation_adu: float | None = None
    attitude: AttitudeEstimate | None = None
    observer: ObserverState | None = None
    temperature_k: float | None = None

    def __post_init__(self) -> None:
        validate.within("header.frame", self.frame, 0, 2**32 - 1)
        validate.within("header.t_start_tai_ns", self.t_start_tai_ns, 0, 2**62)
        validate.within("header.exposure_ns", self.exposure_ns, 0, 2**53)
        validate.within("header.line_time_ns", self.line_time_ns, -(2**31) + 1, 2**31 - 1)
        for name in ("rows", "cols"):
            validate.within(f"header.{name}", getattr(self, name), 1, 16384)
        for name in ("bin_rows", "bin_cols"):
            validate.within(f"header.{name}", getattr(self, name), 1, 255)
        for name in ("window_row0", "window_col0"):
            validate.within(f"header.{name}", getattr(self, name), 0, 65535)
        if self.gain_e_adu is not None:
            validate.within("header.gain_e_adu", self.gain_e_adu, *GAINS_E_ADU)
        if self.read_noise_e is not None:
            validate.within("header.read_noise_e", self.read_noise_e, 0.0, 1e6)
        if self.saturation_adu is not None:
            validate.within("header.saturation_adu", self.saturation_adu, 0.0, LARGEST_ADU)

    def corner_in(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Row and column of this frame's first pixel in calibration maps of a shape (delivered pixels).

        Maps of the frame's own shape were made for its window; larger ones cover the whole detector. Raises `ContractError`
        for a window that leaves them, or that does not begin on a border of their binned pixels.
        """
        if shape == (self.rows, self.cols):
            return 0, 0
        (row, rest_row), (col, rest_col) = divmod(self.window_row0, self.bin_rows), divmod(self.window_col0, self.bin_cols)
        if rest_row or rest_col:
            raise ContractError(
                f"frame {self.frame}: expected a window that begins on a border of the calibration's pixels of {self.bin_rows} x "
                f"{self.bin_cols}, got detector pixel ({self.window_row0}, {self.window_col0})"
            )
        if row + self.rows > shape[0] or col + self.cols > shape[1]:
            raise ContractError(
                f"frame {self.frame}: expected a window inside the calibration's {shape[0]} x {shape[1]} px, "
                f"got {self.rows} x {self.cols} at ({row}, {col})"
            )
        return row, col


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """A frame as the camera delivers it: uint16 ADU, or float32 ADU where NaN means masked. Shape (rows, cols)."""

    header: FrameHeader
    pixels: NDArray[np.uint16] | NDArray[np.float32]

    def __post_init__(self) -> None:
        got = getattr(self.pixels, "dtype", type(self.pixels).__name__)
        if got not in (np.dtype(np.uint16), np.dtype(np.float32)):
            raise ContractError(f"frame.pixels: expected uint16 or float32, got {got}")
        shape = (self.header.rows, self.header.cols)
        object.__setattr__(self, "pixels", validate.array("frame.pixels", self.pixels, self.pixels.dtype, shape))


@dataclass(frozen=True, kw_only=True, eq=False)
class NominalCamera:
    """The camera as ground and on-board software believe it to be (the as-built one differs).

    Projection, in words (each segment writes its own code): an apparent direction (x, y, z) in the camera frame
    gives u = x/z, v = y/z; r2 = u^2 + v^2; Brown-Conrady distortion
    ``u' = u (1 + k1 r2 + k2 r2^2) + 2 p1 u v + p2 (r2 + 2 u^2)``,
    ``v' = v (1 + k1 r2 + k2 r2^2) + p1 (r2 + 2 v^2) + 2 p2 u v``;
    ``col = center_col + focal_px u'``, ``row = center_row + focal_px v'``.
    Photometry, in words: a star gives ``zero_point_e_s * 10**(-0.4 (V + colour_term (B-V - 0.653)))`` e-/s on axis,
    times the flat; 0.653 is the Sun's B-V. `zero_point_e_s` is None where it is unknown; `psf_known` is
    False where `psf_sigma_px` is a guess. Values are of delivered (binned) pixels.
    """

    name: str
    rows: int
    cols: int
    focal_px: float
    center_row: float
    center_col: float
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    psf_sigma_px: float
    psf_known: bool = True
    gain_e_adu: float
    read_noise_e: float
    saturation_adu: float
    full_well_e: float
    zero_point_e_s: float | None
    colour_term: float = 0.0
    aperture_m: float
    obstruction: float = 0.0

    def __post_init__(self) -> None:
        validate.within("camera.focal_px", self.focal_px, 1.0, 1e9)
        validate.within("camera.psf_sigma_px", self.psf_sigma_px, 0.05, 1e3)
        validate.within("camera.gain_e_adu", self.gain_e_adu, *GAINS_E_ADU)
        if self.zero_point_e_s is not None:
            validate.within("camera.zero_point_e_s", self.zero_point_e_s, 1e-6, 1e30)


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """What on-board and ground software may know of the camera; reduced from calibration frames with their own noise.

    The maps are of delivered pixels and cover what the frames cover, or the whole detector (`FrameHeader.corner_in`).
    dark_adu : (rows, cols) float32, pedestal and dark signal of one exposure.
    flat : (rows, cols) float32, relative response, 1 on axis.
    defects : (rows, cols) uint8 of `flags.MaskBit`.
    """

    camera: NominalCamera
    dark_adu: NDArray[np.float32]
    flat: NDArray[np.float32]
    defects: NDArray[np.uint8]
    provenance: str = field(default="")

    def __post_init__(self) -> None:
        shape = (self.camera.rows, self.camera.cols)
        object.__setattr__(self, "dark_adu", validate.array("calibration.dark_adu", self.dark_adu, np.float32, shape))
        object.__setattr__(self, "flat", validate.array("calibration.flat", self.flat, np.float32, shape))
        object.__setattr__(self, "defects", validate.array("calibration.defects", self.defects, np.uint8, shape))
