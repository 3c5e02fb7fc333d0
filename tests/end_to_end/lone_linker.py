"""A linker that makes a tracklet of each bright streak by itself, as a telescope with one long exposure does."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

LEAST_SNR = 12.0
LEAST_LENGTH_PX = 15.0
UNUSABLE = StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.POINT_LIKE | StreakFlag.FIT_FAILED | StreakFlag.VETOED


@dataclass(frozen=True, kw_only=True)
class LoneLinker:
    """Tracklets of one streak each. The order of the ends in time counts as known for every second one."""

    def link(self, headers: Sequence[FrameHeader], streaks: Sequence[StreakMeasurement]) -> tuple[Tracklet, ...]:
        start = {header.frame: header for header in headers}
        alone = [
            s for s in streaks
            if not s.flags & UNUSABLE and s.fit.snr > LEAST_SNR and s.fit.length_px > LEAST_LENGTH_PX
        ]  # fmt: skip
        return tuple(self._tracklet(number, streak, start[streak.frame]) for number, streak in enumerate(alone))

    def _tracklet(self, number: int, streak: StreakMeasurement, header: FrameHeader) -> Tracklet:
        middle, nan = int(streak.t_tai_ns[1]), float("nan")
        half = header.exposure_ns // 2
        known = number % 2 == 1
        epochs, points = (np.array([middle - half, middle + half]), [0, 2]) if known else (np.array([middle]), [1])
        unknown = np.full(len(epochs), nan)
        return Tracklet(
            tracklet_id=number, streak_ids=np.array([streak.streak_id]), frames=np.array([streak.frame]),
            t_tai_ns=epochs.astype(np.int64), ra_deg=streak.ra_deg[points], dec_deg=streak.dec_deg[points],
            sigma_along_arcsec=unknown, sigma_cross_arcsec=unknown, t_ref_tai_ns=middle,
            ra_ref_deg=nan, dec_ref_deg=nan, rate_deg_s=nan, rate_err_deg_s=nan, position_angle_deg=nan,
            mag=streak.mag, mag_err=streak.mag_err, chi2_nu=nan, probability=streak.probability,
            direction_resolved=known, flags=streak.flags,
        )  # fmt: skip
