"""A frame's own count of look-alikes: lines that the detector finds in the negative of the frame.

Nothing real is darker than the sky. Ripples, dust rings, slopes and correlated noise have both signs. What the same search finds
in the negative, after the same background, masks and star list, is therefore what it finds falsely in the frame (the target-decoy
method of Elias and Gygi 2007, doi:10.1038/nmeth1019). What is bright alone, such as cosmic rays, is not counted this way.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain
from onboard.options import OnboardOptions
from onboard.state import OnboardResult, OnboardState, OnboardSteps, Prepared
from onboard.work import meter
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.icd.results import check_detections
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.icd.steps import Detector

LEVELS_SNR: Final = (10.0, 20.0, 50.0, 100.0)
"""S/N at which the counts are published, beside the count of all."""

SHADOW_PX: Final = 64.0
"""Side of the tiles of the sky level. A bright trail lifts the level of its tiles, and leaves dark lines beside itself."""

SHADOW_SNR: Final = 2.0
"""A shadow is fainter than its trail by this factor at least."""

READOUT_SIGMAS: Final = 2.5
READOUT_SPAN: Final = 0.7
"""A line within `READOUT_SIGMAS` PSF sigmas of one row or column, over this share of the frame, comes from the readout."""

NO_LINE: Final = StreakFlag.POINT_LIKE | StreakFlag.COSMIC_LIKE


def negative_of(view: DetectorView) -> DetectorView:
    """The view with bright and dark exchanged, without neighbouring frames and with work of its own."""
    negative = np.negative(view.residual_adu)
    negative.flags.writeable = False
    return replace(view, residual_adu=negative, history=(), work=meter(negative.size))


def look_alikes(detector: Detector, view: DetectorView, detections: Sequence[Detection]) -> NDArray[np.float64]:
    """S/N and length (px), shape (n, 2), of lines in the negative of a frame by falling S/N.

    detections : of the frame itself. Dark lines beside a line that is much brighter are its shadow and do not count. Neither do
    lines of the readout: the vetter of uncalibrated frames refuses such lines by their place, and they tell nothing of others.
    """
    found = detector.detect(negative_of(view))
    check_detections(found, view.mask.shape)
    lines = [
        each
        for each in found
        if not (each.flags & NO_LINE or _of_readout(each, view) or any(_shadow(each, of) for of in detections))
    ]
    table = np.array([(each.snr, each.length_px) for each in lines], dtype=np.float64).reshape(-1, 2)
    return table[np.argsort(-table[:, 0], kind="stable")]


def _of_readout(line: Detection, view: DetectorView) -> bool:
    """Whether a line stays on one row or column over most of the frame."""
    drow, dcol = abs(line.row1 - line.row0), abs(line.col1 - line.col0)
    along, side = max((drow, view.header.rows), (dcol, view.header.cols), key=lambda pair: pair[0])
    return min(drow, dcol) < READOUT_SIGMAS * max(view.psf_sigma_px, 1.0) and along > READOUT_SPAN * side


def _shadow(dark: Detection, of: Detection) -> bool:
    """Whether a dark line lies along a brighter one."""
    if of.length_px == 0.0 or of.snr < SHADOW_SNR * dark.snr:
        return False
    drow, dcol = (of.row1 - of.row0) / of.length_px, (of.col1 - of.col0) / of.length_px
    for row, col in ((dark.row0, dark.col0), (dark.row1, dark.col1)):
        r, c = row - of.row0, col - of.col0
        if abs(r * dcol - c * drow) > SHADOW_PX or not -SHADOW_PX <= r * drow + c * dcol <= of.length_px + SHADOW_PX:
            return False
    return True


class CountingChain(OnboardChain):
    """The on-board chain, which searches the negative of each frame too. The chain's own results do not depend on it.

    look_alikes : by frame number, as `look_alikes` returns them.
    """

    def __init__(self, options: OnboardOptions, steps: OnboardSteps, *, camera: NominalCamera, run_id: int) -> None:
        super().__init__(options, steps, calibration=None, camera=camera, run_id=run_id)
        self._detector = steps.detector
        self.look_alikes: dict[int, NDArray[np.float64]] = {}

    def judge(self, state: OnboardState, prepared: Prepared) -> tuple[OnboardState, OnboardResult]:
        """As `OnboardChain.judge`; the search of the negative is added to `look_alikes`."""
        after, result = super().judge(state, prepared)
        if prepared.usable:
            view = prepared.view
            self.look_alikes[view.header.frame] = look_alikes(self._detector, view, result.detections)
        return after, result


def counts_of(table: NDArray[np.float64]) -> dict[str, int]:
    """Number of look-alikes, (n, 2) S/N and length, as published: in all, and from each of `LEVELS_SNR` on."""
    return {"all": len(table)} | {f"snr_{level:g}": int(np.sum(table[:, 0] >= level)) for level in LEVELS_SNR}
