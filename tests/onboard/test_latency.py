"""Facts about frames without a predecessor, which wait for the next one."""

import math
import pickle

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.chain import OnboardSteps
from onboard.detect import LineIntegralDetector
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.latency import FrameSequence
from onboard.stars.matched import MatchedStars
from onboard.state import OnboardResult
from sboc_e2e.exams.trails import trail
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.signals import Detection
from tests.onboard.small_run import Run, header, start_run
from tests.onboard.star_fields import GAIN_E_ADU, PEDESTAL_ADU, READ_NOISE_E, SKY_E, StarField, star_grid

SIDE = 320
PSF_PX = 0.849
NOISE_E = math.sqrt(SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12.0)
PLACES = [(70.0 + 90.0 * (k // 3), 60.0 + 95.0 * (k % 3)) for k in range(9)]
"""Middles of nine trails, one in each part of the field."""


def _sky() -> StarField:
    return star_grid(np.random.default_rng(5), side=SIDE, pitch=32, flux_e=(200.0, 20000.0), sigma_px=PSF_PX)


def _other_sky() -> NDArray[np.float64]:
    """Stars at places of their own, e-: two grids are one pattern."""
    rng = np.random.default_rng(7)
    electrons = np.full((SIDE, SIDE), SKY_E)
    for snr in np.geomspace(20.0, 1000.0, 60):
        row, col = rng.uniform(6.0, SIDE - 6.0, 2)
        one = trail((float(row), float(col)), 0.1, 0.0, float(snr), (SIDE, SIDE), NOISE_E)
        electrons[one.row, one.col] += one.light_e
    return electrons


def _trails(snr: float, length_px: float) -> NDArray[np.float64]:
    """Light of nine trails, e-."""
    light = np.zeros((SIDE, SIDE))
    for k, place in enumerate(PLACES):
        one = trail(place, length_px, 20.0 * k, snr, (SIDE, SIDE), NOISE_E)
        light[one.row, one.col] += one.light_e
    return light


def _frame(number: int, electrons: NDArray[np.float64]) -> Frame:
    rng = np.random.default_rng([17, number])
    noisy = rng.poisson(electrons) + rng.normal(0.0, READ_NOISE_E, electrons.shape)
    return Frame(
        header=header(number, SIDE), pixels=np.clip(np.rint(noisy / GAIN_E_ADU + PEDESTAL_ADU), 0, 65535).astype(np.uint16)
    )


def _run() -> Run:
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=LineIntegralDetector(), codec=PlanesCodec()
    )
    return start_run(side=SIDE, steps=steps)


def _all(run: Run, frames: list[Frame]) -> list[tuple[OnboardResult, ...]]:
    """What each frame makes known, and what the end does."""
    sequence = FrameSequence(chain=run.chain, state=run.state)
    return [*(sequence.take(frame) for frame in frames), sequence.flush()]


def _found(detections: tuple[Detection, ...]) -> int:
    """How many of the nine trails have a detection about their middle."""
    middles = [(0.5 * (d.row0 + d.row1), 0.5 * (d.col0 + d.col1)) for d in detections]
    return sum(any(math.hypot(r - row, c - col) < 6.0 for r, c in middles) for row, col in PLACES)


def test_a_first_frame_shows_what_a_later_one_shows() -> None:
    """Trails of 18 px and S/N 12: judged at once a first frame has none, for they may be blends of stars."""
    stars = _sky().electrons
    with_trails = [_frame(k, stars + (_trails(12.0, 18.0) if k == 0 else 0.0)) for k in range(2)]
    run = _run()
    alone = run.chain.process(run.state, with_trails[0])[1]
    made = _all(run, with_trails)
    assert [len(results) for results in made] == [0, 2, 0]
    assert _found(alone.detections) == 0
    assert _found(made[1][0].detections) >= 8
    assert len(made[1][0].detections) <= 9
    assert made[1][1].detections == ()


def test_rows_of_stars_in_a_first_frame_are_refused() -> None:
    """What stands still in the next frame is no mover."""
    stars = _sky().electrons + _trails(14.0, 40.0)
    run = _run()
    frames = [_frame(k, stars) for k in range(2)]
    assert _found(run.chain.process(run.state, frames[0])[1].detections) >= 8
    assert _all(run, frames)[1][0].detections == ()


def test_each_frame_after_a_slew_waits() -> None:
    skies = [_sky().electrons, _sky().electrons, _other_sky() + _trails(12.0, 18.0), _other_sky()]
    made = _all(_run(), [_frame(k, sky) for k, sky in enumerate(skies)])
    assert [len(results) for results in made] == [0, 2, 0, 2, 0]
    assert _found(made[3][0].detections) >= 8


def test_the_same_frame_come_twice_is_no_neighbour() -> None:
    """It would refute everything."""
    first = _frame(0, _sky().electrons + _trails(14.0, 40.0))
    again = Frame(header=header(1, SIDE), pixels=first.pixels)
    made = _all(_run(), [first, again])
    assert _found(made[1][0].detections) >= 8


@pytest.mark.parametrize("n_frames", [1, 3])
def test_packets_leave_in_the_order_of_frames_and_are_the_same_again(n_frames: int) -> None:
    frames = [_frame(k, _sky().electrons) for k in range(n_frames)]
    made = [[result for results in _all(_run(), frames) for result in results] for _ in range(2)]
    assert [r.packets for r in made[0]] == [r.packets for r in made[1]]
    assert [r.housekeeping.parameter_set for r in made[0]] == [made[0][0].housekeeping.parameter_set] * n_frames
    sequence = [int.from_bytes(r.packets[2:4], "big") & 0x3FFF for r in made[0]]
    assert sequence == sorted(sequence)
    run = _run()
    if n_frames == 1:
        assert made[0][0].packets == run.chain.process(run.state, frames[0])[1].packets


def test_a_waiting_frame_is_part_of_the_state() -> None:
    frames = [_frame(k, _sky().electrons) for k in range(2)]
    run = _run()
    sequence = FrameSequence(chain=run.chain, state=run.state)
    sequence.take(frames[0])
    revived = FrameSequence(chain=run.chain, state=pickle.loads(pickle.dumps(sequence.state)))  # noqa: S301 - just written
    assert [r.packets for r in revived.take(frames[1])] == [r.packets for r in sequence.take(frames[1])]


def test_a_detector_that_looks_at_single_frames_has_none_wait() -> None:
    run = start_run(side=SIDE)
    assert [len(results) for results in _all(run, [_frame(0, _sky().electrons)])] == [1, 0]
