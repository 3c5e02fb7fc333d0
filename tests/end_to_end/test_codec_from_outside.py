"""A codec from outside is scored with its decoder; without one nothing runs, and a downlink that nobody reads says so."""

import importlib
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ground.ingest import decode_downlink
from sboc_e2e import scenario
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.report.write import write_report
from sboc_e2e.run import RunRequest, run
from sboc_e2e.run.pipeline import Run
from sboc_e2e.scenario import Scenario
from sboc_e2e.score import score_evaluation
from sboc_e2e.score.evaluation import SHIPPED_DECODERS, evaluate
from tests.end_to_end.conftest import tiny

CODEC = """
from dataclasses import dataclass

import numpy as np

@dataclass(frozen=True, kw_only=True)
class Little:
    number: int = 200
    lossless: bool = True

    def encode(self, values_adu, *, level_adu, sigma_adu):
        return np.ascontiguousarray(values_adu, dtype="<i4").tobytes()
"""
DECODER = """
@dataclass(frozen=True, kw_only=True)
class LittleDecoder:
    number: int = 200

    def decode(self, block, shape, *, level_adu, sigma_adu):
        return np.frombuffer(block, dtype="<i4").astype(np.int32).reshape(shape)
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A codec with its decoder in one module, and the same one without in another."""
    (tmp_path / "little_codec.py").write_text(CODEC + DECODER)
    (tmp_path / "lone_codec.py").write_text(CODEC)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    yield tmp_path
    for name in ("little_codec", "lone_codec"):
        sys.modules.pop(name, None)


def with_codec(folder: Path, name: str) -> Scenario:
    return scenario.load(str(tiny(folder)), registry=Registry(), use={"onboard.codec": name})


@pytest.mark.slow
def test_a_codec_from_outside_is_scored_with_its_decoder(lab: Path) -> None:
    """The same regions as with the shipped codec of the same length, seen on board and on ground; also stage by stage."""
    scores = {}
    for name in ("raw", "little_codec:Little"):
        out = lab / name.partition(":")[0]
        made = run(RunRequest(scenario=with_codec(lab, name), out=out, workers=1))
        scores[name] = json.loads((out / "score.json").read_text())
        assert scores[name]["notes"] == []
        assert made.evaluation().notes == ()
    raw, mine = scores.values()
    assert raw["detection"]["onboard"]["n_detected"]["value"] > 0
    for section in ("detection", "astrometry", "linking", "compression"):
        assert mine[section] == raw[section]
    opened = Run.open(lab / "little_codec", Registry(trusted_modules=("little_codec",)))
    opened.score()
    assert json.loads((lab / "little_codec" / "score.json").read_text())["detection"] == raw["detection"]


def test_a_codec_without_a_decoder_is_refused_before_any_work(lab: Path) -> None:
    with pytest.raises(UserError, match=r"lone_codec:Little writes blocks of codec number 200, which no decoder reads") as caught:
        run(RunRequest(scenario=with_codec(lab, "lone_codec:Little"), out=lab / "run", workers=1))
    assert "\n" not in str(caught.value)
    assert not (lab / "run").exists()


@pytest.mark.slow
def test_a_downlink_that_nobody_can_read_says_so_in_score_and_report(lab: Path) -> None:
    out = lab / "run"
    run(RunRequest(scenario=with_codec(lab, "little_codec:Little"), out=out, workers=1))
    unread = evaluate(out)
    (note,) = unread.notes
    assert "packets could not be decoded (no decoder for codec number 200)" in note
    _, ingest = decode_downlink((out / "downlink.bin").read_bytes(), SHIPPED_DECODERS)
    assert note.startswith(f"{ingest.n_decode_failures} packets")
    score = score_evaluation(unread, out)
    assert score["notes"] == [note]
    write_report(out, unread)
    assert note in (out / "report.md").read_text()
    assert note in (out / "report.html").read_text()
