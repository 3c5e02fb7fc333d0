"""ROI strips to calibrated electrons: dark rest, background mesh and pixel response removed, stars subtracted."""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ground.photometry.background import background_at, gain_e_adu
from ground.photometry.known_stars import FrameLight, KnownStars
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.frame import Calibration, FrameHeader
from sboc_e2e.icd.products import StreakPixels
from sboc_e2e.icd.signals import Detection, RoiGroup

Array = NDArray[np.float64]

UNUSABLE: Final = int(MaskBit.DEAD | MaskBit.HOT | MaskBit.MISSING)
STAR_REACH_SIGMAS: Final = 5.0
"""Radius of a star's image in PSF sigmas, a pixel added: beyond, a Gaussian has 4e-6 of its peak."""
FAINTEST_STAR_SIGMAS: Final = 0.2
"""Stars whose peak is below this many background sigmas are left in."""


def streak_pixels(
    group: RoiGroup, frame: DownlinkFrame, calibration: Calibration, light: FrameLight, *, star_model_error: float
) -> tuple[StreakPixels, bool]:
    """Pixels of a ROI group, ready for the fit, and whether a known star lies under the trail.

    The flat is applied relative to its mean over the group, so that the fitted flux is what fell on the detector.
    """
    header, found = frame.header, group.detection
    psf_sigma_px = light.psf.sigma_px(0.5 * (found.row0 + found.row1), 0.5 * (found.col0 + found.col1), found.length_px)
    row, col, count = _unique_pixels(group, header)
    value_adu = count * frame.adu_scale + frame.adu_offset
    gain = gain_e_adu(header)
    flat = calibration.flat[row, col].astype(np.float64)
    good_flat = flat > 0.05
    relative = np.where(good_flat, flat / max(float(flat[good_flat].mean()) if good_flat.any() else 1.0, 0.05), 1.0)
    dark = calibration.dark_adu[row, col].astype(np.float64)
    level, sigma = background_at(frame, row, col)
    # Integer frames were sent minus the rounded dark, and the mesh was measured on the same differences. Float frames were sent
    # minus the whole dark.
    dark_rest = dark - np.rint(dark) if frame.adu_scale == 1.0 else 0.0
    measured = value_adu - dark_rest - level
    value_e = measured * gain / relative
    variance = np.maximum(sigma * gain / relative, 1e-3) ** 2

    saturation = header.saturation_adu if header.saturation_adu is not None else calibration.camera.saturation_adu
    saturated = value_adu + dark >= 0.98 * saturation
    bad = ((calibration.defects[row, col] & UNUSABLE) > 0) | ~good_flat | saturated
    if frame.adu_scale != 1.0:
        bad |= _without_numbers(row, col, count)
    star_e, star_variance, crossed = _star_light(
        row, col, light.stars, found, psf_sigma_px, float(np.median(sigma)) * gain if len(sigma) else 1.0
    )
    value_e = value_e - star_e
    variance = variance + star_e + (star_model_error * star_e) ** 2 + star_variance
    variance[bad] = np.inf
    pixels = StreakPixels(
        row=row.astype(np.int32),
        col=col.astype(np.int32),
        value_e=value_e.astype(np.float32),
        variance_e2=variance.astype(np.float32),
        psf_sigma_px=psf_sigma_px,
        frame_shape=(header.rows, header.cols),
    )
    return pixels, crossed


def _unique_pixels(group: RoiGroup, header: FrameHeader) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """Rows, cols and transmitted values of all strips inside the frame; a pixel of two strips counts once."""
    flat_index, values = [], []
    for strip in group.strips:
        row, col, inside = strip.pixel_coordinates(header.rows, header.cols)
        flat_index.append((row.astype(np.int64) * header.cols + col)[inside])
        values.append(strip.values_adu[inside])
    if not flat_index:
        none = np.zeros(0, dtype=np.intp)
        return none, none, np.zeros(0)
    where, first = np.unique(np.concatenate(flat_index), return_index=True)
    return where // header.cols, where % header.cols, np.concatenate(values)[first].astype(np.float64)


def _without_numbers(row: NDArray[np.intp], col: NDArray[np.intp], count: Array) -> NDArray[np.bool_]:
    """(n,) pixels of a float frame that held no number: neighbours in a row, by rising place, that all have the count 0.

    On board they become 0, the level of the frame. Noise of 20 counts (`onboard.image.calibrate.FLOAT_QUANTUM_SIGMA`) makes three
    zeros side by side in one of 120,000 places, and a mask makes nothing else.
    """
    zero = count == 0.0
    beside = (np.diff(col) == 1) & (np.diff(row) == 0) & zero[1:] & zero[:-1]
    three = beside[1:] & beside[:-1]
    out = np.zeros(len(row), dtype=np.bool_)
    for shift in range(3):
        out[shift : shift + len(three)] |= three
    return out


def _star_light(
    row: NDArray[np.intp], col: NDArray[np.intp], stars: KnownStars, detection: Detection, psf_sigma_px: float, sigma_e: float
) -> tuple[Array, Array, bool]:
    """Electrons of known stars in each pixel (Gaussian PSF integrated over pixels), and whether one lies under the trail.

    Second, the variance (e-^2) that errors of flux and place leave: with a place known to sigma / SNR in each coordinate,
    (light / SNR)^2 (1 + r^2 / sigma^2) at the distance r from a Gaussian of width sigma.
    """
    light, variance = np.zeros(len(row)), np.zeros(len(row))
    if len(row) == 0 or len(stars.row) == 0:
        return light, variance, False
    reach = STAR_REACH_SIGMAS * psf_sigma_px + 1.0
    peak = stars.flux_e / (2.0 * np.pi * psf_sigma_px**2 + 1.0)
    across, beyond = distance_to_segment(detection, stars.row, stars.col)
    on_trail = (across < 2.0 * psf_sigma_px + 1.0) & (beyond < 2.0 * psf_sigma_px)
    # a star of this frame's list on the trail, unknown otherwise, may be a piece of the trail itself
    near = (
        (stars.row > row.min() - reach) & (stars.row < row.max() + reach) & (stars.col > col.min() - reach)
        & (stars.col < col.max() + reach) & (peak > FAINTEST_STAR_SIGMAS * sigma_e) & (stars.unspoilt | ~on_trail)
    )  # fmt: skip
    root2 = np.sqrt(2.0) * psf_sigma_px
    for k in np.flatnonzero(near):
        d_row, d_col = row - stars.row[k], col - stars.col[k]
        touched = np.flatnonzero((np.abs(d_row) < reach) & (np.abs(d_col) < reach))
        by_row = erf((d_row[touched] + 0.5) / root2) - erf((d_row[touched] - 0.5) / root2)
        by_col = erf((d_col[touched] + 0.5) / root2) - erf((d_col[touched] - 0.5) / root2)
        own = 0.25 * stars.flux_e[k] * by_row * by_col
        r2 = (d_row[touched] ** 2 + d_col[touched] ** 2) / psf_sigma_px**2
        light[touched] += own
        variance[touched] += (stars.inverse_snr[k] * own) ** 2 * (1.0 + r2)
    crossed = near & (across < 3.0 * psf_sigma_px + 1.0) & (beyond < 3.0 * psf_sigma_px) & (peak > 3.0 * sigma_e)
    return light, variance, bool(crossed.any())


def distance_to_segment(detection: Detection, row: Array, col: Array) -> tuple[Array, Array]:
    """Distance across the chord, and beyond its nearer end (0 alongside it), px."""
    d_row, d_col = detection.row1 - detection.row0, detection.col1 - detection.col0
    length = float(np.hypot(d_row, d_col))
    if length < 1e-6:
        return np.zeros(len(row)), np.hypot(row - detection.row0, col - detection.col0)
    along = ((row - detection.row0) * d_row + (col - detection.col0) * d_col) / length
    across = np.abs((row - detection.row0) * d_col - (col - detection.col0) * d_row) / length
    return across, np.maximum(np.maximum(-along, along - length), 0.0)
