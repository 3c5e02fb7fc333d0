"""A small frame goes through both chains ahead of a large one, in a thread: libraries and kernels are loaded beside other work.

It is a corner of the large frame with a trail drawn into it, without which neither chain would come to its costly steps.
"""

from contextlib import suppress
from dataclasses import replace
from typing import Final

import numpy as np

from ground.on_demand import OnDemand
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.frame import Frame
from sboc_e2e.outside.border_slopes import noise_of
from sboc_e2e.outside.camera import ASSUMED_PSF_SIGMA_PX, camera_of_frame
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.look_alikes import CountingChain
from sboc_e2e.provenance import SEGMENTS
from sboc_e2e.run.ground_stage import ground_chain
from sboc_e2e.run.onboard_stage import onboard_steps
from sboc_e2e.scenario import Scenario

REHEARSED_PX: Final = 256
"""Side of the corner: four tiles of the sky. Chosen."""

TRAIL: Final = (60.0, 70.0, 190.0, 150.0)
"""Ends of the trail (row, col, row, col). Chosen: far from the borders, along neither rows nor columns."""

TRAIL_PEAK: Final = 6.0
"""Its brightest pixels, in noise of a pixel: S/N 100. Chosen."""


def rehearse(scenario: Scenario, sourced: SourcedFrame, catalogue: StarCatalogue) -> None:
    """A corner of a frame through both chains, with a camera that fits it roughly; nothing of it is kept.

    Not done where a step is not the project's own: somebody else's sees the frames alone. What is wrong with the frame is said
    when it is processed.
    """
    if any(type(each.step).__module__.partition(".")[0] not in SEGMENTS for each in scenario.components.values()):
        return
    import sboc_e2e.outside.page  # noqa: F401 - what comes last is loaded here too

    with suppress(Exception):
        corner = _corner(sourced.frame)
        camera = camera_of_frame(replace(sourced, frame=corner), None)
        board = CountingChain(scenario.onboard, onboard_steps(scenario), camera=camera, run_id=0)
        _, result = board.process(board.initial_state(), corner)
        ground = ground_chain(scenario, calibration=None, camera=camera, catalogue=catalogue, run_id=0, evidence=board.evidence)
        frames, ingest = ground.ingest(result.packets)
        _, products = ground.process_frame(ground.initial_state(), frames[0])
        ground.finish(frames, OnDemand(1, lambda _: products), ingest)


def _corner(frame: Frame) -> Frame:
    """The first rows and columns of a frame with a trail in them."""
    pixels = np.array(frame.pixels[:REHEARSED_PX, :REHEARSED_PX], dtype=np.float32)
    row, col = np.indices(pixels.shape)
    row0, col0, row1, col1 = TRAIL
    length = np.hypot(row1 - row0, col1 - col0)
    u_row, u_col = (row1 - row0) / length, (col1 - col0) / length
    along = (row - row0) * u_row + (col - col0) * u_col
    across = (row - row0) * u_col - (col - col0) * u_row
    profile = np.exp(-0.5 * (across / ASSUMED_PSF_SIGMA_PX) ** 2)
    pixels += TRAIL_PEAK * noise_of(pixels) * np.where((along >= 0.0) & (along <= length), profile, 0.0)
    if frame.pixels.dtype.kind == "u":
        pixels = np.rint(pixels).clip(0, 65535)
    header = replace(frame.header, rows=pixels.shape[0], cols=pixels.shape[1])
    return Frame(header=header, pixels=np.ascontiguousarray(pixels.astype(frame.pixels.dtype)))
