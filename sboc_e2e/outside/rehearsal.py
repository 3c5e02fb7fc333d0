"""A small frame goes ahead of a large one: libraries and kernels are loaded beside other work. On board here.

It is noise with a trail, without which the chain would not come to its costly steps. Nothing of it is kept.
"""

from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.options import OnboardOptions
from onboard.state import OnboardSteps
from sboc_e2e.icd.frame import Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.tai import NS_PER_S
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.guessed_camera import ASSUMED_PSF_SIGMA_PX, camera_of_frame
from sboc_e2e.outside.header_times import FIRST_ASSUMED_TAI_NS
from sboc_e2e.outside.look_alikes import CountingChain
from sboc_e2e.provenance import SEGMENTS

REHEARSED_PX: Final = 256
"""Side of the frame: four tiles of the sky. Chosen."""
SKY_ADU: Final = 300.0
"""Its sky. Chosen."""
NOISE_ADU: Final = 4.0
"""Noise of its pixels. Chosen."""

TRAIL: Final = (60.0, 70.0, 190.0, 150.0)
"""Ends of the trail (row, col, row, col). Chosen: far from the borders, along neither rows nor columns."""
TRAIL_PEAK: Final = 6.0
"""Its brightest pixels, in noise of a pixel: S/N 100. Chosen."""


def rehearse_board(options: OnboardOptions, steps: OnboardSteps) -> None:
    """The small frame through the on-board chain.

    Not done where a step is not the project's own: somebody else's sees the frames alone. What is wrong is said when a frame is
    processed.
    """
    if not are_own(vars(steps).values()):
        return
    with suppress(Exception):
        frame, camera = small_frame()
        board = CountingChain(options, steps, camera=camera, run_id=0)
        board.process(board.initial_state(), frame)


def are_own(steps: Iterable[Any]) -> bool:
    """Whether steps are the project's own."""
    return all(type(each).__module__.partition(".")[0] in SEGMENTS for each in steps)


def small_frame() -> tuple[Frame, NominalCamera]:
    """The frame, and a camera that fits it roughly."""
    pixels = np.rint(_pixels_adu()).astype(np.uint16)
    header = FrameHeader(
        frame=0,
        rows=REHEARSED_PX,
        cols=REHEARSED_PX,
        exposure_ns=NS_PER_S,
        line_time_ns=0,
        t_start_tai_ns=FIRST_ASSUMED_TAI_NS,
    )
    frame = Frame(header=header, pixels=pixels)
    return frame, camera_of_frame(SourcedFrame(frame=frame, file="", hdu=0, wcs=None, notes=()), None)


def _pixels_adu() -> NDArray[np.float64]:
    """Noise and the trail."""
    pixels = np.random.default_rng(0).normal(SKY_ADU, NOISE_ADU, (REHEARSED_PX, REHEARSED_PX))
    row, col = np.indices(pixels.shape)
    row0, col0, row1, col1 = TRAIL
    length = np.hypot(row1 - row0, col1 - col0)
    u_row, u_col = (row1 - row0) / length, (col1 - col0) / length
    along = (row - row0) * u_row + (col - col0) * u_col
    across = (row - row0) * u_col - (col - col0) * u_row
    profile = np.exp(-0.5 * (across / ASSUMED_PSF_SIGMA_PX) ** 2)
    return pixels + TRAIL_PEAK * NOISE_ADU * np.where((along >= 0.0) & (along <= length), profile, 0.0)
