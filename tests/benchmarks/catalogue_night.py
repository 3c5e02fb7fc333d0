"""One night of a catalogue of ten thousand objects: seconds of the update, associations and orbits against the truth.

Objects, forces and tracklets are those of the list simulator of the tests, which shares no code with ground. Each object has an
orbit with errors drawn from its covariance, and the store holds a history of tracklets. Run from the repository's root:

    python -m tests.benchmarks.catalogue_night                       # 10,000 objects, 1,000,000 tracklets, two processes
    python -m tests.benchmarks.catalogue_night --objects 500 --history 50000
"""

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.store.store import Association, ObjectStore, StoredOrbit, StoredTracklet
from ground.upkeep.night import update
from ground.upkeep.view import UpkeepOptions
from simulator.platform.all_forces import DAY_S, between
from tests.association.list_simulator import Survey, survey

Array = NDArray[np.float64]
DAY_NS = 86400 * 10**9
PLACE_KM, SPEED_KM_S, AREA_M2_KG = 0.5, 4e-5, 0.01
"""One sigma of the orbits before the night; of areas as the list simulator draws them about 0.02."""


def stored(one: Survey, place: int) -> StoredTracklet:
    """A tracklet of the simulator as the store has it."""
    seen = one.seen[place]
    n = len(seen.t_s)
    sigma = np.full((n, 1), one.sigma_rad)
    rows = np.hstack([seen.direction, sigma, sigma, np.full((n, 1), 0.7), seen.observer])
    epochs = one.sky.t0_tai_ns + np.round(seen.t_s * 1e9).astype(np.int64)
    return StoredTracklet(sensor="list", t_tai_ns=epochs, rows=rows)


def fill(store: ObjectStore, one: Survey, objects: int, history: int, rng: np.random.Generator) -> list[int]:
    """Objects with orbits at the start of the night, and tracklets of a hundred days before; numbers of the objects."""
    start = one.sky.t0_tai_ns
    sigma = np.array([PLACE_KM] * 3 + [SPEED_KM_S] * 3 + [AREA_M2_KG])
    with store.transaction() as writer:
        numbers = writer.add_objects([f"o{k}" for k in range(objects)], start - 100 * DAY_NS)
        writer.add_orbits(
            [
                StoredOrbit(
                    object_id=number, epoch_tai_ns=start, state=one.truth[k, 0] + sigma[:6] * rng.standard_normal(6),
                    covariance=np.diag(sigma**2), parameters={"radiation": 0.02}, made_tai_ns=start, made_by="drawn",
                    chi2_nu=1.0, n_used=300,
                )
                for k, number in enumerate(numbers)
            ]
        )  # fmt: skip
    rows = stored(one, 0).rows
    for first in range(0, history, 50_000):
        chunk = range(first, min(first + 50_000, history))
        epochs = [start - 100 * DAY_NS + (k * 90 * DAY_NS) // history + np.arange(len(rows)) * 30 * 10**9 for k in chunk]
        old = [StoredTracklet(sensor="list", t_tai_ns=t, rows=rows, uid=f"{k:064d}") for k, t in zip(chunk, epochs, strict=True)]
        with store.transaction() as writer:
            made = writer.add_tracklets(old)
            writer.associate(
                [
                    Association(
                        tracklet_id=t, object_id=numbers[k % objects], probability=1.0, state="accepted", decided_by="drawn",
                        decided_tai_ns=start,
                    )
                    for k, t in zip(chunk, made, strict=True)
                ]
            )  # fmt: skip
    return numbers


def main(objects: int = 10_000, history: int = 1_000_000, workers: int = 2, seed: int = 1) -> dict[str, Any]:
    """Figures of one night."""
    one = survey(seed, objects=objects, clutter=objects // 50, days=1.0, a_day=1.0)
    with tempfile.TemporaryDirectory() as folder:
        store = ObjectStore(str(Path(folder) / "store.db"))
        numbers = fill(store, one, objects, history, np.random.default_rng(seed))
        with store.transaction() as writer:
            new = writer.add_tracklets([stored(one, k) for k in range(len(one.seen))])
        owner = {t: numbers[s.owner] if s.owner >= 0 else -1 for t, s in zip(new, one.seen, strict=True)}
        begun, cpu = time.monotonic(), cpu_s()
        report = update(store, one.sky.t0_tai_ns + DAY_NS, UpkeepOptions(workers=workers))
        wall, cpu = time.monotonic() - begun, cpu_s() - cpu
        decided = [a for a in store.associations(state="accepted") if a.tracklet_id in owner]
        right = sum(owner[a.tracklet_id] == a.object_id for a in decided)
        place = {number: k for k, number in enumerate(numbers)}
        fresh = [o for o in store.orbits() if o.object_id in place and o.made_by != "drawn"]
        nees = [nees_of(one, place[o.object_id], o) for o in fresh]
        store.close()
    return {
        "objects": objects,
        "tracklets": len(one.seen),
        "wall_s": round(wall, 1),
        "cpu_s": round(cpu, 1),
        "right": right,
        "wrong": len(decided) - right,
        "linkable": sum(s.owner >= 0 for s in one.seen),
        "renewed": report.renewed,
        "ambiguous": report.ambiguous,
        "nees": {"value": float(np.mean(nees)), "sigma": float(np.std(nees) / len(nees) ** 0.5), "n": len(nees)},
    }


def nees_of(one: Survey, k: int, orbit: StoredOrbit) -> float:
    """Squared error of a state over its covariance, over six."""
    t_s = (orbit.epoch_tai_ns - one.sky.t0_tai_ns) * 1e-9
    left = orbit.state - between(one.truth[k], np.array([min(t_s, 2.0 * DAY_S)]))[0]
    scale = np.sqrt(np.diag(orbit.state_covariance))
    return float((left / scale) @ np.linalg.solve(orbit.state_covariance / np.outer(scale, scale), left / scale)) / 6.0


def cpu_s() -> float:
    """CPU-seconds of this process and of those that it waited for."""
    return sum(u.ru_utime + u.ru_stime for u in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--objects", type=int, default=10_000)
    parser.add_argument("--history", type=int, default=1_000_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    sys.stdout.write(json.dumps(main(**vars(parser.parse_args())), indent=1) + "\n")
