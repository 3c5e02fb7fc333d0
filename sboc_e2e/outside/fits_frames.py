"""FITS files as frames: plain or tile-compressed, integer or float, any number of image HDUs, with or without headers.

One frame for each HDU that holds a 2-D image, in the order of file names. EXPTIME is in seconds, GAIN in e-/ADU,
RDNOISE in e-; each may be absent, as may the start of exposure (`header_times`).
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.frame import LARGEST_ADU, Frame, FrameHeader
from sboc_e2e.icd.tai import NS_PER_S
from sboc_e2e.outside.frame_source import Note, SourcedFrame
from sboc_e2e.outside.header_scale import focal_hints_px
from sboc_e2e.outside.header_times import FIRST_ASSUMED_TAI_NS, start_of
from sboc_e2e.outside.header_values import merged, missing, number_of, quietly, take_out_illegible
from sboc_e2e.outside.header_wcs import usable_wcs
from sboc_e2e.outside.image_circle import beyond, image_circle
from sboc_e2e.outside.image_planes import Plane, planes_of, with_planes
from sboc_e2e.outside.no_data import without_data
from sboc_e2e.outside.overscan import without_sky
from sboc_e2e.outside.pixel_unit import CameraUnits, in_unit, is_denied

if TYPE_CHECKING:
    from astropy.wcs import WCS

NO_FITS: Final = (
    ": it does not begin as one. Save the pixels of a picture in one colour as FITS first, in Python with "
    "fits.PrimaryHDU(pixels).writeto('frame.fits') of astropy.io"
)
"""What to do with a picture of another format, whose colours are not told apart here."""

SUFFIXES: Final = tuple(
    ending + packed for ending in (".fits", ".fit", ".fts") for packed in ("", ".fz", ".gz", ".bz2", ".xz", ".z")
)
"""How names of FITS files end, in small letters: what astropy reads, packed or not."""
MAX_SIDE_PX: Final = 16384  # Chosen: packets count rows and columns to 65,535, and `MAX_PIXELS` limits wide images first.
MIN_SIDE_PX: Final = 16  # Chosen, not measured: a smaller image has no room for a trail beside its sky.
MAX_PIXELS: Final = 200_000_000
"""The largest sensors have 151 million (14,208 x 10,656), of which `sboc process` takes 1.3 GB in its largest process. Chosen."""
CAMERA_KEYS: Final = (
    "TELESCOP", "INSTRUME", "DETECTOR", "CAMERA", "CCDNAME", "CCDCHIP", "EXTNAME", "AMPNAME", "FILTER", "CCDSUM", "XBINNING",
    "READMODE",
)  # fmt: skip
"""Keys of headers whose values tell cameras, their detectors, filters and modes apart."""
GAINS_E_ADU: Final = (1e-3, 1e4)
"""Gains that are believed."""
OTHER_GAIN: Final = "that of --camera is taken, or a guess from the noise"


@dataclass(frozen=True, kw_only=True)
class Place:
    """An image: file, HDU, rows and columns, and the mask or weight planes of its file."""

    path: Path
    hdu: int
    rows: int
    cols: int
    planes: tuple[Plane, ...] = ()


@dataclass(frozen=True, kw_only=True)
class FitsFolder:
    """A folder (or one file) of FITS images as a `FrameSource`.

    use_wcs : hand on the WCS of headers. max_pixels : larger images are refused before they are read.
    """

    path: Path
    use_wcs: bool = True
    max_pixels: int = MAX_PIXELS
    _unread: dict[tuple[Path, int], str] = field(default_factory=dict, init=False, repr=False, compare=False)
    _opened: "dict[Place, Content]" = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def places(self) -> tuple[Place, ...]:
        """All images. Raises `UserError` for a missing or empty folder, and where no file holds an image that can be read."""
        if self.path.is_file():
            files = [self.path]
        elif self.path.is_dir():
            files = sorted(p for p in self.path.iterdir() if p.is_file() and p.name.lower().endswith(SUFFIXES))
        else:
            raise UserError(f"{self.path}: no such folder of FITS files")
        if not files:
            raise UserError(
                f"{self.path}: holds no FITS file; names end in .fits, .fit or .fts, and packed ones in .fz, .gz, .bz2, .xz or .Z"
            )
        found: list[Place] = []
        refused: list[UserError] = []
        without: list[str] = []
        for path in files:
            images, odd = _survey(path, self.max_pixels)
            found += images
            refused += odd
            if not images and not odd:
                without.append(f"{path}: holds no two-dimensional image")
        self._unread.update({(self.path, -1 - k): text for k, text in enumerate([*map(str, refused), *without])})
        if not found:
            raise refused[0] if refused else UserError(f"{self.path}: no file holds a two-dimensional image")
        return tuple(found)

    @property
    def n_frames(self) -> int:
        """Number of images."""
        return len(self.places)

    @property
    def left_out(self) -> tuple[str, ...]:
        """What could not be read, as far as the frames have been gone through."""
        return tuple(self._unread.values())

    def open_first(self) -> None:
        """Open the first image now, so that a thread may go through `frames`: warnings cannot be silenced in one."""
        with suppress(UserError):  # which comes again when the frame is read
            self._opened[self.places[0]] = _content(self.places[0])

    def frames(self) -> Iterator[SourcedFrame]:
        """Frames in order; times that do not rise are left as the headers have them.

        Images that cannot be read are left out. Raises `UserError` when none can.
        """
        number, first = 0, None
        units = CameraUnits()
        for place in self.places:
            try:
                sourced = read_frame(place, number, use_wcs=self.use_wcs, content=self._opened.pop(place, None), units=units)
            except UserError as error:
                first = first or error
                self._unread[place.path, place.hdu] = str(error)
                continue
            yield sourced
            number += 1
        if number == 0 and first is not None:
            raise first


def images_of(path: Path, max_pixels: int = MAX_PIXELS) -> list[Place]:
    """The 2-D images of a file that are pictures of the sky. Raises `UserError` when all that it holds is refused."""
    places, refused = _survey(path, max_pixels)
    if refused and not places:
        raise refused[0]
    return places


def _survey(path: Path, max_pixels: int) -> tuple[list[Place], list[UserError]]:
    """Pictures of a file, and what is refused of it. Only images that may be flags are read beyond their header."""
    places, refused, planes = [], [], []
    try:
        with quietly(), fits.open(path, memmap=False, lazy_load_hdus=False) as hdus:
            for index, hdu in enumerate(hdus):
                take_out_illegible(hdu.header)
                shape = _shape(hdu)
                if shape is None:
                    if cube := _cube(hdu):
                        sides = " x ".join(map(str, cube))
                        refused.append(
                            UserError(
                                f"{path}, HDU {index}: holds a cube of {sides}; save each of its planes as an image of two axes"
                            )
                        )
                    continue
                rows, cols = shape
                small, large = min(rows, cols) < MIN_SIDE_PX, max(rows, cols) > MAX_SIDE_PX or rows * cols > max_pixels
                if small or large:
                    text = (
                        f"{path}, HDU {index}: image of {rows} x {cols}; allowed are sides of {MIN_SIDE_PX} to {MAX_SIDE_PX} px "
                        f"and {max_pixels} pixels in all"
                    )
                    refused.append(UserError(text))
                    continue
                places.append(Place(path=path, hdu=index, rows=rows, cols=cols))
            planes = planes_of(hdus, [place.hdu for place in places])
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - damaged files make astropy and its decompressors raise nearly everything
        why = NO_FITS if "No SIMPLE card" in str(error) else f" ({_first_line(error)})"
        return [], [*refused, UserError(f"{path}: not a readable FITS file{why}")]
    pictures = [place for place in places if place.hdu not in {plane.hdu for plane in planes}]
    if places and not pictures:
        refused.append(UserError(f"{path}: holds no picture, only {', '.join(sorted({plane.words for plane in planes}))}"))
    return [replace(each, planes=tuple(p for p in planes if p.image == each.hdu)) for each in pictures], refused


@dataclass(frozen=True, kw_only=True, eq=False)
class Content:
    """What the file of an image holds of it: values of its headers, pixels, WCS, doubts of that, pixels masked by planes.

    hints_px : see `focal_hints_px`.
    """

    header: Mapping[str, Any]
    data: NDArray[Any] | None
    wcs: "WCS | None"
    doubt: Note | None
    blind: NDArray[np.bool_] | None
    notes: list[Note]
    hints_px: tuple[float, ...]


def _content(place: Place) -> Content:
    """Open an image. Raises `UserError` when it cannot be read."""
    try:
        with quietly(), fits.open(place.path, memmap=False) as hdus:
            hdu = hdus[place.hdu]
            illegible = [keyword for source in (hdus[0].header, hdu.header) for keyword in take_out_illegible(source)]
            header = merged(hdus, hdu)
            data = hdu.data
            wcs, doubt = usable_wcs(hdu.header, place.rows, place.cols)
            blind, notes = with_planes(hdus, place.planes, (place.rows, place.cols))
            if illegible:
                notes = [
                    *notes,
                    Note(kind="header", text=f"header cards left out, whose values cannot be read: {', '.join(illegible)}"),
                ]
    except MemoryError:
        raise
    except Exception as error:  # as above
        raise UserError(f"{place.path}, HDU {place.hdu}: cannot be read ({_first_line(error)})") from error
    hints_px = focal_hints_px(header, wcs)
    return Content(header=header, data=data, wcs=wcs, doubt=doubt, blind=blind, notes=notes, hints_px=hints_px)


def wcs_of(place: Place) -> "WCS | None":
    """The WCS of an image, as `read_frame` gives it."""
    with quietly(), fits.open(place.path, memmap=False) as hdus:
        header = hdus[place.hdu].header
        take_out_illegible(header)
        return usable_wcs(header, place.rows, place.cols)[0]


def read_frame(
    place: Place,
    number: int,
    *,
    use_wcs: bool = True,
    content: Content | None = None,
    units: CameraUnits | None = None,
) -> SourcedFrame:
    """One image as a frame. Raises `UserError` when its data cannot be read.

    content : where it was opened before. units : of cameras by the frames before this one.
    """
    content = content or _content(place)
    header, data, wcs, doubt, blind = content.header, content.data, content.wcs, content.doubt, content.blind
    notes = list(content.notes)
    if data is None or np.shape(data) != (place.rows, place.cols) or data.dtype.kind not in "uif":
        raise UserError(f"{place.path}, HDU {place.hdu}: holds no image of {place.rows} x {place.cols} numbers")
    pixels, saturation = pixels_of(data)
    camera = " ".join(f"{header.get(key, '')}".strip() for key in CAMERA_KEYS) + f" HDU {place.hdu}"
    unit = (units or CameraUnits()).of_next(camera, pixels)
    if unit > 1.0:
        pixels = in_unit(pixels, unit)
        notes.append(Note(kind="unit", text=f"pixels multiplied by {unit:.0e}: noise of this camera is below a thousandth"))
    empty = without_data(pixels)
    if empty is not None:
        pixels = _without(pixels, empty)
        share = f"{100.0 * float(empty.mean()):.2g} % of the frame"
        notes.append(Note(kind="no data", text=f"masked areas that hold one value, such as gaps between chips: {share}"))
    sky = without_sky(pixels)
    if sky is not None:
        blind = np.zeros(pixels.shape, dtype=np.bool_) if blind is None else blind
        covered = np.ones(pixels.shape, dtype=np.bool_)
        covered[sky] = False
        blind |= covered
        notes.append(Note(kind="no sky", text=f"masked borders without sky, such as overscan: {_borders(sky, pixels.shape)}"))
    circle = image_circle(pixels)
    if circle is not None:
        outside = beyond(circle, pixels.shape)
        blind = outside if blind is None else blind | outside
        where = f"radius {circle.radius_px:.0f} px about row {circle.row:.0f}, column {circle.col:.0f}"
        notes.append(Note(kind="circle", text=f"masked what lies beyond the image circle of the lens and at its rim: {where}"))
    if blind is not None and blind.any():
        pixels = _without(pixels, blind)
    notes += [doubt] if doubt and use_wcs else []
    frame_header = _frame_header(header, number, pixels, saturation, unit, notes)
    return SourcedFrame(
        frame=Frame(header=frame_header, pixels=pixels),
        file=place.path.name,
        hdu=place.hdu,
        wcs=wcs if use_wcs else None,
        notes=tuple(notes),
        focal_hints_px=content.hints_px,
        camera=camera,
        circle=circle,
        unit=unit,
        timed=start_of(header).timed,
    )


def _without(pixels: NDArray[Any], masked: NDArray[np.bool_]) -> NDArray[np.float32]:
    """The pixels with NaN where they are masked."""
    return np.where(masked, np.float32(np.nan), pixels.astype(np.float32))


def _borders(sky: tuple[slice, slice], shape: tuple[int, ...]) -> str:
    """Covered rows and columns in words."""
    ranges = [
        f"{axis} {first} to {last - 1}"
        for axis, side, n in zip(("rows", "columns"), sky, shape, strict=True)
        for first, last in ((0, side.start), (side.stop, n))
        if last > first
    ]
    return ", ".join(ranges)


def pixels_of(data: NDArray[Any]) -> tuple[NDArray[np.uint16] | NDArray[np.float32], float | None]:
    """Pixels as the contract has them, and the value at which they saturate by their type (None: unknown).

    Integers that fit are uint16; all else is float32, with NaN where there is no number.
    """
    if data.dtype.kind in "ui":
        low, high = int(data.min()), int(data.max())
        if low >= 0 and high <= 65535:
            top = {1: 255.0, 2: 32767.0 if data.dtype.kind == "i" else 65535.0}.get(data.dtype.itemsize, 65535.0)
            return np.ascontiguousarray(data, dtype=np.uint16), top
        return np.ascontiguousarray(data, dtype=np.float32), None
    with np.errstate(over="ignore", invalid="ignore"):
        pixels = np.ascontiguousarray(data, dtype=np.float32)
    unusable = ~np.isfinite(pixels)
    if unusable.any():
        pixels = pixels.copy()
        pixels[unusable] = np.nan
    return pixels, None


def _frame_header(
    header: Mapping[str, Any], number: int, pixels: NDArray[Any], saturation: float | None, unit: float, notes: list[Note]
) -> FrameHeader:
    """unit : what the file's numbers were multiplied by."""

    def known(names: tuple[str, ...], low: float, high: float, without: str, *, quiet: bool = False) -> float | None:
        value = number_of(header, names, low, high)
        if value is None and (not quiet or any(header.get(name) is not None for name in names)):
            notes.append(missing(header, names, f"is no number from {low:g} to {high:g}", without))
        return value

    start = start_of(header)
    notes += start.notes
    exposure_s = known(
        ("EXPTIME", "EXPOSURE", "EXP_TIME"), 0.0, 9e6, "no magnitudes, and the middle of the exposure is its start"
    )
    # amateurs' programs write e-/ADU as EGAIN, and the camera's setting as GAIN
    gain = number_of(header, ("EGAIN",), *GAINS_E_ADU) or known(("GAIN", "EGAIN"), *GAINS_E_ADU, OTHER_GAIN)
    if gain is not None and is_denied(gain / unit, pixels):
        notes.append(Note(kind="GAIN denied", text=f"GAIN = {gain:g} e-/ADU leaves pixels too little noise: {OTHER_GAIN}"))
        gain = None
    read_noise = known(("RDNOISE", "READNOIS", "RON"), 0.0, 1e5, "it is ignored", quiet=True)
    full = known(("SATURATE", "SATLEVEL"), 1.0, 1e9, "it is ignored", quiet=True)
    try:
        return FrameHeader(
            frame=number,
            t_start_tai_ns=FIRST_ASSUMED_TAI_NS + number * NS_PER_S if start.tai_ns is None else start.tai_ns,
            exposure_ns=round((exposure_s or 0.0) * NS_PER_S),
            line_time_ns=0,
            rows=pixels.shape[0],
            cols=pixels.shape[1],
            gain_e_adu=gain and gain / unit,
            read_noise_e=read_noise,
            saturation_adu=full * unit if full and full * unit <= LARGEST_ADU else saturation,
            temperature_k=None,
        )
    except ContractError as error:
        raise UserError(f"frame {number}: {error}") from error


def _shape(hdu: Any) -> tuple[int, int] | None:
    """Rows and columns of an HDU with a 2-D image, None for everything else."""
    if not isinstance(hdu, fits.PrimaryHDU | fits.ImageHDU | fits.CompImageHDU):
        return None
    shape = hdu.shape
    return (int(shape[0]), int(shape[1])) if len(shape) == 2 and all(shape) else None


def _cube(hdu: Any) -> tuple[int, ...]:
    """Sides of an HDU with an image of more than two axes; of none for everything else."""
    is_image = isinstance(hdu, fits.PrimaryHDU | fits.ImageHDU | fits.CompImageHDU)
    return tuple(map(int, hdu.shape)) if is_image and len(hdu.shape) > 2 and all(hdu.shape) else ()


def _first_line(error: BaseException) -> str:
    text = str(error).splitlines()
    return f"{type(error).__name__}: {text[0][:160]}" if text else type(error).__name__
