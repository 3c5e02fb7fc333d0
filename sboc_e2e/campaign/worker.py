"""One task of a campaign: run, evaluate, leave a shard. Everything a worker process does."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
from astropy.table import Table

from sboc_e2e.campaign.plan import Campaign, Task
from sboc_e2e.files.atomic import write_text
from sboc_e2e.registry import Registry
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.scenario import load
from sboc_e2e.score.evaluation import Evaluation, evaluate
from sboc_e2e.score.linking import linking
from sboc_e2e.score.recovery import counted, field_deg


def overrides(campaign: Campaign, task: Task) -> list[str]:
    """The ``key=value`` texts that turn the campaign's scenario into the task's."""
    values = campaign.constant | dict(task.point)
    return [f"{key}={value if isinstance(value, str) else json.dumps(value)}" for key, value in values.items()]


def run_task(campaign: Campaign, task: Task, out: str) -> None:
    """Run a task in a folder of its own and write its shard; the folder is removed, the shard appears at once or never."""
    folder = Path(out) / "work" / f"{task.number:06d}"
    shutil.rmtree(folder, ignore_errors=True)
    scenario = load(campaign.scenario, registry=Registry(), overrides=overrides(campaign, task), seed=task.seed)
    try:
        run = begin_or_continue(folder, scenario, workers=1)
        run.simulate_and_onboard()
        run.ground()
        table = shard(evaluate(folder), task)
        text = io.StringIO()
        table.write(text, format="ascii.ecsv")
        write_text(Path(out) / "shards" / f"{task.number:06d}.ecsv", text.getvalue())
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def shard(e: Evaluation, task: Task) -> Table:
    """Truth streaks of a task with what became of them; the metadata carries the point and the counts of the run.

    No timing is kept, so that the same task gives the same bytes.
    """
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
        "found": [int(o["object_id"]) in found for o in objects if str(o["kind"]) == "population"],
        "counted": counted(objects, e.streaks, e.orbits, e.pairs, owner, e.n_frames).as_lists(),
    }
    return table
