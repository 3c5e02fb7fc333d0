"""The filtered level of the sky: better than one frame's where the sky stays, at once the frame's own where it changes."""

from dataclasses import replace

import numpy as np
import pytest

from ground.photometry.sky_memory import filtered_sky
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel
from tests.downlink import bare_frame

SHAPE = (32, 32)
NOISE_SIGMAS, STEP_SIGMAS = 0.02, 0.05
SIGMA_ADU = 2.5


def sky(rng: np.random.Generator) -> np.ndarray:
    """A level with a slope and structure of 0.06 of a pixel's noise, ADU."""
    return 5.0 + SIGMA_ADU * (0.3 * np.linspace(0.0, 1.0, SHAPE[1]) + 0.06 * rng.normal(size=SHAPE))


def frame_of(number: int, level_adu: np.ndarray, rng: np.random.Generator, gain_e_adu: float = 1.2) -> DownlinkFrame:
    """A frame whose mesh shows the level with the noise of its tiles, in the steps of its transmission."""
    step = STEP_SIGMAS * SIGMA_ADU
    measured = np.rint((level_adu + NOISE_SIGMAS * SIGMA_ADU * rng.normal(size=SHAPE)) / step) * step
    mesh = BackgroundModel(
        tile_px=64, level_adu=measured.astype(np.float32), sigma_adu=np.full(SHAPE, SIGMA_ADU, dtype=np.float32)
    )
    header = FrameHeader(
        frame=number, t_start_tai_ns=1 + number, exposure_ns=1, line_time_ns=0, rows=2048, cols=2048, gain_e_adu=gain_e_adu
    )
    return bare_frame(header, background=mesh)


def errors(frames: list[DownlinkFrame], level_adu: np.ndarray) -> list[float]:
    """Rms error of the filtered level of each frame, in pixel sigmas."""
    memory, out = None, []
    for frame in frames:
        memory, filtered = filtered_sky(memory, frame)
        assert filtered.background is not None
        out.append(float(np.sqrt(np.mean((filtered.background.level_adu - level_adu) ** 2))) / SIGMA_ADU)
    return out


def test_a_steady_sky_is_known_better_with_every_frame() -> None:
    rng = np.random.default_rng(3)
    level = sky(rng)
    rms = errors([frame_of(k, level, rng) for k in range(16)], level)
    assert rms[0] == pytest.approx(np.hypot(NOISE_SIGMAS, STEP_SIGMAS / np.sqrt(12.0)), rel=0.1)
    # 1 / 4 for sixteen frames of equal weight; steps of the transmission do not average like noise
    assert rms[-1] < 0.4 * rms[0]


def test_a_common_change_of_level_is_no_change_of_the_sky() -> None:
    rng = np.random.default_rng(4)
    level = sky(rng)
    frames = [frame_of(k, level + 0.7 * k, rng) for k in range(12)]
    memory = None
    for frame in frames:
        memory, filtered = filtered_sky(memory, frame)
    assert filtered.background is not None
    assert np.sqrt(np.mean((filtered.background.level_adu - level - 0.7 * 11) ** 2)) < 0.015 * SIGMA_ADU


def test_another_sky_is_believed_at_once() -> None:
    rng = np.random.default_rng(5)
    old, new = sky(rng), sky(rng) + SIGMA_ADU * 0.5 * np.linspace(0.0, 1.0, SHAPE[0])[:, None]
    memory = None
    for k in range(8):
        memory, _ = filtered_sky(memory, frame_of(k, old, rng))
    _, filtered = filtered_sky(memory, frame_of(8, new, rng))
    assert filtered.background is not None
    assert np.sqrt(np.mean((filtered.background.level_adu - new) ** 2)) < 1.3 * np.hypot(0.02, 0.0144) * SIGMA_ADU


def test_other_settings_begin_anew_and_frames_without_mesh_pass() -> None:
    rng = np.random.default_rng(6)
    level = sky(rng)
    memory, _ = filtered_sky(None, frame_of(0, level, rng))
    other = frame_of(1, level, rng, gain_e_adu=10.0)
    after, filtered = filtered_sky(memory, other)
    assert filtered is other
    assert after is not None
    assert memory is not None
    assert after.settings != memory.settings
    bare = replace(other, background=None)
    assert filtered_sky(memory, bare) == (memory, bare)
