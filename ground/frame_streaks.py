"""The streaks of one frame: regions -> calibrated pixels -> fits -> measurements with directions and magnitudes."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np

from ground.guard import guarded
from ground.photometry.known_stars import FrameLight, frame_light
from ground.photometry.magnitude import magnitude_at_1deg_s, streak_magnitude
from ground.photometry.streak_pixels import streak_pixels
from ground.photometry.zero_point import flat_at
from ground.records import FrameProducts
from ground.sky.measure import initial_epochs_ns, middle_of, with_sky
from ground.sky.pixel_sky import PixelSky
from ground.streak_rows import STREAKS_PER_FRAME
from ground.streaks.fit_record import failed_fit
from ground.streaks.forced import FORCED_SNR, forced_fit
from ground.streaks.no_trail import NoTrailError
from ground.streaks.psf_field import PsfField
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader
from sboc_e2e.icd.products import FrameSolution, PhotometricSolution, StreakFit, StreakMeasurement, StreakPixels
from sboc_e2e.icd.signals import RoiGroup
from sboc_e2e.icd.steps import StreakFitter

LEAST_SNR_ALONE: Final = 6.0
"""Noise alone has 46 maxima above it in a frame of 4096 x 4096, 0.1 above 7 (Euler characteristic of the S/N over all segments,
Adler & Taylor 2007): what was detected above 7 and fits below 6 is left to frames that support each other."""

KEPT_FROM_BOARD: Final = (
    StreakFlag.STATIC
    | StreakFlag.SPIKE_LIKE
    | StreakFlag.ROI_CUT
    | StreakFlag.LOSSY
    | StreakFlag.COSMIC_LIKE
    | StreakFlag.SATURATED
)
"""Flags of the on-board detection that ground cannot derive."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LitFrame:
    """A frame and everything that its pixels are calibrated with. star_model_error : relative error of the PSF of subtracted
    stars."""

    frame: DownlinkFrame
    solution: FrameSolution
    photometry: PhotometricSolution
    psf: PsfField
    calibration: Calibration
    catalogue: StarCatalogue
    star_model_error: float

    @cached_property
    def _light(self) -> FrameLight:
        return frame_light(self.frame, self.solution, self.photometry, self.calibration, self.catalogue, self.psf)

    def pixels(self, group: RoiGroup) -> tuple[StreakPixels, bool]:
        """Pixels of a region in electrons, stars subtracted, and whether a known star lies under the trail."""
        return streak_pixels(group, self.frame, self.calibration, self._light, star_model_error=self.star_model_error)

    def pixels_of(self, streak: StreakMeasurement) -> StreakPixels:
        """Pixels of a measured streak of this frame."""
        return self.pixels(self.frame.rois[number_of(streak)])[0]


def number_of(streak: StreakMeasurement) -> int:
    """Number of a streak in its frame."""
    return streak.streak_id - streak.frame * STREAKS_PER_FRAME


def fitted(lit: LitFrame, fitter: StreakFitter) -> tuple[list[StreakFit], list[float]]:
    """Fit of each region, with the flags from pixels and packets; and the mean flat under each."""
    header = lit.frame.header
    gain_assumed = StreakFlag.GAIN_ASSUMED if FrameFlag.GAIN_ASSUMED in lit.frame.flags else StreakFlag(0)
    fits, flats = [], []
    for group in lit.frame.rois:
        where = f"frame {header.frame}, region {group.roi_id}"
        pixels, crossed = lit.pixels(group)
        fit = _forced(pixels, group) or guarded("streak_fitter", fitter, where, StreakFit, fitter.fit, pixels, group.detection)
        flags = fit.flags | group.detection.flags & KEPT_FROM_BOARD | gain_assumed
        if crossed:
            flags |= StreakFlag.CROSSES_STAR
        if len(group.strips) < group.n_strips:
            flags |= StreakFlag.PIXELS_MISSING
        fits.append(replace(fit, flags=flags, psf_sigma_px=pixels.psf_sigma_px))
        flats.append(_mean_flat(lit.calibration, fit))
    return fits, flats


def _forced(pixels: StreakPixels, group: RoiGroup) -> StreakFit | None:
    """The fit of a track's member that its own frame hardly shows; None of other regions."""
    if group.track < 0 or group.detection.snr >= FORCED_SNR:
        return None
    try:
        return forced_fit(pixels, group.detection, group.track_snr)
    except NoTrailError as error:
        return failed_fit(group.detection, pixels, error.reason)


def measured(
    number: int, fit: StreakFit, probability: float, lit: LitFrame, sky: PixelSky | None, mean_flat: float, veto_below: float
) -> StreakMeasurement:
    """A streak as measured before linking."""
    header = lit.frame.header
    row_mid, col_mid = middle_of(fit)
    unknown = np.full(3, np.nan)
    track = lit.frame.rois[number].track
    # The on-board tracker judged a member of a track together with other frames. Unless linking confirms it, it is judged alone.
    veto = StreakFlag.VETOED if probability < veto_below and track < 0 else StreakFlag(0)
    streak = StreakMeasurement(
        frame=header.frame,
        streak_id=header.frame * STREAKS_PER_FRAME + number,
        roi_id=lit.frame.rois[number].roi_id,
        fit=fit,
        row_mid=row_mid,
        col_mid=col_mid,
        ra_deg=unknown,
        dec_deg=unknown,
        t_tai_ns=initial_epochs_ns(fit, row_mid, header),
        sigma_along_arcsec=float("nan"),
        sigma_cross_arcsec=float("nan"),
        mag=float("nan"),
        mag_err=float("nan"),
        probability=probability,
        tracklet_id=-1,
        flags=fit.flags | veto,
        track=track,
        track_snr=lit.frame.rois[number].track_snr,
    )
    on_sky = with_sky(streak, header, sky, lit.solution.covariance_rad2)
    return _with_brightness(on_sky, header, lit.photometry, mean_flat, None)


def judged_alone(streak: StreakMeasurement, veto_below: float) -> StreakMeasurement:
    """A streak that no other frame supports. It is published only with a higher probability of its own."""
    alone_enough = streak.probability >= veto_below and streak.fit.snr >= LEAST_SNR_ALONE
    veto = StreakFlag(0) if alone_enough else StreakFlag.VETOED
    return replace(streak, tracklet_id=-1, flags=streak.flags | StreakFlag.SINGLE_FRAME | veto)


def with_final_brightness(streak: StreakMeasurement, product: FrameProducts, crossing_s: float | None) -> StreakMeasurement:
    """A streak with a magnitude for the time that it was exposed. crossing_s : time in the frame where its edge cut it."""
    return _with_brightness(streak, product.header, product.photometry, product.mean_flat[number_of(streak)], crossing_s)


def _with_brightness(
    streak: StreakMeasurement, header: FrameHeader, photometry: PhotometricSolution, mean_flat: float, crossing_s: float | None
) -> StreakMeasurement:
    """The streak with its magnitude, NaN and NO_MAGNITUDE where there is none."""
    mag, mag_err = streak_magnitude(streak, header, photometry, mean_flat, crossing_s)
    flags = streak.flags & ~StreakFlag.NO_MAGNITUDE
    if not np.isfinite(mag):
        flags |= StreakFlag.NO_MAGNITUDE
    at_rate, at_rate_err = magnitude_at_1deg_s(streak, header, photometry, mean_flat)
    return replace(streak, mag=mag, mag_err=mag_err, mag_at_1deg_s=at_rate, mag_at_1deg_s_err=at_rate_err, flags=flags)


def _mean_flat(calibration: Calibration, fit: StreakFit) -> float:
    """Mean response along the trail, relative to the axis."""
    share = np.linspace(0.02, 0.98, 25)
    row, col = fit.row0 + share * (fit.row1 - fit.row0), fit.col0 + share * (fit.col1 - fit.col0)
    return float(np.mean(flat_at(calibration, row, col)))
