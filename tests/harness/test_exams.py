"""The exam asks how well a step does: who finds nothing, measures nothing or changes values fails, and the rest is scored."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from ground.streaks.fit_record import failed_fit
from ground.streaks.fitter import TrailedPsfFitter
from onboard.detect.line_integral.detector import LineIntegralDetector
from onboard.downlink.codec.planes import PlanesCodec
from sboc_e2e.checks import examine
from sboc_e2e.cli.main import run
from sboc_e2e.exams import codec, detector, fitter
from sboc_e2e.exams.trails import trail
from sboc_e2e.registry import Registry
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
