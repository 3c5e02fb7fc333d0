"""Frames of the same light are told by their times and by their pixels, and are not held against each other."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from onboard.latency import FrameSequence
from onboard.options import OnboardOptions
from sboc_e2e import scenario as scenarios
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.outside.look_alikes import CountingChain
from sboc_e2e.outside.process import base_document
from sboc_e2e.outside.same_exposure import MOST_AT_ONCE, Mark, same_exposures
from sboc_e2e.registry import Registry
from sboc_e2e.run.onboard_stage import onboard_steps

SHAPE = (64, 64)


def mark(number: int, start: int, end: int, *, shape: tuple[int, int] = SHAPE, file: str = "", pixels: int = -1) -> Mark:
    return Mark(
        number=number, file=file or f"{number}.fits", span_ns=(start, end), shape=shape, pixels=pixels if pixels >= 0 else number
    )


@pytest.mark.parametrize(
    ("spans", "same"),
    [
        ([(0, 30), (0, 30)], True),
        ([(0, 30), (29, 59)], True),
        ([(0, 30), (30, 60)], False),
        ([(5, 5), (5, 5)], True),
        ([(0, 0), (1, 1)], False),
        ([(0, 90), (30, 60)], True),
    ],
    ids=["equal", "overlapping", "one after the other", "no exposure, equal start", "no exposure", "one in the other"],
)
def test_exposures_that_overlap_are_the_same(spans: list[tuple[int, int]], same: bool) -> None:
    for order in (spans, spans[::-1]):
        found = same_exposures([mark(k, *span) for k, span in enumerate(order)])
        assert found == ({0: {1}, 1: {0}} if same else {})


def test_times_that_are_not_known_and_frames_of_other_sizes_tell_nothing() -> None:
    without = [Mark(number=k, file=f"{k}", span_ns=None, shape=SHAPE, pixels=k) for k in range(2)]
    assert same_exposures(without) == {}
    assert same_exposures([mark(0, 0, 30), mark(1, 0, 30, shape=(64, 65))]) == {}
    equal = [Mark(number=k, file=f"{k}", span_ns=None, shape=SHAPE, pixels=9) for k in range(3)]
    assert same_exposures(equal) == {0: {1, 2}, 1: {0, 2}, 2: {0, 1}}


def test_a_sum_is_of_the_exposures_of_its_parts_and_they_are_not_of_each_others() -> None:
    parts = [mark(k, 40 * k, 40 * k + 30) for k in range(20)]
    found = same_exposures([*parts, mark(20, 0, 40 * 19 + 30)])
    assert found[20] == set(range(20))
    assert all(found[k] == {20} for k in range(20))


def test_one_time_for_all_files_is_not_believed() -> None:
    """The planes of one file are of one exposure, however many there are."""
    assert same_exposures([mark(k, 0, 30) for k in range(MOST_AT_ONCE + 1)]) == {}
    assert len(same_exposures([mark(k, 0, 30) for k in range(MOST_AT_ONCE)])) == MOST_AT_ONCE
    assert same_exposures([mark(k, 10 * k, 10 * k + 1000) for k in range(500)]) == {}
    assert len(same_exposures([mark(k, 0, 30, file="chips.fits") for k in range(62)])) == 62


@dataclass(frozen=True, kw_only=True)
class Looking:
    """Notes which frames each frame is held against. `seen` : by frame."""

    seen: dict[int, list[int]] = field(default_factory=dict)
    history_frames: int = 1

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        self.seen.setdefault(view.header.frame, [each.header.frame for each in view.history])
        return ()


@pytest.mark.parametrize(
    ("same", "held_against"),
    [
        ({}, {0: [1], 1: [0], 2: [1], 3: [2], 4: [3], 5: [4]}),
        # the first of two waits no longer than for the next frame, and is looked at alone; the second waits in its turn
        ({0: {1}, 1: {0}, 2: {3}, 3: {2}, 4: {5}, 5: {4}}, {0: [], 1: [2], 2: [1], 3: [1], 4: [3], 5: [3]}),
        ({0: {5}, 5: {0}}, {0: [1], 1: [0], 2: [1], 3: [2], 4: [3], 5: [4]}),
        ({2: {4}, 3: {4}, 4: {2, 3}}, {0: [1], 1: [0], 2: [1], 3: [2], 4: [5], 5: [4]}),
        ({k: set(range(6)) - {k} for k in range(6)}, {k: [] for k in range(6)}),
    ],
    ids=["none", "pairs", "far apart", "a sum of two", "all"],
)
def test_a_frame_is_held_against_the_newest_frame_of_another_exposure(
    same: dict[int, set[int]], held_against: dict[int, list[int]]
) -> None:
    looking, rng = Looking(), np.random.default_rng(5)
    scenario = scenarios.bare("process", base_document("none"), registry=Registry())
    steps = replace(onboard_steps(scenario), detector=looking)
    camera = NominalCamera(
        name="other", rows=64, cols=64, focal_px=1000.0, center_row=31.5, center_col=31.5, psf_sigma_px=1.0, gain_e_adu=1.0,
        read_noise_e=3.0, saturation_adu=65535.0, full_well_e=60000.0, zero_point_e_s=None, aperture_m=0.2,
    )  # fmt: skip
    shared = {number: frozenset(others) for number, others in same.items()}
    chain = CountingChain(OnboardOptions(), steps, camera=camera, run_id=1, same_exposure=shared)
    sequence = FrameSequence(chain=chain, state=chain.initial_state())
    results = []
    pixels = np.zeros(SHAPE, np.uint16)
    for number in range(6):
        if number != 1 or 1 not in shared:  # of two files with the same pixels, both are looked at
            pixels = rng.normal(1000.0, 30.0, SHAPE).astype(np.uint16)
        header = FrameHeader(
            frame=number, t_start_tai_ns=number * 10**9, exposure_ns=10**8, line_time_ns=0, rows=64, cols=64, gain_e_adu=1.0
        )
        results += sequence.take(Frame(header=header, pixels=pixels))
    results += sequence.flush()
    assert looking.seen == held_against
    assert [bool(each.housekeeping.flags & FrameFlag.REPEATED_FRAME) for each in results] == [
        number == 1 and 1 in shared for number in range(6)
    ]
