"""What a worker process does: run the tasks that share frames, evaluate each, hand its shard back.

Nothing is asked of the worker's place: what it needs travels in the job, and what it makes travels back as text.
"""

import io
import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from astropy.table import Table

from sboc_e2e.campaign.plan import Task
from sboc_e2e.campaign.resolve import Plan, Resolved
from sboc_e2e.files.atomic import UNWRITABLE, write_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.run.manifest import first_difference
from sboc_e2e.run.pipeline import Run
from sboc_e2e.run.shared import SharedRuns
from sboc_e2e.scenario import OutputOptions, Scenario
from sboc_e2e.score.evaluation import Evaluation
from sboc_e2e.score.linking import linking
from sboc_e2e.score.recovery import counted, field_deg


@dataclass(frozen=True, kw_only=True)
class Job:
    """Tasks with the same simulated frames.

    surroundings : versions and sources of the one who asks. out : folder of the campaign where the worker shares it, else None.
    """

    plan: Plan
    tasks: tuple[Resolved, ...]
    surroundings: dict[str, Any]
    out: str | None


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a task: its shard as text, or the reason why there is none."""

    fingerprint: str
    shard: str | None = None
    reason: str = ""


def shard_file(out: Path, fingerprint: str) -> Path:
    """Result table of a task."""
    return out / "shards" / f"{fingerprint}.ecsv"


def run_job(job: Job) -> tuple[Outcome, ...]:
    """Run the tasks of a job. A task that fails reports its reason, and the others continue.

    If the worker shares the campaign's folder, each shard is in it as soon as it is made. Raises `OSError` when nothing can be
    written.
    """
    done = []
    with _folder(job) as folder:
        for task in job.tasks:
            try:
                text = _shard_of(job, task, folder)
            except Exception as error:
                if isinstance(error, OSError) and error.errno in UNWRITABLE:
                    raise
                done.append(
                    Outcome(fingerprint=task.fingerprint, reason=f"{type(error).__name__}: {error}".splitlines()[0][:500])
                )
                continue
            if job.out is not None:
                write_text(shard_file(Path(job.out), task.fingerprint), text)
            done.append(Outcome(fingerprint=task.fingerprint, shard=text))
    return tuple(done)


@contextmanager
def _folder(job: Job) -> Iterator[Path]:
    """A folder for runs that is gone afterwards: below the campaign's, or a temporary one of the worker's machine."""
    if job.out is None:
        with tempfile.TemporaryDirectory(prefix="sboc-sweep-", ignore_cleanup_errors=True) as made:
            yield Path(made)
        return
    folder = Path(job.out) / "work" / job.tasks[0].fingerprint
    shutil.rmtree(folder, ignore_errors=True)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _shard_of(job: Job, resolved: Resolved, folder: Path) -> str:
    """Run and evaluate one task."""
    task = resolved.task
    found = job.plan.scenario_of(task.point, task.seed)
    if job.plan.resolved(task, found).fingerprint != resolved.fingerprint:
        difference = first_difference(job.surroundings, job.plan.surroundings(task)) or "the same sources resolve it otherwise"
        raise UserError(f"this worker is not what the campaign was started with: {difference}")
    run = _run_shared(found, folder) if len(job.tasks) > 1 else _run_alone(found, folder)
    table = shard(run.evaluation(), resolved)
    text = io.StringIO()
    table.write(text, format="ascii.ecsv")
    return text.getvalue()


def _run_alone(found: Scenario, folder: Path) -> Run:
    """Frames are handed on without being kept."""
    run = begin_or_continue(folder, found, workers=1)
    run.simulate_and_onboard()
    run.ground()
    return run


def _run_shared(found: Scenario, folder: Path) -> Run:
    """Frames and packets stay in the folder for the next task."""
    kept = replace(found, output=OutputOptions(keep_frames_every=1))
    return SharedRuns(out=folder, workers=1).ground(kept)


def shard(e: Evaluation, resolved: Resolved) -> Table:
    """Truth streaks of a task with what became of them; the metadata carries the point and the counts of the run.

    No timing is kept, so that the same task gives the same bytes.
    """
    task: Task = resolved.task
    streaks, objects = e.truth_tables["streaks"], e.truth_tables["objects"]
    place = {int(o): i for i, o in enumerate(objects["object_id"])}
    mine = np.array([place[int(o)] for o in streaks["object_id"]], dtype=int)
    onboard, ground = e.detected_onboard, e.detected_ground
    _, owner = linking(e.streaks, e.pairs, e.n_frames)
    accepted = set(e.accepted)
    found = {truth.object_id for row, truth in e.pairs.items() if row in accepted}
    table = Table()
    for name in ("frame", "object_id", "snr", "length_px", "rate_deg_s", "range_km", "mag"):
        table[name] = np.asarray(streaks[name])
    table["size_m"] = np.asarray(objects["size_m"])[mine]
    table["weight"] = np.asarray(objects["weight"])[mine]
    table["kind"] = np.asarray(objects["kind"]).astype(str)[mine]
    table["detected_onboard"] = np.array([t.index in onboard for t in e.truth], dtype=bool)
    table["detected_ground"] = np.array([t.index in ground for t in e.truth], dtype=bool)
    table.meta = {
        "fingerprint": resolved.fingerprint,
        "frames": resolved.frames,
        "point": json.dumps(dict(task.point)),
        "replica": task.replica,
        "seed": task.seed,
        "n_frames": e.n_frames,
        "frame_rate_hz": float(e.manifest["frame_rate_hz"]),
        "n_false_onboard": len(e.footprints.false_groups),
        "n_false_ground": len(e.false_rows),
        "downlink_bytes": len(e.downlink),
        "n_objects": len(objects),
        "field_deg": field_deg(e.truth_tables["frames"]),
        "notes": list(e.notes),
        "found": [int(o["object_id"]) in found for o in objects if str(o["kind"]) == "population"],
        "counted": counted(objects, e.streaks, e.orbits, e.pairs, owner, e.n_frames).as_lists(),
    }
    return table
