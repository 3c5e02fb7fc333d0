"""The published detectors behind the same Protocol: each finds what its paper says it finds, and survives bad frames."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from onboard.detect import (
    BoundaryTensorDetector,
    DifferenceDetector,
    HoughDetector,
    LsdDetector,
    SegmentationDetector,
    ThresholdDetector,
    components,
)
from onboard.detect.peers import boundary_tensor
from onboard.image.registration import apply, register
from sboc_e2e.icd.signals import DetectorView, StarList
from sboc_e2e.icd.steps import Detector
from tests.benchmarks.bench_detection import matches
from tests.benchmarks.detection_frames import Scene, Streak, add_streak, exposure, random_stars, view_of

ALL = (
    DifferenceDetector(), BoundaryTensorDetector(), ThresholdDetector(), LsdDetector(), HoughDetector(), SegmentationDetector()
)  # fmt: skip
NAMES = tuple(type(detector).__name__ for detector in ALL)


def field(seed: int, streaks: list[Streak]) -> DetectorView:
    """A 768 px star field with streaks, the frame before in its history."""
    rng = np.random.default_rng(seed)
    stars = random_stars(768, 25_000, rng)
    before = view_of(exposure(768, stars, rng, shift_px=(0.6, -0.8)))
    scene = exposure(768, stars, rng)
    for streak in streaks:
        add_streak(scene, streak, rng)
    return view_of(scene, frame=1, history=(before,))


@pytest.mark.parametrize("detector", ALL, ids=NAMES)
def test_bright_streak_is_found_by_all(detector: Detector) -> None:
    assert isinstance(detector, Detector)
    truth = Streak(row0=150.0, col0=120.0, row1=480.0, col1=560.0, snr=400.0)
    view = field(1, [truth])
    found = detector.detect(view)
    assert sum(matches(d, truth) for d in found) == 1
    assert found == detector.detect(view)
    assert all(0.0 <= d.row0 <= 767.0 and 0.0 <= d.col1 <= 767.0 for d in found)


@pytest.mark.parametrize("detector", [DifferenceDetector(), ThresholdDetector()], ids=["DifferenceDetector", "ThresholdDetector"])
def test_short_streak_is_found(detector: Detector) -> None:
    truth = Streak(row0=300.0, col0=200.0, row1=312.0, col1=216.0, snr=60.0)
    assert sum(matches(d, truth) for d in detector.detect(field(2, [truth]))) == 1


@pytest.mark.parametrize("detector", ALL, ids=NAMES)
@pytest.mark.parametrize("value", [0.0, 100.0])
@pytest.mark.parametrize("shape", [(5, 9), (64, 64), (101, 77)])
def test_even_frames_give_nothing(detector: Detector, value: float, shape: tuple[int, int]) -> None:
    """Dark, or every pixel far above the threshold: an even sky that the background missed holds no streak."""
    view = view_of(Scene(image=np.full(shape, value, np.float32)))
    assert detector.detect(replace(view, history=(view,))) == ()
    assert detector.detect(replace(view, history=())) == ()


def test_difference_needs_a_frame_before() -> None:
    view = field(3, [Streak(row0=100.0, col0=100.0, row1=300.0, col1=300.0, snr=300.0)])
    assert DifferenceDetector().detect(replace(view, history=())) == ()


def test_boundary_tensor_of_an_edge_and_a_line_has_one_response() -> None:
    """Köthe 2003: the energy of a step edge and of a line both peak at the feature itself, and both are line-like there."""
    col = np.arange(64, dtype=np.float64)
    for profile in (0.5 * (1.0 + erf((col - 32.0) / 1.5)), np.exp(-0.5 * ((col - 32.0) / 1.2) ** 2)):
        rr, rc, cc = boundary_tensor.boundary_tensor(np.tile(profile, (64, 1)).astype(np.float32), 1.5)
        energy = (rr + cc)[32]
        assert abs(int(np.argmax(energy[10:54])) + 10 - 32) <= 0.5
        assert rr[32, 32] < 1e-6 * cc[32, 32]
        assert abs(rc[32, 32]) < 1e-6 * cc[32, 32]


def test_quadrature_weights_follow_the_absolute_value_of_the_frequency() -> None:
    """a + b w^2 stays within 20 % of |w| where the filter has its power (0.7/s to 2/s)."""
    a, b = boundary_tensor.quadrature_weights(2.0)
    w = np.linspace(0.35, 1.0, 50)
    assert np.abs((a + b * w * w) / w - 1.0).max() < 0.2


def test_registration_recovers_shift_and_rotation() -> None:
    rng = np.random.default_rng(4)
    points = rng.uniform(0.0, 2000.0, (400, 2))
    angle, shift = 1e-3, np.array([37.3, -12.8])
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    moved = (points - 1000.0) @ turn.T + 1000.0 + shift + rng.normal(0.0, 0.05, points.shape)

    def stars(place: np.ndarray) -> StarList:
        n = len(place)
        return StarList(
            row=place[:, 0], col=place[:, 1], flux_e=np.arange(n, 0, -1), snr=np.full(n, 20.0), flags=np.zeros(n, np.uint8)
        )

    transform = register(stars(points), stars(moved[rng.permutation(400)[:380]]), reach_px=100.0)
    assert transform is not None
    assert np.abs(apply(transform, points) - moved).mean() < 0.06
    assert register(StarList.empty(), stars(points), reach_px=100.0) is None


def test_moments_of_a_bar_give_its_length() -> None:
    above = np.zeros((60, 60), bool)
    above[30:32, 10:50] = True
    ends = components.elongated_components(above, min_length_px=10.0, min_axis_ratio=3.0)
    assert ends.shape == (1, 4)
    assert math.hypot(ends[0, 2] - ends[0, 0], ends[0, 3] - ends[0, 1]) == pytest.approx(40.0, abs=0.1)
    assert (ends[0, 0] + ends[0, 2]) / 2 == pytest.approx(30.5)


def test_collinear_pieces_are_joined_and_parallel_ones_are_not() -> None:
    pieces = np.array([[10.0, 10.0, 10.0, 60.0], [10.5, 75.0, 10.2, 120.0], [30.0, 10.0, 30.0, 60.0]])
    joined = components.join_collinear(pieces, gap_px=20.0, across_px=2.0)
    assert len(joined) == 2
    assert max(math.hypot(s[2] - s[0], s[3] - s[1]) for s in joined) == pytest.approx(110.0, abs=0.5)
