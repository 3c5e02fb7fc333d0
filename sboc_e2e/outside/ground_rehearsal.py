"""The small frame of `rehearsal`, as it comes down, goes through ground: libraries and kernels are loaded beside other work."""

from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from astropy.table import Table

import sboc_e2e.outside.page  # noqa: F401 - what comes last is loaded here too
from ground.on_demand import OnDemand
from ground.products import tables
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files import ecsv
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.signals import FIXED_POINT, BackgroundModel, Detection, RoiGroup, StarList, Strip
from sboc_e2e.outside.guessed_camera import ASSUMED_PSF_SIGMA_PX
from sboc_e2e.outside.rehearsal import NOISE_ADU, REHEARSED_PX, SKY_ADU, TRAIL, are_own, rehearse_board, small_frame
from sboc_e2e.run.ground_stage import ground_chain
from sboc_e2e.run.onboard_stage import onboard_steps
from sboc_e2e.scenario import Scenario

REACH_PX: Final = 16
"""How far the pixels that come down reach to all sides of the trail. Chosen."""


def rehearse(scenario: Scenario, catalogue: StarCatalogue) -> None:
    """The small frame through both chains, each for itself."""
    rehearse_board(scenario.onboard, onboard_steps(scenario))
    rehearse_ground(scenario, catalogue)


def rehearse_ground(scenario: Scenario, catalogue: StarCatalogue) -> None:
    """The small frame through the ground chain, and its table of streaks to a file and back.

    Not done where a step is not the project's own.
    """
    if not are_own(each.step for each in scenario.components.values()):
        return
    with suppress(Exception), TemporaryDirectory(prefix="sboc-") as folder:
        frame, camera = small_frame()
        ground = ground_chain(scenario, calibration=None, camera=camera, catalogue=catalogue, run_id=0)
        down = _come_down(frame)
        _, products = ground.process_frame(ground.initial_state(), down)
        result = ground.finish([down], OnDemand(1, lambda _: products))
        file = Path(folder) / "streaks.ecsv"
        ecsv.write_pieces(file, tables.streaks_tables(result))
        Table.read(file, format="ascii.ecsv")


def _come_down(frame: Frame) -> DownlinkFrame:
    """The frame when the pixels about its trail came down, in one strip along the rows."""
    row0, col0, row1, col1 = TRAIL
    slope = (col1 - col0) / (row1 - row0)
    first, n = int(row0) - REACH_PX, int(row1 - row0) + 2 * REACH_PX
    minor0, slope_fp = (round(value * FIXED_POINT) for value in (col0 - REACH_PX * (1.0 + slope), slope))
    row = first + np.arange(n)[:, None]
    col = (minor0 + np.arange(n)[:, None] * slope_fp >> 16) + np.arange(2 * REACH_PX + 1)
    values = frame.pixels[row, col].astype(np.int32)
    strip = Strip(axis=0, major0=first, minor0_fp=minor0, slope_fp=slope_fp, level_adu=round(SKY_ADU), values_adu=values)
    detection = Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=100.0)
    tiles = np.ones((4, 4), dtype=np.float32)
    return DownlinkFrame(
        header=frame.header,
        flags=FrameFlag(0),
        housekeeping=None,
        stars=StarList.empty(),
        rois=(RoiGroup(roi_id=0, detection=detection, strips=(strip,), n_strips=1),),
        background=BackgroundModel(tile_px=REHEARSED_PX // 4, level_adu=SKY_ADU * tiles, sigma_adu=NOISE_ADU * tiles),
        thumbnail_adu=None,
        whole_frame=None,
        psf_sigma_px=ASSUMED_PSF_SIGMA_PX,
    )
