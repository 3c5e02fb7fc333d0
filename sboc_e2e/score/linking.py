"""Tracklets compared with objects: completeness, purity, fragments, direction, false tracklets, veto loss."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from astropy.table import Table

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.score.figures import bootstrap, exact, proportion, rate
from sboc_e2e.score.matching import TruthStreak

FINDABLE_FRAMES: Final = 3  # Definition of a findable object (docs/scoring.md): two trails fit any motion, the third tests it.


def linking(streaks: Table, pairs: Mapping[int, TruthStreak], n_frames: int) -> tuple[dict[str, Any], dict[int, int]]:
    """Figures, and tracklet id -> object id (-1: false) by majority of its streaks.

    Findable objects are those with matched measured streaks in three or more frames; an object counts as linked when
    one tracklet holds at least half of them.
    """
    frames_of_object: dict[int, set[int]] = {}
    members: dict[int, list[int]] = {}
    direction: list[bool] = []
    vetoed = 0
    for index, s in enumerate(streaks):
        truth = pairs.get(index)
        flags = int(s["flags"])
        if truth is not None:
            frames_of_object.setdefault(truth.object_id, set()).add(truth.frame)
            vetoed += bool(flags & StreakFlag.VETOED)
        if int(s["tracklet_id"]) >= 0:
            members.setdefault(int(s["tracklet_id"]), []).append(-1 if truth is None else truth.object_id)
            if truth is not None and flags & StreakFlag.DIRECTION_RESOLVED and truth.length_px >= 5.0:
                measured = np.array([s["row1"] - s["row0"], s["col1"] - s["col0"]], dtype=float)
                true = truth.ends[1] - truth.ends[0]
                direction.append(bool(measured @ true > 0))
    owner: dict[int, int] = {}
    purity = []
    for tracklet, objects in members.items():
        (best, count) = max(Counter(objects).items(), key=lambda item: (item[1], -item[0]))
        owner[tracklet] = best
        if best >= 0:
            purity.append(count / len(objects))
    findable = {o for o, frames in frames_of_object.items() if len(frames) >= FINDABLE_FRAMES}
    linked, fragments = 0, []
    for o in sorted(findable):
        mine = [objects.count(o) for t, objects in members.items() if owner[t] == o]
        if mine:
            linked += max(mine) >= 0.5 * len(frames_of_object[o])
            fragments.append(len(mine))
    false = sum(o < 0 for o in owner.values())
    per_thousand = rate(false, n_frames / 1000.0, n_frames)
    none = "no object in three or more frames"
    return {
        "n_objects": exact(len(findable), len(findable)),
        "completeness": proportion(linked, len(findable), none),
        "purity": bootstrap(purity, lambda v: float(v.mean()), "fewer than three tracklets of objects"),
        "fragments_per_object": bootstrap(fragments, lambda v: float(v.mean()), "fewer than three linked objects"),
        "direction_correct": proportion(sum(direction), len(direction), "no resolved direction"),
        "false_tracklets_per_1000_frames": per_thousand,
        "veto_loss": proportion(vetoed, len(pairs), "no matched streak"),
    }, owner
