"""Whose results a folder holds, what tasks share, and what is refused before the first task; runs are stood in for."""

import os
from collections.abc import Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from sboc_e2e import provenance
from sboc_e2e.campaign import CampaignResult, engine, read_campaign, run_campaign
from sboc_e2e.campaign.engine import shared_frames
from sboc_e2e.campaign.resolve import Plan
from sboc_e2e.campaign.worker import Job, Outcome, run_job
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from tests.campaign.test_engine import TINY

GRID = """
scenario = "smoke"
replicas = 1
[set]
frames = 2
[vary]
"onboard.detector.n_sigma" = [6.0, 7.0]
"""
BLIND = """
from dataclasses import dataclass

@dataclass(frozen=True, kw_only=True)
class Blind:
    history_frames: int = 0

    def detect(self, view):
        return ()
"""


class Here(Executor):
    """Runs at once, in this process."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except OSError as error:
            future.set_exception(error)
        return future


@pytest.fixture
def stand_in(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Jobs hand back empty shards; their labels are listed."""
    ran: list[str] = []

    def job(asked: Job) -> tuple[Outcome, ...]:
        ran.extend(f"{t.task.label}, {t.task.replica}" for t in asked.tasks)
        return tuple(Outcome(fingerprint=t.fingerprint, shard=f"# - fingerprint: {t.fingerprint}\n") for t in asked.tasks)

    @contextmanager
    def executor(workers: int, scheduler: str | None, *, here: bool = False) -> Iterator[tuple[Executor, int]]:
        yield Here(), 1

    monkeypatch.setattr(engine, "run_job", job)
    monkeypatch.setattr(engine, "executor", executor)
    return ran


def campaign_run(folder: Path, text: str, *, force: bool = False, registry: Registry | None = None) -> CampaignResult:
    path = folder / "campaign.toml"
    path.write_text(text)
    return run_campaign(read_campaign(path), folder / "out", workers=1, force=force, registry=registry)


def test_a_folder_of_another_campaign_is_refused_with_what_differs(tmp_path: Path, stand_in: list[str]) -> None:
    campaign_run(tmp_path, GRID)
    for other, words in (
        (GRID.replace("frames = 2", "frames = 3"), r"set\.frames was 2 and is 3"),
        (GRID.replace("replicas = 1", "replicas = 1\nseed = 4"), "seed was 1 and is 4"),
        (GRID.replace("replicas = 1", "replicas = 1\npaired = false"), "paired was True and is False"),
        (GRID.replace('"smoke"', '"sso_antisun"'), r"scenario\.\S+ (was|is)"),
    ):
        with pytest.raises(UserError, match=words) as caught:
            campaign_run(tmp_path, other)
        assert "--force" in str(caught.value)
        assert "\n" not in str(caught.value)
    assert campaign_run(tmp_path, GRID).skipped == 2
    assert campaign_run(tmp_path, GRID.replace("frames = 2", "frames = 3"), force=True).done == 2


def test_points_and_replicas_may_be_added_in_any_order(tmp_path: Path, stand_in: list[str]) -> None:
    """A shard belongs to its task, whatever number that has: no seed is counted twice."""
    campaign_run(tmp_path, GRID)
    more = GRID.replace("replicas = 1", "replicas = 2").replace("[6.0, 7.0]", "[5.0, 7.0, 6.0]")
    stand_in.clear()
    result = campaign_run(tmp_path, more)
    assert (result.skipped, result.done) == (2, 4)
    assert sorted(stand_in) == [f"onboard.detector.n_sigma = {s}, {r}" for s, r in ((5.0, 0), (5.0, 1), (6.0, 1), (7.0, 1))]
    assert len(set(result.shards)) == 6
    assert len(campaign_run(tmp_path, GRID).shards) == 2


def test_shards_of_other_code_or_of_nobody_are_refused(
    tmp_path: Path, stand_in: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign_run(tmp_path, GRID)
    with monkeypatch.context() as patched:
        patched.setattr(provenance, "code_digest", lambda stage: "other")
        with pytest.raises(UserError, match=r"code was .* and is 'other'"):
            campaign_run(tmp_path, GRID)
    (tmp_path / "out" / "identity.json").unlink()
    with pytest.raises(UserError, match="unknown campaign"):
        campaign_run(tmp_path, GRID)


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("name", ["work/thesis.tex", "failed/notes.txt", "shards/pottery.jpg", "identity.json"])
def test_files_of_a_stranger_stay(tmp_path: Path, stand_in: list[str], name: str, force: bool) -> None:
    """A folder is a campaign's by its identity, not by what its folders are called."""
    own = tmp_path / "out" / name
    own.parent.mkdir(parents=True)
    own.write_text('{"name": "somebody"}')
    with pytest.raises(UserError, match="--out goes elsewhere") as caught:
        campaign_run(tmp_path, GRID, force=force)
    assert "\n" not in str(caught.value)
    assert own.read_text() == '{"name": "somebody"}'
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == [own]
    assert stand_in == []


def test_a_campaign_killed_at_its_start_goes_on(tmp_path: Path, stand_in: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its identity is there before its folders are, so that half-made ones are known."""

    def killed(folder: Path) -> None:
        folder.mkdir(parents=True)
        (folder / ".writable").touch()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(engine, "require_writable", killed)
        with pytest.raises(KeyboardInterrupt):
            campaign_run(tmp_path, GRID)
    assert campaign_run(tmp_path, GRID).done == 2


def test_a_shard_under_another_name_is_refused(tmp_path: Path, stand_in: list[str]) -> None:
    one, other = campaign_run(tmp_path, GRID).shards
    one.replace(other)
    with pytest.raises(UserError, match="result of another task"):
        campaign_run(tmp_path, GRID)


def test_results_of_an_edited_plugin_are_refused(tmp_path: Path, stand_in: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    record = {"distribution": "none", "file_sha256": "a", "source_sha256": "a"}
    monkeypatch.setattr(provenance, "plugin", lambda kind: record if kind.__name__ == "LsdDetector" else None)
    text = GRID.replace('"onboard.detector.n_sigma" = [6.0, 7.0]', '"onboard.detector.use" = ["line_integral", "lsd"]')
    campaign_run(tmp_path, text)
    record = record | {"source_sha256": "b"}
    with pytest.raises(UserError, match=r"plugins\.onboard\.detect\.peers\.lsd:LsdDetector\.source_sha256 was 'a' and is 'b'"):
        campaign_run(tmp_path, text)
    assert campaign_run(tmp_path, text.replace(', "lsd"', "")).skipped == 1


def test_a_plugin_of_a_campaign_is_loaded_when_it_is_trusted(
    tmp_path: Path, stand_in: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a scenario: ``--plugin``, and not what somebody else's file says, lets code run; its edit makes another campaign."""
    (tmp_path / "swept_lab.py").write_text(BLIND)
    monkeypatch.syspath_prepend(str(tmp_path))
    text = GRID.replace("detector.n_sigma", "detector.use").replace("[6.0, 7.0]", '["line_integral", "swept_lab:Blind"]')
    result = campaign_run(tmp_path, text)
    assert "--plugin swept_lab" in result.failed[0][1]
    assert result.done == 1
    result = campaign_run(tmp_path, text, registry=Registry(trusted_modules=("swept_lab",)))
    assert (result.done, result.skipped, result.failed) == (1, 1, ())


def test_a_misspelt_key_is_refused_before_the_first_task(tmp_path: Path, stand_in: list[str]) -> None:
    for text in (GRID.replace("detector.n_sigma", "detector.n_sgima"), GRID.replace("frames = 2", "framse = 2")):
        with pytest.raises(UserError, match="did you mean") as caught:
            campaign_run(tmp_path, text)
        assert "--set" not in str(caught.value)
    assert not (tmp_path / "out").exists()
    assert stand_in == []


def test_a_value_that_one_point_cannot_have_is_listed_without_a_run(tmp_path: Path, stand_in: list[str]) -> None:
    result = campaign_run(tmp_path, GRID.replace("[6.0, 7.0]", "[-6.0, 7.0]"))
    assert result.done == 1
    assert len(stand_in) == 1
    assert "n_sigma" in result.failed[0][1]


def test_done_means_that_the_shard_is_there(tmp_path: Path, stand_in: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "run_job", lambda job: ())
    result = campaign_run(tmp_path, GRID)
    assert (result.done, len(result.failed), result.shards) == (0, 2, ())


@pytest.mark.parametrize(
    ("vary", "frames", "downlinks"),
    [
        ('"onboard.detector.n_sigma" = [6.0, 7.0, 8.0]', 1, 3),
        ('"ground.vetter.real_per_frame" = [0.3, 0.5, 0.7]', 1, 1),
        ('"instrument.aperture" = ["3 cm", "4 cm", "5 cm"]', 3, 3),
        ('"faults.frames.dropped" = [0.0, 0.1, 0.2]', 1, 3),
    ],
)
def test_points_that_differ_after_the_simulator_share_its_frames(tmp_path: Path, vary: str, frames: int, downlinks: int) -> None:
    path = tmp_path / "campaign.toml"
    path.write_text(GRID.replace('"onboard.detector.n_sigma" = [6.0, 7.0]', vary))
    tasks = Plan.of(read_campaign(path), Registry()).resolve().standing
    assert len(tasks) == 3
    assert len({t.frames for t in tasks}) == frames
    assert len({t.downlink for t in tasks}) == downlinks
    assert len(shared_frames(tasks, slots=1)) == frames
    assert len(shared_frames(tasks, slots=3)) == 3


@pytest.mark.slow
def test_sharing_frames_changes_no_result(tmp_path: Path) -> None:
    """The same shards from one job of four tasks, which simulates once, and from four that each simulate."""
    path = tmp_path / "campaign.toml"
    path.write_text(GRID + TINY + '"ground.vetter.real_per_frame" = [0.3, 0.7]\n')
    plan = Plan.of(read_campaign(path), Registry())
    tasks = plan.resolve().standing
    surroundings = plan.surroundings(tasks[0].task)
    together = run_job(Job(plan=plan, tasks=tuple(tasks), surroundings=surroundings, out=None))
    alone = [run_job(Job(plan=plan, tasks=(task,), surroundings=surroundings, out=None))[0] for task in tasks]
    assert [outcome.shard for outcome in together] == [outcome.shard for outcome in alone]
    assert all(outcome.shard for outcome in together), together


@pytest.mark.slow
def test_a_cluster_in_another_folder_fills_a_relative_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers elsewhere send their shards back; nothing is left where they run, and one with other sources is refused."""
    distributed = pytest.importorskip("distributed", reason="the extra distributed is not installed")
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    Path("campaign.toml").write_text(GRID + TINY)
    any_port = {"dashboard_address": "127.0.0.1:0"}
    cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None, scheduler_kwargs=any_port)
    with cluster, distributed.Client(cluster) as client:
        client.run(os.chdir, str(tmp_path / "there"))
        result = run_campaign(read_campaign("campaign.toml"), Path("out"), scheduler=cluster.scheduler_address)
    assert (result.done, result.failed) == (2, ())
    assert len(list(Path("out/shards").glob("*.ecsv"))) == 2
    assert list((tmp_path / "there").iterdir()) == []


def test_a_worker_with_other_sources_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "campaign.toml"
    path.write_text(GRID)
    plan = Plan.of(read_campaign(path), Registry())
    task = plan.resolve().standing[0]
    surroundings = plan.surroundings(task.task) | {"code": "another"}
    asked = Job(plan=plan, tasks=(engine.Resolved(task=task.task, fingerprint="another", frames="", downlink=""),),
                surroundings=surroundings, out=None)  # fmt: skip
    (outcome,) = run_job(asked)
    assert "not what the campaign was started with: code was 'another'" in outcome.reason
