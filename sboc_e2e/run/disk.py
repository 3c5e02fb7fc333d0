"""Disk space of a run: stated before the run starts. A run that does not fit is refused."""

import os
import shutil
from pathlib import Path
from typing import Final

from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.progress import Progress
from sboc_e2e.scenario import Scenario

STAR_ROW_BYTES: Final = 85  # Of truth/stars.ecsv: the 10,531 rows of `smoke` have 85.1 on average.
STARS_PER_PIXEL: Final = 0.002
"""Rows of truth/stars.ecsv per pixel and frame; measured on the anti-Sun field, crowded fields have up to ten times more."""

DOWNLINK_SHARE: Final = 0.02
"""Of frames of 12 bits: crowded `smoke` has 0.022, `sso_antisun` 1 / 1,243 (README.md). Whole frames take more."""
FRAMES_IN_FLIGHT: Final = 8
"""Frames taken to lie between the stages, 6 bytes a pixel. Chosen, not measured: the estimate is rough (50 %)."""


def estimate_bytes(scenario: Scenario) -> tuple[int, int]:
    """What stays on disk, and what is needed besides while the run lasts; rough, to 50 %."""
    instrument, n = scenario.simulator.instrument, scenario.simulator.frames
    pixels = instrument.rows * instrument.cols
    every = scenario.output.keep_frames_every
    kept = (-(-n // every) if every else 0) * pixels * 2
    truth = int(n * pixels * STARS_PER_PIXEL * STAR_ROW_BYTES)
    calibration = pixels * 9
    return kept + truth + calibration + int(n * pixels * 1.5 * DOWNLINK_SHARE), truth + FRAMES_IN_FLIGHT * pixels * 6


def check(out: Path, scenario: Scenario, progress: Progress) -> None:
    """Print what will be made and its cost; `UserError` when the disk has not that much."""
    stays, passing = estimate_bytes(scenario)
    existing = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.is_dir())
    free = shutil.disk_usage(existing).free
    frames, instrument = scenario.simulator.frames, scenario.simulator.instrument
    progress.note(
        f"{frames} frames of {instrument.rows} x {instrument.cols} px; "
        f"disk: about {_mb(stays)} in {out}, {_mb(passing)} more while it runs; {_mb(free)} free"
    )
    # where nothing can be written at all, the first attempt to write says why
    if stays + passing > free and os.access(existing, os.W_OK):
        raise UserError(
            f"{out}: needs about {_mb(stays + passing)}, {_mb(free)} are free; "
            "fewer frames, or output.keep_frames_every = 0, need less"
        )


def _mb(n_bytes: int) -> str:
    return f"{n_bytes / 1e6:,.0f} MB"
