"""Records of what the on-board software finds in a frame: background, stars, detections, strips of pixels."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.work import WorkMeter


@dataclass(frozen=True, kw_only=True, eq=False)
class BackgroundModel:
    """Sky level and noise on a mesh of square tiles; node (i, j) is the centre of tile (i, j).

    level_adu, sigma_adu : (mesh_rows, mesh_cols) float32; ADU above the dark, and noise of one pixel.
    Tile (i, j) covers rows ``i*tile_px ... (i+1)*tile_px - 1``; the last tile of a row may be shorter.
    """

    tile_px: int
    level_adu: NDArray[np.float32]
    sigma_adu: NDArray[np.float32]

    def __post_init__(self) -> None:
        validate.within("background.tile_px", self.tile_px, 1, 16384)
        object.__setattr__(self, "level_adu", validate.array("background.level_adu", self.level_adu, np.float32, (None, None)))
        shape = self.level_adu.shape
        object.__setattr__(self, "sigma_adu", validate.array("background.sigma_adu", self.sigma_adu, np.float32, shape))


@dataclass(frozen=True, kw_only=True)
class StarMotion:
    """Rigid motion of the stars during the exposure, px: a shift at the middle of the frame and a turn about it.

    A star at (row, col) moves by (drow - turn_rad (col - middle_col), dcol + turn_rad (row - middle_row)); the sign of the
    whole is not known and of no consequence.
    """

    drow: float
    dcol: float
    turn_rad: float
    middle_row: float
    middle_col: float

    def at(self, row: NDArray[np.float64], col: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vectors (n,), (n,) of stars at places (n,)."""
        return self.drow - self.turn_rad * (col - self.middle_col), self.dcol + self.turn_rad * (row - self.middle_row)


@dataclass(frozen=True, kw_only=True, eq=False)
class StarList:
    """Stars by falling flux. Columns of equal length n; an empty list has n = 0.

    row, col : float64 px, centroid. flux_e : float32, PSF-weighted flux in one exposure (by an assumed gain where
    none is known, then the frame is flagged). snr : float32, matched-filter. flags : uint8 of `StarFlag`.
    psf_sigma_px : width of the PSF in the middle of the frame as these stars show it, without the pixel; None when not measured.
    motion : of the stars when they are trails, with their places at mid-exposure; entries without `StarFlag.TRAILED` are then
    points that follow the camera. None when stars are points. It stays on board.
    """

    row: NDArray[np.float64]
    col: NDArray[np.float64]
    flux_e: NDArray[np.float32]
    snr: NDArray[np.float32]
    flags: NDArray[np.uint8]
    psf_sigma_px: float | None = None
    motion: StarMotion | None = None

    def __post_init__(self) -> None:
        for name, dtype in (("row", "f8"), ("col", "f8"), ("flux_e", "f4"), ("snr", "f4"), ("flags", "u1")):
            object.__setattr__(self, name, validate.array(f"stars.{name}", getattr(self, name), dtype, (None,)))
        if self.psf_sigma_px is not None:
            validate.within("stars.psf_sigma_px", self.psf_sigma_px, 0.0, 1e3)
        validate.same_length("stars", row=self.row, col=self.col, flux_e=self.flux_e, snr=self.snr, flags=self.flags)

    def __len__(self) -> int:
        return len(self.row)

    @classmethod
    def empty(cls) -> "StarList":
        """A list without stars."""
        none, none32 = np.zeros(0), np.zeros(0, dtype=np.float32)
        return cls(row=none, col=none, flux_e=none32, snr=none32, flags=np.zeros(0, dtype=np.uint8))


@dataclass(frozen=True, kw_only=True)
class Detection:
    """A straight or slightly curved segment, from end 0 to end 1 (PSF-centre positions), in pixels.

    snr : matched-filter S/N (sigma; noise without the object). sagitta_px : signed height of the arc over the chord
    at its middle, positive towards the normal (row, col) = (dcol, -drow) of the chord (drow, dcol); 0 when straight.
    Point-like detections have both ends equal or nearly so, and `StreakFlag.POINT_LIKE`.
    """

    row0: float
    col0: float
    row1: float
    col1: float
    snr: float
    sagitta_px: float = 0.0
    flags: StreakFlag = StreakFlag(0)  # noqa: RUF009 - an enumeration member, immutable

    def __post_init__(self) -> None:
        for name in ("row0", "col0", "row1", "col1", "snr", "sagitta_px"):
            validate.finite(f"detection.{name}", getattr(self, name))

    @property
    def length_px(self) -> float:
        """Distance of the ends."""
        return float(np.hypot(self.row1 - self.row0, self.col1 - self.col0))


@dataclass(frozen=True, kw_only=True, eq=False)
class DetectorView:
    """Everything a detector or star extractor may look at.

    residual_adu : (rows, cols) float32, dark and background level removed; masked pixels hold 0.
    background : mesh of level and of the noise sigma per pixel.
    mask : (rows, cols) uint8 of `MaskBit`; 0 = usable. stars : star list of this frame (empty for the extractor).
    psf_sigma_px : nominal. history : views of earlier frames, or last of the next one, at most as many as the step declares; or
    what its `remembered` made of them (`sboc_e2e.icd.steps.SelectiveMemory`). work : what the steps may still do for this frame;
    they spend from it.
    """

    header: FrameHeader
    residual_adu: NDArray[np.float32]
    background: BackgroundModel
    mask: NDArray[np.uint8]
    stars: StarList
    psf_sigma_px: float
    history: tuple[Any, ...] = ()
    work: WorkMeter = field(default_factory=WorkMeter)

    def __post_init__(self) -> None:
        shape = (self.header.rows, self.header.cols)
        object.__setattr__(self, "residual_adu", validate.array("view.residual_adu", self.residual_adu, np.float32, shape))
        object.__setattr__(self, "mask", validate.array("view.mask", self.mask, np.uint8, shape))


UNKNOWN: Final = -128
"""Code of an unknown pixel in `Searched.smooth`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Searched:
    """Results of a detector's search of a frame for a tracker.

    smooth : (rows, cols) int8, the image without its stars after the PSF's matched filter, 16 for one sigma; `UNKNOWN` where
    pixels are masked or stars bright. seeds : (n, 5) float64 row0, col0, row1, col1 (px) and S/N of segments too faint to be
    detections, and of those that are. removed : (m, 2) uint16 row, col of the stars whose light was subtracted; what other frames
    took out and this one did not is left in it.
    """

    smooth: NDArray[np.int8]
    seeds: NDArray[np.float64]
    removed: NDArray[np.uint16] = field(default_factory=lambda: np.zeros((0, 2), np.uint16))

    def __post_init__(self) -> None:
        object.__setattr__(self, "smooth", validate.array("searched.smooth", self.smooth, np.int8, (None, None)))
        object.__setattr__(self, "seeds", validate.array("searched.seeds", self.seeds, np.float64, (None, 5)))
        object.__setattr__(self, "removed", validate.array("searched.removed", self.removed, np.uint16, (None, 2)))

    @classmethod
    def empty(cls, shape: tuple[int, ...]) -> "Searched":
        """Nothing known, nothing found."""
        return cls(smooth=np.full(shape, UNKNOWN, np.int8), seeds=np.zeros((0, 5)))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackerView:
    """Everything a tracker may look at of a frame.

    view : as the detector saw it. detections : what it found. searched : what its search left, None where it leaves nothing.
    transform : (2, 3) map of (row, col) of the frame before into this one, from their stars; None where nothing may be linked
    across: at the first frame, after a gap, a repeated frame, a slew or a change of exposure. focal_px : nominal focal length in
    pixels of the frame; None where it is not known.
    """

    view: DetectorView
    detections: tuple[Detection, ...]
    searched: Searched | None
    transform: NDArray[np.float64] | None
    focal_px: float | None = None


@dataclass(frozen=True, kw_only=True)
class TrackMember:
    """A track in one of its frames. detection : its ends by growing time, its own S/N in that frame."""

    frame: int
    detection: Detection


@dataclass(frozen=True, kw_only=True)
class Track:
    """One object over several frames.

    number : of the object in the run; a track that is found again keeps it. snr : joint matched-filter S/N of the members.
    members : in the order of frames, one each, two or more, none before the window.
    """

    number: int
    snr: float
    members: tuple[TrackMember, ...]

    def __post_init__(self) -> None:
        validate.within("track.number", self.number, 0, 2**31 - 1)
        validate.finite("track.snr", self.snr)
        frames = [member.frame for member in self.members]
        if len(frames) < 2 or frames != sorted(set(frames)):
            raise ContractError(f"track.members: expected two or more frames in rising order, got {frames[:20]}")


FIXED_POINT = 1 << 16
"""Strips give minor-axis positions in units of 1/65536 px."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Strip:
    """A sheared rectangle of pixels that follows a piece of a streak; the unit that one ROI packet carries.

    axis : 0 when the strip runs along rows (the major axis is row), 1 along cols.
    Line i (0 <= i < n) lies at major coordinate ``major0 + i`` and covers minor coordinates
    ``m(i) ... m(i) + width - 1`` with ``m(i) = (minor0_fp + i * slope_fp) >> 16`` (arithmetic shift; may be negative).
    values_adu : (n, width) raw minus rounded dark, int32; float32 where a lossy codec gave halves of ADU. Pixels outside
    the frame hold `level_adu` and are ignored.
    """

    axis: int
    major0: int
    minor0_fp: int
    slope_fp: int
    level_adu: int
    values_adu: NDArray[np.int32] | NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.axis not in (0, 1):
            raise ContractError(f"strip.axis: expected 0 or 1, got {self.axis}")
        validate.within("strip.slope_fp", self.slope_fp, -FIXED_POINT, FIXED_POINT)
        dtype = np.float32 if np.asarray(self.values_adu).dtype.kind == "f" else np.int32
        object.__setattr__(self, "values_adu", validate.array("strip.values_adu", self.values_adu, dtype, (None, None)))

    def pixel_coordinates(self, rows: int, cols: int) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
        """Row and col of each value, and whether it lies inside a frame of the given size; each (n, width)."""
        row, col = strip_pixels(self.axis, self.major0, self.minor0_fp, self.slope_fp, self.values_adu.shape)
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        return row, col, inside


def strip_pixels(
    axis: int, major0: int, minor0_fp: int, slope_fp: int, shape: tuple[int, int]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Rows and cols, each (n, width), of a strip: the contract's one definition of where its values lie."""
    n, width = shape
    line = np.arange(n, dtype=np.int64)
    minor = ((minor0_fp + line * slope_fp) >> 16)[:, None] + np.arange(width)
    major = np.broadcast_to((major0 + line)[:, None], minor.shape)
    row, col = (major, minor) if axis == 0 else (minor, major)
    return row.astype(np.int32), col.astype(np.int32)


@dataclass(frozen=True, kw_only=True, eq=False)
class RoiGroup:
    """One detected object of one frame: the detection and the strips that hold its pixels."""

    roi_id: int
    detection: Detection
    strips: tuple[Strip, ...]
    n_strips: int
    """How many strips were sent; fewer in `strips` means that packets are missing."""
    track: int = -1
    """Number of the track over several frames that it is a member of; -1: of none."""
    track_snr: float = 0.0
    """Joint S/N of that track."""
