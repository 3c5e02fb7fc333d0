"""Light beyond a detection's ends: regions reach as far as it goes on, and no further."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.downlink.roi_coding import region_margins_px
from onboard.downlink.trail_light import BLOCK_WIDTHS, DARK_BLOCKS, room_beyond_px
from onboard.options import RoiOptions
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, Detection, DetectorView, StarList

SHAPE, ROW, WIDTH_PX, NOISE_ADU = (120, 600), 60.3, 1.2, 5.0
FOUND = Detection(row0=ROW, col0=100.0, row1=ROW, col1=250.0, snr=200.0)
SKY_PX = DARK_BLOCKS * BLOCK_WIDTHS * WIDTH_PX


def view(brightness: NDArray[np.float64], seed: int = 1) -> DetectorView:
    """A trail along a row, of this brightness (ADU at its middle) in each column, in noise."""
    profile = np.exp(-0.5 * ((np.arange(SHAPE[0]) - ROW) / WIDTH_PX) ** 2)[:, None]
    noise = np.random.default_rng(seed).normal(0.0, NOISE_ADU, SHAPE)
    tiles = np.zeros((1, 1), dtype=np.float32)
    return DetectorView(
        header=FrameHeader(
            frame=0,
            t_start_tai_ns=0,
            exposure_ns=1,
            line_time_ns=0,
            rows=SHAPE[0],
            cols=SHAPE[1],
            gain_e_adu=1.0,
            saturation_adu=65535,
        ),
        residual_adu=(profile * brightness + noise).astype(np.float32),
        background=BackgroundModel(level_adu=tiles, sigma_adu=tiles + np.float32(NOISE_ADU), tile_px=max(SHAPE)),
        mask=np.zeros(SHAPE, dtype=np.uint8),
        stars=StarList.empty(),
        psf_sigma_px=WIDTH_PX,
    )


def test_light_that_goes_on_is_followed_to_where_it_ends() -> None:
    """Beyond column 250 a fifth of the light goes on to column 330; before column 100 there is none."""
    col = np.arange(SHAPE[1])
    light = np.where((col > 100) & (col < 250), 100.0, 0.0) + np.where((col >= 250) & (col < 330), 20.0, 0.0)
    seen = view(light)
    assert room_beyond_px(seen, FOUND, 0, WIDTH_PX) == pytest.approx(SKY_PX, abs=6.0)
    assert room_beyond_px(seen, FOUND, 1, WIDTH_PX) == pytest.approx(80.0 + SKY_PX, abs=9.0)


def test_a_region_grows_by_the_trail_s_length_at_most() -> None:
    """Light to the border, 350 px away."""
    room = room_beyond_px(view(np.full(SHAPE[1], 100.0)), FOUND, 1, WIDTH_PX)
    assert FOUND.length_px <= room <= FOUND.length_px + 2.0 * SKY_PX


def test_what_is_masked_neither_holds_light_nor_ends_it() -> None:
    """A mask over columns 260 to 300 hides the trail, which goes on to column 330."""
    col = np.arange(SHAPE[1])
    seen = view(np.where((col > 100) & (col < 330), 100.0, 0.0))
    mask = seen.mask.copy()
    mask[:, 260:300] = 1
    assert room_beyond_px(replace(seen, mask=mask), FOUND, 1, WIDTH_PX) == pytest.approx(80.0 + SKY_PX, abs=9.0)


def test_only_where_it_is_asked_for_and_room_is_left() -> None:
    """Flight's default, and regions that the budget has cut, keep the margin of a faint end's error."""
    seen = view(np.full(SHAPE[1], 100.0))
    asked = RoiOptions(follow_light=True)
    default = region_margins_px(seen, FOUND, 6.0, WIDTH_PX, RoiOptions())
    assert default[0] == default[1] < 10.0
    assert min(region_margins_px(seen, FOUND, 6.0, WIDTH_PX, asked)) > 90.0
    cut = replace(FOUND, flags=StreakFlag.ROI_CUT)
    assert region_margins_px(seen, cut, 6.0, WIDTH_PX, asked) == region_margins_px(seen, cut, 6.0, WIDTH_PX, RoiOptions())
