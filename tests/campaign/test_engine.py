"""Campaigns run, resume, list failures, and give the same bytes whatever the workers and interruptions."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.campaign import Campaign, read_campaign, run_campaign
from sboc_e2e.campaign.aggregate import read_shards, summarise
from sboc_e2e.campaign.engine import failure_path
from sboc_e2e.campaign.pages import write_results
from sboc_e2e.campaign.resolve import Plan
from sboc_e2e.campaign.worker import shard_file
from sboc_e2e.cli.main import run
from sboc_e2e.registry import Registry
from sboc_e2e.scenario.toml_files import FOLDER
from tests.processes import wait_for

TEXT = """
scenario = "smoke"
replicas = 1
[set]
frames = 1
[vary]
"onboard.detector.n_sigma" = [7.0, 9.0]
"instrument.aperture" = ["4 cm", "-4 cm"]
"""

TINY = """
"instrument.rows" = [128]
"instrument.cols" = [128]
"instrument.pixel" = ["144 um"]
"population.candidates" = [2000]
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    path = tmp_path_factory.mktemp("campaign") / "small.toml"
    path.write_text(TEXT)
    return read_campaign(path)


@pytest.fixture(scope="module")
def finished(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out")
    result = run_campaign(campaign, out, workers=1)
    assert result.done == 2
    assert len(result.failed) == 2
    write_results(campaign, result, out)
    return out


def shards(campaign: Campaign, out: Path) -> dict[int, bytes]:
    standing = Plan.of(campaign, Registry()).resolve().standing
    files = {t.task.number: shard_file(out, t.fingerprint) for t in standing}
    return {number: path.read_bytes() for number, path in files.items() if path.is_file()}


@pytest.mark.slow
def test_failed_tasks_are_listed_with_their_reason_and_the_rest_is_done(campaign: Campaign, finished: Path) -> None:
    failures = [failure_path(finished, t).read_text() for t in campaign.tasks() if failure_path(finished, t).is_file()]
    assert len(failures) == 2
    assert all("instrument.aperture" in text and "20 m" in text for text in failures)
    assert "failed" in (finished / "campaign.md").read_text()
    assert "<h2>Failed tasks</h2>" in (finished / "campaign.html").read_text()
    assert not any((finished / "work").iterdir())


@pytest.mark.slow
def test_finished_tasks_are_not_run_again(campaign: Campaign, finished: Path) -> None:
    before = {p: p.stat().st_mtime_ns for p in (finished / "shards").iterdir()}
    result = run_campaign(campaign, finished, workers=1)
    assert result.skipped == 2
    assert {p: p.stat().st_mtime_ns for p in (finished / "shards").iterdir()} == before


@pytest.mark.slow
def test_two_workers_give_the_same_bytes(campaign: Campaign, finished: Path, tmp_path: Path) -> None:
    run_campaign(campaign, tmp_path, workers=2)
    assert shards(campaign, tmp_path) == shards(campaign, finished)


@pytest.mark.slow
def test_dask_gives_the_same_bytes(campaign: Campaign, finished: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra distributed is not installed")
    run_campaign(campaign, tmp_path, workers=1, scheduler="local")
    assert shards(campaign, tmp_path) == shards(campaign, finished)


@pytest.mark.slow
def test_a_sweep_killed_at_twenty_points_ends_with_the_same_bytes(tmp_path: Path) -> None:
    """Twenty kills at random moments, each followed by going on in the same folder; a finished sweep is begun anew."""
    path = tmp_path / "tiny.toml"
    path.write_text(TEXT + TINY)
    campaign = read_campaign(path)
    run_campaign(campaign, tmp_path / "undisturbed", workers=1)
    expected = shards(campaign, tmp_path / "undisturbed")
    assert len(expected) == 2
    delays_s = np.random.default_rng(20).uniform(0.0, 6.0, size=200)
    kills = finished = 0
    for attempt, delay_s in enumerate(delays_s):
        out = tmp_path / f"killed-{finished}"
        command = [sys.executable, "-m", "sboc_e2e", "sweep", str(path), "--out", str(out), "--workers", str(1 + attempt % 2)]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        wait_for(out / "work", child)
        with suppress(subprocess.TimeoutExpired):
            child.wait(delay_s)
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            kills += 1
        child.wait()
        if kills == 20 or child.returncode >= 0:
            run_campaign(campaign, out, workers=1)
            assert shards(campaign, out) == expected
            assert not [leftover for leftover in out.rglob("*") if leftover.suffix == ".part"]
            assert not any((out / "work").iterdir())
            finished += 1
        if kills == 20:
            break
    assert kills == 20


@pytest.mark.slow
def test_aggregates_count_every_streak(campaign: Campaign, finished: Path) -> None:
    points = read_shards(sorted((finished / "shards").iterdir()))
    assert len(points) == 2
    for tables in points.values():
        summary = summarise(tables)
        assert summary["frames"] == 1
        counted = sum(int((t["snr"] >= 8.0).sum()) for t in tables)
        assert summary["completeness_snr8"]["n"] == counted


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((FOLDER / "campaigns").glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_campaigns_run_in_a_reduced_form(path: Path, tmp_path: Path) -> None:
    """Every point of each shipped campaign once, on two frames: shards, table, pictures over the varied keys."""
    assert run(["sweep", str(path), "--set", "frames=2", "--replicas", "1", "--workers", "2", "--out", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "campaign.json").read_text())
    plan = read_campaign(path)
    assert len(result["points"]) == len(plan.tasks()) // plan.replicas
    assert result["failed"] == []
    page = (tmp_path / "campaign.html").read_text()
    assert page.count("<svg") >= 1 + len(result["points"])
    assert all(point["frames"] == 2 for point in result["points"].values())
