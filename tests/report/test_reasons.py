"""Why a streak was missed: each reason that the files can tell."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from astropy.table import Table

from ground.options import GroundOptions
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.signals import StarList
from sboc_e2e.report.reasons import Reasons
from sboc_e2e.score.evaluation import truth_streaks
from tests.score.conftest import SHAPE, SIGMA_PX, Synthetic

SYNTHETIC = Synthetic(3)
TRUTH = truth_streaks(SYNTHETIC.tables["streaks"])


NOTHING = FrameFlag(0)


def frame(flags: FrameFlag = NOTHING, threshold: float = 7.0, dropped: int = 0, psf: float = SIGMA_PX, shed: int = 0) -> Any:
    housekeeping = Housekeeping(
        flags=flags, n_stars_found=0, n_stars_sent=0, n_detections=0, n_rois_sent=0, n_rois_dropped=dropped, bytes_dropped=0,
        threshold_sigma=threshold, background_adu=100.0, sigma_adu=2.0, n_masked=0,
        shed_candidates=shed, shed_points=min(shed, 1),
    )  # fmt: skip
    return SimpleNamespace(
        flags=flags, housekeeping=housekeeping, stars=StarList.empty(), remembered=StarList.empty(), psf_sigma_px=psf
    )


def reasons(captured: float | None, row: dict[str, Any] | None = None, defects: Any = None, **of_frame: Any) -> Reasons:
    streak = TRUTH[4]
    pairs = {0: streak} if row else {}
    evaluation = SimpleNamespace(
        footprints=SimpleNamespace(captured={} if captured is None else {streak.index: captured}),
        pairs=pairs,
        streaks=Table(rows=[row]) if row else Table(),
        manifest={"scenario": {"document": {"onboard": {"detector": {"n_sigma": 7.2}}, "ground": {"veto_below": 0.2}}}},
        shape=SHAPE,
    )
    frames = {streak.frame - 1: frame(), streak.frame: frame(**of_frame)}
    given: Any = evaluation
    return Reasons(evaluation=given, frames=frames, defects=defects, options=GroundOptions(veto_below=0.2))


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (reasons(None), "the frame did not arrive"),
        (reasons(0.95), "holds 95% of its light, but no measured streak matches it"),
        (reasons(0.5), "holds only 50% of its light"),
        (reasons(0.0), "S/N 20.0 is above the detector's threshold of 7.0"),
        (reasons(0.0, threshold=23.5), "S/N 20.0 is 3.5 below the detector's threshold of 23.5"),
        (reasons(0.0, threshold=0.0), "threshold of 7.2"),
        (reasons(0.0, flags=FrameFlag.STORM), "a particle storm raised the threshold"),
        (reasons(0.0, flags=FrameFlag.BUDGET_CUT, dropped=9), "9 detections of this frame were held back by the budget"),
        (reasons(0.0, shed=2100), "the work limit left undone: 2,100 candidates, 1 point"),
        (reasons(0.0, defects=np.ones(SHAPE, bool)), "100% of its light fell on defective pixels"),
        (reasons(0.9, {"flags": int(StreakFlag.SPIKE_LIKE), "probability": 0.01}), "it points at a bright star"),
        (
            reasons(0.9, {"flags": 0, "probability": 0.01, "width_px": 0.3, "width_err_px": 0.02}),
            "it is narrower than the PSF (0.30 px against 0.85 px)",
        ),
        (reasons(0.9, {"flags": 0, "probability": 0.01, "chi2_nu": 4.0}), "fits it badly (chi2/nu 4.0)"),
        (reasons(0.9, {"flags": 0, "probability": 0.3}), "its probability 0.30 is below 0.5 (ground.veto_unlinked_below)"),
    ],
)
def test_a_miss_says_why(made: Reasons, words: str) -> None:
    assert words in made.why_missed(TRUTH[4])


def test_the_only_frame_says_that_it_is_the_only_one() -> None:
    made = reasons(0.0)
    assert "the only frame" in replace(made, frames={TRUTH[4].frame: frame()}).why_missed(TRUTH[4])
