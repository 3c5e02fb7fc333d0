"""Hot pixels that are learned: how long they are known, and in which frames."""

from dataclasses import replace

import numpy as np

from onboard.image.hot_pixels import LOOKED_AT_FRAMES, SIGHTINGS, HotPixels
from sboc_e2e.icd.flags import MaskBit, StarFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import StarList

SHAPE = (128, 256)
HEADER = FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=10**9, line_time_ns=0, rows=SHAPE[0], cols=SHAPE[1])
HOT = np.array([[33, 44], [34, 44], [90, 200]])


def masked_in(pixels: HotPixels, header: FrameHeader) -> np.ndarray:
    """Map of the pixels that are masked in a frame."""
    mask = np.zeros((header.rows, header.cols), np.uint8)
    pixels.in_window(header).mark(mask)
    return mask & np.uint8(MaskBit.LEARNED_HOT)


def run(n: int, hot: np.ndarray) -> tuple[HotPixels, np.ndarray]:
    """State after n frames, and whether each hot pixel (n, k) was masked; those that are not are sharp peaks of the star list."""
    state, known = HotPixels.empty(), []
    for _ in range(n):
        mask = masked_in(state, HEADER)[hot[:, 0], hot[:, 1]] != 0
        known.append(mask)
        row, col = hot[~mask].T.astype(np.float64)
        ones = np.ones(len(row), np.float32)
        flags = np.full(len(row), StarFlag.COSMIC_LIKE, np.uint8)
        stars = StarList(row=row, col=col, flux_e=100.0 * ones, snr=30.0 * ones, flags=flags)
        state = state.in_window(HEADER).after(stars, SHAPE)
    return state, np.array(known)


def test_a_learned_pixel_stays_masked_but_for_one_look_in_many_frames() -> None:
    """What is masked is in no star list. Learned pixels were forgotten after 24 frames, and all of them were stars for three."""
    _, known = run(6 * LOOKED_AT_FRAMES, HOT)
    assert not known[:SIGHTINGS].any()
    assert (known[SIGHTINGS:].mean(axis=0) >= 1.0 - 1.5 / LOOKED_AT_FRAMES).all()
    assert (~known[SIGHTINGS:]).sum(axis=1).max() == 1, "each is looked at in another frame"


def test_a_pixel_that_is_hot_no_more_is_forgotten() -> None:
    state, _ = run(SIGHTINGS, HOT)
    nothing = StarList(
        row=np.zeros(0), col=np.zeros(0), flux_e=np.zeros(0, np.float32), snr=np.zeros(0, np.float32), flags=np.zeros(0, np.uint8)
    )
    for _ in range(2 * LOOKED_AT_FRAMES):
        state = state.in_window(HEADER).after(nothing, SHAPE)
    assert state.pixel.size == 0


def test_what_was_learned_in_one_window_masks_nothing_in_another() -> None:
    """Pixel (33, 44) of 256 columns masked (66, 44) of 128."""
    state, _ = run(SIGHTINGS, HOT[:1])
    assert masked_in(state, HEADER)[33, 44]
    assert not masked_in(state, replace(HEADER, rows=128, cols=128)).any()
    assert not masked_in(state, replace(HEADER, window_row0=64)).any()
