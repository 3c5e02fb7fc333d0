"""Pixels that came down, as FITS files with a world coordinate system: whole frames, thumbnails, regions of interest.

One file for each frame. The primary header says when, how and from where the frame was taken; each image is an extension.
Pixels are ADU above the rounded dark, as transmitted, the flat not applied; integers are compressed without loss.
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from ground.astrometry.wcs_export import PixelIcrs, of_binned, of_cut_out, sip_header, without_inverse
from ground.products.epochs import utc_mjd, utc_text
from ground.sky.apparent import mid_frame_tai_ns
from ground.streak_rows import STREAKS_PER_FRAME
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import RoiGroup, Strip

NONE, ALL = "none", "all"
"""Choices of `ProductOptions.images` beside "frames"."""

DIRECTIONS: Final = (
    "The WCS gives the places of stars (ICRS, all aberration removed). Published directions of streaks keep annual aberration "
    "and differ from it by up to 21 arcsec."
)
BLANK: Final = -(2**31)
"""Value of pixels that were not sent, FITS keyword BLANK: the least int32, which no camera counts."""
LARGEST_BOX_PX: Final = 512 * 512
"""A region in a larger box is written strip by strip: of the box of a trail from corner to corner next to nothing was sent."""


def has_images(frame: DownlinkFrame, wanted: str) -> bool:
    """Whether a frame has pixels to write. wanted : `ProductOptions.images`."""
    if wanted == ALL and (frame.thumbnail_adu is not None or frame.rois):
        return True
    return wanted != NONE and frame.whole_frame is not None


def frame_images(frame: DownlinkFrame, icrs: PixelIcrs | None, wanted: str) -> fits.HDUList:
    """The file of a frame.

    icrs : directions of the frame's pixels, None where they are unknown: then there is no WCS. wanted : `ProductOptions.images`.
    """
    header = frame.header
    wcs = fits.Header() if icrs is None else sip_header(icrs, header.rows, header.cols)
    known = icrs is not None
    made: list[Any] = []
    if frame.whole_frame is not None:
        made.append(_image(frame.whole_frame, frame, wcs, "FRAME"))
        made[-1].header.extend(_cards(header))
    if wanted == ALL and frame.thumbnail_adu is not None:
        cell_px = -(-header.cols // frame.thumbnail_adu.shape[1])
        made.append(fits.ImageHDU(np.asarray(frame.thumbnail_adu), of_binned(wcs, cell_px) if known else None, name="THUMBNAIL"))
        made[-1].header["BUNIT"] = ("adu", "mean of a cell, above the dark")
    if wanted == ALL:
        made += _regions(frame, wcs, known)
    primary = fits.PrimaryHDU()
    primary.header.extend(_cards(header))
    if known:
        primary.header["COMMENT"] = DIRECTIONS
    return fits.HDUList([primary, *made])


def _regions(frame: DownlinkFrame, wcs: fits.Header, known: bool) -> Iterator[Any]:
    """An extension for each region, or for each strip of a region in a large box."""
    number, wcs = 0, without_inverse(wcs)
    for place, group in enumerate(frame.rois):
        for strips in _boxes(group, frame.header):
            row, col, value = _pixels(strips, frame.header)
            if len(row) == 0:
                continue
            row0, col0 = int(row.min()), int(col.min())
            shape = (int(row.max()) - row0 + 1, int(col.max()) - col0 + 1)
            whole = value.dtype == np.int32
            box = np.full(shape, BLANK if whole else np.nan, dtype=value.dtype)
            box[row - row0, col - col0] = value
            number += 1
            image = _image(box, frame, of_cut_out(wcs, row0, col0) if known else wcs, "ROI", tile=shape)
            if whole and frame.adu_scale == 1.0:
                image.header["BLANK"] = (BLANK, "not sent")
            image.header["EXTVER"] = number
            image.header["ROIID"] = (group.roi_id, "region of interest")
            image.header["STREAKID"] = (frame.header.frame * STREAKS_PER_FRAME + place, "streak_id in streaks.ecsv")
            image.header["NSTRIPS"] = (group.n_strips, "strips that were sent of the region")
            image.header["NARRIVED"] = (len(group.strips), "strips that arrived")
            image.header["ROW0"] = (row0, "frame's row of the first one, 0-based")
            image.header["COL0"] = (col0, "frame's column of the first one, 0-based")
            yield image


def _boxes(group: RoiGroup, header: FrameHeader) -> Sequence[Sequence[Strip]]:
    """The strips that share an extension."""
    row, col, _ = _pixels(group.strips, header)
    small = len(row) > 0 and int(np.ptp(row) + 1) * int(np.ptp(col) + 1) <= LARGEST_BOX_PX
    return [group.strips] if small else [(strip,) for strip in group.strips]


def _pixels(strips: Sequence[Strip], header: FrameHeader) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[Any]]:
    """Rows, cols and transmitted values of strips inside the frame; of a pixel in two strips the first one's comes last."""
    none = np.zeros(0, dtype=np.int32)
    parts = []
    for strip in reversed(strips):
        row, col, inside = strip.pixel_coordinates(header.rows, header.cols)
        parts.append((row[inside], col[inside], strip.values_adu[inside]))
    row, col, value = (np.concatenate(columns) for columns in zip(*parts, strict=True)) if parts else (none, none, none)
    return row, col, value


def _image(values: NDArray[Any], frame: DownlinkFrame, wcs: fits.Header, name: str, tile: tuple[int, int] | None = None) -> Any:
    """An image extension: integers compressed, in tiles of this shape or row by row; anything else as float32."""
    if values.dtype == np.int32 and frame.adu_scale == 1.0:
        image: Any = fits.CompImageHDU(np.asarray(values), wcs, name=name, compression_type="RICE_1", tile_shape=tile)
    else:
        unsent = values == BLANK if values.dtype == np.int32 else np.isnan(values)
        adu = np.where(unsent, np.nan, values * frame.adu_scale + frame.adu_offset).astype(np.float32)
        image = fits.ImageHDU(adu, wcs, name=name)
    image.header["BUNIT"] = ("adu", "above the rounded dark, as transmitted")
    return image


def _cards(header: FrameHeader) -> list[tuple[str, Any, str]]:
    """When, how and from where a frame was taken."""
    start_ns, middle_ns = header.t_start_tai_ns, mid_frame_tai_ns(header)
    cards: list[tuple[str, Any, str]] = [
        ("FRAMENO", header.frame, "frame number"),
        ("TIMESYS", "UTC", "scale of the dates"),
        ("DATE-OBS", utc_text([start_ns])[0], "start of exposure of row 0"),
        ("MJD-OBS", utc_mjd(start_ns), "[d] DATE-OBS"),
        ("DATE-AVG", utc_text([middle_ns])[0], "of the middle row's middle: WCS epoch"),
        ("MJD-AVG", utc_mjd(middle_ns), "[d] DATE-AVG"),
        ("EXPTIME", header.exposure_ns * 1e-9, "[s] exposure of each row"),
        ("LINETIME", header.line_time_ns * 1e-9, "[s] row r starts r times this later"),
        ("XBINNING", header.bin_cols, "detector columns per column"),
        ("YBINNING", header.bin_rows, "detector rows per row"),
        ("WINCOL0", header.window_col0, "detector column of the first column, 0-based"),
        ("WINROW0", header.window_row0, "detector row of the first row, 0-based"),
    ]
    for key, value, text in (
        ("GAIN", header.gain_e_adu, "[e-/ADU]"),
        ("RDNOISE", header.read_noise_e, "[e-]"),
        ("SATURATE", header.saturation_adu, "[ADU] with the dark"),
        ("CCD-TEMP", header.temperature_k, "[K]"),
    ):
        if value is not None:
            cards.append((key, value, text))
    if header.observer is not None:
        state = header.observer
        cards.append(("OBSEPOCH", utc_text([state.tai_ns])[0], "epoch of the observer's state"))
        for axis, metres, rate in zip("XYZ", state.position_m.tolist(), state.velocity_m_s.tolist(), strict=True):
            cards.append((f"GCRS_{axis}", metres, "[m] observer, GCRS"))
            cards.append((f"GCRS_V{axis}", rate, "[m/s] observer, GCRS"))
    return cards
