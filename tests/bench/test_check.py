"""`sboc bench --check` from outside: exit codes and lines for an equal and for a worse report; costs said before."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from sboc_e2e.bench.baseline import MACHINE_SHARE, read_baseline, write_baseline
from sboc_e2e.bench.entries import Entry
from sboc_e2e.bench.parts import Part, cost_words, expected_costs, parts
from sboc_e2e.bench.run_bench import baseline_file
from sboc_e2e.cli.main import run
from sboc_e2e.icd.errors import UserError

FIGURES = (
    Entry(name="smoke.detection.ground.completeness_snr8", value=0.95, n=200, low=0.92, high=0.97),
    Entry(name="smoke.detection.ground.false_per_frame", value=0.1, n=60, low=0.03, high=0.2),
    Entry(name="smoke.timing.onboard_cpu_s_per_frame", value=0.05, n=6, low=0.05, high=0.05),
)


def stored(path: Path, figures: list[dict[str, Any]]) -> Path:
    path.write_text(json.dumps({"environment": {"quick": True}, "figures": figures}))
    return path


@pytest.fixture
def baseline(tmp_path: Path) -> Path:
    path = tmp_path / "baseline.json"
    write_baseline(path, FIGURES)
    return path


def test_the_same_measurement_passes(tmp_path: Path, baseline: Path, capfd: pytest.CaptureFixture[str]) -> None:
    report = stored(tmp_path / "report.json", [vars(f) for f in FIGURES])
    assert run(["bench", "--check", "--report", str(report), "--baseline", str(baseline)]) == 0
    assert "regression" not in capfd.readouterr().err


def test_a_worse_report_fails_with_one_line_for_each_figure(
    tmp_path: Path, baseline: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    worse = {"completeness_snr8": 0.7, "false_per_frame": 2.0, "onboard_cpu_s_per_frame": 0.2}
    figures = [vars(f) | {"value": worse[f.name.rpartition(".")[2]]} for f in FIGURES]
    report = stored(tmp_path / "report.json", figures)
    assert run(["bench", "--check", "--report", str(report), "--baseline", str(baseline)]) == 1
    lines = capfd.readouterr().err.splitlines()
    assert [line.split(":")[1].strip() for line in lines] == [f.name for f in FIGURES]
    assert all(line.startswith("regression: ") and "baseline has" in line for line in lines)


def test_what_is_no_report_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "broken.json").write_text("{}")
    assert run(["bench", "--check", "--report", str(tmp_path / "broken.json")]) == 2
    assert run(["bench", "--only", "nothing"]) == 2
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "not a report.json" in lines[0]
    assert "known: smoke" in lines[1]


def test_a_part_that_fails_is_named_and_the_report_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def broken(part: Part, out: Path) -> dict[str, Any]:
        if part.name == "orbit":
            raise UserError("benchmark orbit failed with exit code 1: NameError")
        return {"rms_px": 1.0}

    bench = sys.modules["sboc_e2e.bench.run_bench"]
    monkeypatch.setattr(bench, "_run_script", broken)
    monkeypatch.setattr(bench, "_child", lambda arguments, what: None)  # no warm-up
    assert run(["bench", "--quick", "--only", "orbit", "--only", "vetting", "--out", str(tmp_path)]) == 2
    assert "parts that failed: orbit" in capfd.readouterr().err
    figures = {f["name"]: f for f in json.loads((tmp_path / "report.json").read_text())["figures"]}
    assert "NameError" in figures["orbit"]["reason"]
    assert figures["vetting.rms_px"]["value"] == 1.0


def test_the_committed_baseline_is_of_parts_that_exist() -> None:
    names = {part.name for part in parts(quick=True, peers=True)}
    assert {figure.partition(".")[0] for figure in read_baseline(baseline_file(quick=True))} <= names


def test_cost_is_said_in_words() -> None:
    wanted = parts(quick=True, peers=False)
    costs = dict.fromkeys((part.name for part in wanted), 60.0)
    alone = sum(part.alone for part in wanted)
    assert f"about {alone + (len(wanted) - alone) / 2:.0f} minutes" in cost_words(costs, wanted, 2)
    assert "not timed yet: orbit" in cost_words(costs | {"orbit": None}, wanted, 2)
    assert expected_costs(wanted, quick=True).keys() == costs.keys()


@pytest.mark.slow
def test_a_part_measured_twice_does_not_regress(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same code and seeds measured twice: what is not timed repeats exactly. How timings scatter is the machine's affair."""
    out, module = tmp_path / "out", sys.modules[baseline_file.__module__]
    child = module._child
    # what is not compiled is compiled when the part needs it: a run of `smoke` beforehand is for timings
    monkeypatch.setattr(module, "_child", lambda command, what: None if what == "warm-up" else child(command, what))

    def measured() -> list[Entry]:
        assert run(["bench", "--quick", "--only", "detection", "--out", str(out)]) == 0
        figures = json.loads((out / "report.json").read_text())["figures"]
        entries = [Entry(**{k: v for k, v in f.items() if k not in ("better", "unit")}) for f in figures]
        return [e for e in entries if e.unit not in MACHINE_SHARE]

    first = measured()
    assert "1 parts" in capfd.readouterr().out
    write_baseline(tmp_path / "first.json", first)
    assert len(read_baseline(tmp_path / "first.json")) > 5
    assert measured() == first
    assert run(["bench", "--check", "--report", str(out / "report.json"), "--baseline", str(tmp_path / "first.json")]) == 0
    assert len((out / "history.jsonl").read_text().splitlines()) == 2
