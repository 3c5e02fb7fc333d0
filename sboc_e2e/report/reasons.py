"""Why a true streak was missed, in words: from what came down, the products and the calibration."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Row
from numpy.typing import NDArray

from ground.options import GroundOptions
from ground.vetting.features import ALIGNED_DEG, ALIGNED_LENGTH_PX
from sboc_e2e.files import calibration_files
from sboc_e2e.icd.downlink import DownlinkFrame, Housekeeping
from sboc_e2e.icd.errors import SbocError
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.score.detection import FLUX_HELD
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.matching import TruthStreak, distance_to_path
from sboc_e2e.score.trail import draw

LEAST_HELD: Final = 0.1
"""Share of a trail's light below which a region does not hold it."""
MASKED: Final = 0.15
"""Least share of a trail's light on defective pixels that is mentioned."""
POINT_WIDTHS: Final = 3.0
"""Trails of fewer PSF widths (sigma) look like stars."""
STAR_NEAR_PX: Final = 3.0  # A star's light reaches that far: three PSF sigmas of `sboc_like` are 2.6 px.
TELLING: Final = 3.0
"""Errors from which a term of the vetter is named."""
PIXEL_VARIANCE_PX2: Final = 1.0 / 12.0
"""Variance of a uniform distribution over one pixel, which a measured width has besides the PSF's."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reasons:
    """What a run's files say of its frames. defects : (rows, cols) bool, None where the run has no map."""

    evaluation: Evaluation
    frames: Mapping[int, DownlinkFrame]
    defects: NDArray[np.bool_] | None
    options: GroundOptions

    @classmethod
    def of(cls, e: Evaluation, run_dir: Path) -> "Reasons":
        """Read what is there; what is not is left out of the reasons."""
        try:
            calibration = calibration_files.read(run_dir / "calibration")
        except (SbocError, OSError):
            calibration = None  # the page of a run whose calibration is gone still has its other reasons
        defects = None if calibration is None else calibration.defects != 0
        return cls(
            evaluation=e,
            frames={frame.header.frame: frame for frame in e.downlink_frames},
            defects=defects if defects is not None and defects.shape == e.shape else None,
            options=_ground_options(e.manifest),
        )

    def why_missed(self, streak: TruthStreak) -> str:
        """Why no measured streak that was published matches a true one."""
        e = self.evaluation
        share = e.footprints.captured.get(streak.index)
        if share is None:
            return "the frame did not arrive"
        rows = [row for row, t in e.pairs.items() if t.index == streak.index]
        if rows:
            return self._why_vetoed(e.streaks[rows[0]], self.frames.get(streak.frame))
        if share >= FLUX_HELD:
            return f"a region of interest holds {share:.0%} of its light, but no measured streak matches it"
        if share >= LEAST_HELD:
            return f"a region of interest holds only {share:.0%} of its light{self._limits(streak.frame)}"
        return f"not detected on board: {self._why_not_detected(streak)}"

    def _why_not_detected(self, streak: TruthStreak) -> str:
        frame = self.frames.get(streak.frame)
        words = []
        threshold = self._threshold(frame)
        if threshold is not None and math.isfinite(streak.snr):
            lacking = threshold - streak.snr
            where = f"{lacking:.1f} below" if lacking > 0 else "above"
            words.append(f"S/N {streak.snr:.1f} is {where} the detector's threshold of {threshold:.1f}")
        if streak.length_px < POINT_WIDTHS * streak.path.sigma_px:
            words.append(f"a trail of {streak.length_px:.1f} px looks like a star")
        if (masked := self._masked(streak)) > MASKED:
            words.append(f"{masked:.0%} of its light fell on defective pixels")
        if (stars := self._stars_on(streak, frame)) > 0:
            words.append(f"{stars} {'star of the list lies' if stars == 1 else 'stars of the list lie'} on it")
        if frame is not None and len(self.frames) == 1:
            words.append("it is the only frame, without another one that shows what stands still")
        return "; ".join(words or ["no reason can be read from the files"]) + self._limits(streak.frame)

    def _threshold(self, frame: DownlinkFrame | None) -> float | None:
        """The threshold that the frame was searched with, as it says itself, else as the detector's options say."""
        if frame is not None and frame.housekeeping is not None and frame.housekeeping.threshold_sigma > 0:
            return frame.housekeeping.threshold_sigma
        given = _tables(self.evaluation.manifest, "onboard", "detector").get("n_sigma")
        return float(given) if isinstance(given, int | float) else None

    def _limits(self, number: int) -> str:
        """What storm, budget and work limit did to a frame."""
        frame = self.frames.get(number)
        if frame is None:
            return ""
        words = []
        if FrameFlag.STORM in frame.flags:
            words.append("a particle storm raised the threshold or the number of detections over the limit")
        if frame.housekeeping is not None and frame.housekeeping.n_rois_dropped:
            budget = " by the budget" if FrameFlag.BUDGET_CUT in frame.flags else ""
            words.append(f"{frame.housekeeping.n_rois_dropped} detections of this frame were held back{budget}")
        if frame.housekeeping is not None and frame.housekeeping.shed:
            words.append(f"the work limit left undone: {shed_words(frame.housekeeping)}")
        return "".join(f"; {word}" for word in words)

    def _masked(self, streak: TruthStreak) -> float:
        """Share of the light on pixels that calibration calls defective."""
        if self.defects is None or not streak.flux_known:
            return 0.0
        row, col, electrons = draw(streak.path).pixels(*self.evaluation.shape)
        total = float(electrons.sum())
        return float(electrons[self.defects[row, col]].sum()) / total if total > 0 else 0.0

    def _stars_on(self, streak: TruthStreak, frame: DownlinkFrame | None) -> int:
        """Stars of the list nearer than a few pixels, ends included; those of the frame before count where regions hide them."""
        if frame is None:
            return 0
        count = 0
        low, high = streak.ends.min(axis=0) - STAR_NEAR_PX, streak.ends.max(axis=0) + STAR_NEAR_PX
        for stars in (frame.stars, frame.remembered):
            places = np.stack([np.asarray(stars.row, float), np.asarray(stars.col, float)], axis=1)
            near = places[((places >= low) & (places <= high)).all(axis=1)]
            count += sum(abs(distance_to_path(place, streak.path)[0]) < STAR_NEAR_PX for place in near)
        return count

    def _why_vetoed(self, measured: Row, frame: DownlinkFrame | None) -> str:
        """Which term of the vetter spoke against a streak that was measured."""
        probability = float(measured["probability"]) if "probability" in measured.colnames else math.nan
        if probability >= self.options.veto_below:
            limit = f"{self.options.veto_unlinked_below:g} (ground.veto_unlinked_below)"
            return f"measured, but in one frame only: its probability {probability:.2f} is below {limit}"
        terms = _terms(measured, frame.psf_sigma_px if frame else None)
        odds = f" (probability {probability:.2g}, limit {self.options.veto_below:g})" if math.isfinite(probability) else ""
        return f"measured, but rejected by the vetter{odds}: " + ("; ".join(terms) or "no single term stands out")


def shed_words(housekeeping: Housekeeping) -> str:
    """What the work limit left undone, such as "2,100 candidates, 3 points"."""
    return ", ".join(f"{n:,} {kind if n > 1 else kind.removesuffix('s')}" for kind, n in housekeeping.shed.items())


def _terms(measured: Row, psf_sigma_px: float | None) -> list[str]:
    """Features of a streak that are unlike those of trails, in words."""
    flags = StreakFlag(int(measured["flags"]))
    words = []
    for flag, text in (
        (StreakFlag.FIT_FAILED, "its fit failed"),
        (StreakFlag.STATIC, "the same place was bright in earlier frames"),
        (StreakFlag.SPIKE_LIKE, "it points at a bright star, as a diffraction spike does"),
        (StreakFlag.COSMIC_LIKE, "it is sharper than the PSF, as particle tracks are"),
    ):
        if flag in flags:
            words.append(text)
    names = measured.colnames
    if psf_sigma_px and {"width_px", "width_err_px"} <= set(names) and float(measured["width_px"]) > 0:
        width, error = float(measured["width_px"]), float(measured["width_err_px"])
        seen = width**2 + PIXEL_VARIANCE_PX2
        sharpness = 0.5 * math.log(seen / (psf_sigma_px**2 + PIXEL_VARIANCE_PX2))
        if abs(sharpness) > TELLING * max(error * width / seen, 0.02):
            which = "wider" if sharpness > 0 else "narrower"
            words.append(f"it is {which} than the PSF ({width:.2f} px against {psf_sigma_px:.2f} px)")
    if "chi2_nu" in names and float(measured["chi2_nu"]) > 1.5:
        words.append(f"a straight trail fits it badly (chi2/nu {float(measured['chi2_nu']):.1f})")
    if {"angle_deg", "length_px"} <= set(names):
        off = float(measured["angle_deg"]) % 90.0
        if float(measured["length_px"]) > ALIGNED_LENGTH_PX and min(off, 90.0 - off) < ALIGNED_DEG:
            words.append("it runs along a row or column")
    return words


def _tables(manifest: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """A table of the scenario that the run was made with; empty where the manifest has none."""
    node: Any = manifest
    for key in ("scenario", "document", *path):
        node = node.get(key) if isinstance(node, Mapping) else None
    return node if isinstance(node, Mapping) else {}


def _ground_options(manifest: Mapping[str, Any]) -> GroundOptions:
    """The limits of the vetter that the run was made with."""
    given = _tables(manifest, "ground")
    known = {name: given[name] for name in ("veto_below", "veto_unlinked_below") if isinstance(given.get(name), int | float)}
    return GroundOptions(**known)
