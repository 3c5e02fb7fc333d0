"""The exam asks how well a step does: who finds nothing, measures nothing or changes values fails, and the rest is scored."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ground.photometry.zero_point import ZeroPoint
from ground.streaks.fit_record import failed_fit
from ground.streaks.fitter import TrailedPsfFitter
from onboard.detect.line_integral.detector import LineIntegralDetector
from onboard.downlink.codec.planes import PlanesCodec
from sboc_e2e.checks import TRIALS, examine
from sboc_e2e.cli.main import run
from sboc_e2e.exams import codec, detector, fitter, ground_steps
from sboc_e2e.exams.trails import trail
from sboc_e2e.exams.verdict import Verdict
from sboc_e2e.icd.products import PhotometricSolution
from sboc_e2e.registry import SEAMS, Registry
from sboc_e2e.score.evaluation import SHIPPED_DECODERS


@dataclass(frozen=True, kw_only=True)
class Blind:
    history_frames: int = 0

    def detect(self, view: Any) -> tuple[Any, ...]:
        return ()


class GivesUp:
    def fit(self, pixels: Any, detection: Any) -> Any:
        return failed_fit(detection, pixels, "gives up on every trail")


class Careless:
    number, lossless = 200, True

    def encode(self, values_adu: Any, *, level_adu: int, sigma_adu: float) -> bytes:
        return np.ascontiguousarray(values_adu // 2, dtype="<i4").tobytes()

    def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> Any:
        return 2 * np.frombuffer(block, dtype="<i4").astype(np.int32).reshape(shape)


def test_trails_have_the_stated_signal_to_noise() -> None:
    for length_px, snr in ((6.0, 8.0), (100.0, 60.0)):
        each = trail((100.0, 100.0), length_px, 20.0, snr, (200, 200), 3.0)
        assert np.sqrt((each.light_e**2 / 3.0**2).sum()) == pytest.approx(snr)


def test_a_detector_that_finds_nothing_fails() -> None:
    (verdict,) = detector.finding(Blind())
    assert not verdict.passed
    assert verdict.detail.startswith("found none of 48 trails, 0  [0, 0.2496] false per frame")


def test_the_default_detector_is_scored() -> None:
    (verdict,) = detector.finding(LineIntegralDetector())
    assert verdict.passed
    found = re.findall(r"(\d+) of 12 at", verdict.detail)
    assert len(found) == 4
    assert min(int(n) for n in found[1:]) >= 9
    assert "completeness 0." in verdict.detail
    assert "false per frame" in verdict.detail


def test_a_fitter_is_run_on_trails() -> None:
    verdict = next(fitter.questions(GivesUp().fit))
    assert (verdict.passed, verdict.detail) == (False, "measured none of 48 trails within 2 px")
    verdict = next(fitter.questions(TrailedPsfFitter().fit))
    assert verdict.passed
    near, width = re.match(r"(\d+) of 48 within 2 px; pulls across ([0-9.]+)", verdict.detail).groups()  # type: ignore[union-attr]
    assert int(near) >= 45
    assert 0.6 < float(width) < 1.5


def test_a_codec_is_run_there_and_back() -> None:
    verdicts = {v.question: v for v in codec.round_trip(Careless(), Careless())}
    assert "says that it is lossless" in verdicts["noise comes back as the same integers"].detail
    (planes,) = [d for d in SHIPPED_DECODERS if d.number == PlanesCodec().number]
    verdicts = {v.question: v for v in codec.round_trip(PlanesCodec(), planes)}
    assert all(v.passed for v in verdicts.values())
    assert "bits per pixel" in verdicts["noise comes back as the same integers"].detail


def test_the_time_limit_follows_the_frame(capsys: pytest.CaptureFixture[str]) -> None:
    _, verdicts = examine("onboard.stars.matched:MatchedStars", Registry(), None, (256, 512))
    assert any(v.question.startswith("takes less than 1.31 s for 256 x 512 pixels") for v in verdicts)
    assert run(["check", "onboard.stars.matched:MatchedStars", "--shape", "10x10"]) == 2
    assert "--shape: expected ROWSxCOLS" in capsys.readouterr().err
    assert run(["check", "onboard.stars.matched:MatchedStars", "--shape", "²²²²x1024"]) == 2
    assert '--shape: expected ROWSxCOLS from 256x256 to 16384x16384, such as 4096x4096, got "²²²²x' in capsys.readouterr().err


def test_no_seam_is_without_a_trial() -> None:
    assert set(TRIALS) == set(SEAMS)


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """Answers every ground seam that judges, and none by the contract."""

    def probability(self, fits: Any, frame: Any) -> Any:
        return np.full(len(fits), 1.5)

    def calibrate(self, frame: Any, solution: Any, calibration: Any) -> Any:
        return PhotometricSolution(
            frame=frame.header.frame, zero_point_mag=20.0, zero_point_err_mag=0.01, colour_term=0.0, n_stars=9, rms_mag=0.01
        )

    def estimate(self, tracklet: Any, headers: Any) -> Any:
        return "an orbit"


@pytest.mark.parametrize(
    ("questions", "words"),
    [
        (ground_steps.vetter_questions, "expected 8 probabilities from 0 to 1"),
        (ground_steps.photometer_questions, "is off by -1.680 mag"),
        (ground_steps.orbit_questions, "returned a str, expected an OrbitEstimate"),
    ],
)
def test_a_step_that_breaks_its_contract_fails(questions: Callable[[Any], Iterator[Verdict]], words: str) -> None:
    first = next(questions(Wrong()))
    assert not first.passed
    assert words in first.detail


@pytest.mark.parametrize(
    "path",
    ["ground.vetting.likelihood:LikelihoodVetter", "ground.photometry.zero_point:ZeroPoint", "ground.orbit.range_scan:RangeScan"],
)
def test_steps_that_judge_on_ground_are_called(path: str) -> None:
    _, verdicts = examine(path, Registry())
    assert len(verdicts) >= 6
    assert all(v.passed for v in verdicts), verdicts


def test_the_zero_point_of_the_trial_is_found() -> None:
    """mag 21.6802 = 2.5 log10(4.7e8)"""
    verdict = next(ground_steps.photometer_questions(ZeroPoint()))
    assert verdict.passed
    assert abs(float(verdict.detail.split()[2])) < 0.002
