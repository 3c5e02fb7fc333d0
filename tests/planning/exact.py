"""The best schedule of a case by integer programming: SciPy's HiGHS, with a bound where it stops at its time limit.

What is known of a target after a set of visits does not depend on their order: half the logarithm of the determinant of the unit
matrix and the sum of what the visits tell. A target that is seen in k slots therefore has 2^k worths, one for each set of slots.
The programme chooses a field or none for each slot, and for each target one set of slots in which a chosen field holds it. Fields
of two slots exclude each other where the slew does not fit; for slews that obey the triangle inequality, pairs say it all.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

from ground.planning.greedy import Slot
from ground.planning.options import PlanOptions

MOST_SLOTS = 10
"""Of one target: its sets of slots are the programme's columns."""


@dataclass(frozen=True, kw_only=True)
class Best:
    """worth : of the best schedule found. bound : no schedule is worth more. visits : (slot, place of the field's centre)."""

    worth: float
    bound: float
    visits: tuple[tuple[int, int], ...]


class _Rows:
    """Rows of a sparse matrix, each with its largest value."""

    def __init__(self) -> None:
        self.row: list[int] = []
        self.column: list[int] = []
        self.value: list[float] = []
        self.upper: list[float] = []
        self.lower: list[float] = []

    def add(self, columns: list[int], values: list[float], lower: float, upper: float) -> None:
        """One row."""
        self.row += [len(self.upper)] * len(columns)
        self.column += columns
        self.value += values
        self.upper.append(upper)
        self.lower.append(lower)


def best_of_all(
    slots: list[Slot], weight: NDArray[np.float64], half_field: float, observing_s: float, options: PlanOptions, limit_s: float
) -> Best:
    """The best of all schedules, or the best found in `limit_s` seconds. Targets are seen in at most `MOST_SLOTS` slots."""
    fields = [(number, place) for number, slot in enumerate(slots) for place in range(len(slot.target))]
    column_of = {field: k for k, field in enumerate(fields)}
    rows = _Rows()
    for number, slot in enumerate(slots):
        if len(slot.target):
            mine = [column_of[number, place] for place in range(len(slot.target))]
            rows.add(mine, [1.0] * len(mine), -np.inf, 1.0)
    _exclude(rows, slots, column_of, observing_s, options)
    worth: list[float] = [0.0] * len(fields)
    for target in range(len(weight)):
        seen = [
            (number, int(np.flatnonzero(slot.target == target)[0])) for number, slot in enumerate(slots) if target in slot.target
        ]
        assert len(seen) <= MOST_SLOTS
        first = len(worth)
        sets = range(1, 2 ** len(seen))
        told = np.array([slots[number].told[place].T @ slots[number].told[place] for number, place in seen])
        chosen = np.array([[s >> k & 1 for k in range(len(seen))] for s in sets], dtype=np.float64).reshape(-1, len(seen))
        known = np.eye(6) + np.einsum("sk,kij->sij", chosen, told)
        worth += list(0.5 * weight[target] * np.linalg.slogdet(known)[1])
        rows.add([first + s - 1 for s in sets], [1.0] * len(sets), -np.inf, 1.0)
        for k, (number, place) in enumerate(seen):
            slot = slots[number]
            holds = np.flatnonzero(slot.direction @ slot.direction[place] >= np.cos(half_field))
            sets_with = [first + s - 1 for s in sets if s >> k & 1]
            rows.add(
                sets_with + [column_of[number, int(p)] for p in holds], [1.0] * len(sets_with) + [-1.0] * len(holds), -np.inf, 0.0
            )
    matrix = csr_array((rows.value, (rows.row, rows.column)), shape=(len(rows.upper), len(worth)))
    found = milp(
        -np.array(worth),
        constraints=LinearConstraint(matrix, np.array(rows.lower), np.array(rows.upper)),
        integrality=(np.arange(len(worth)) < len(fields)).astype(np.int64),
        bounds=Bounds(0.0, 1.0),
        options={"time_limit": limit_s, "mip_rel_gap": 1e-6},
    )
    if found.x is None:
        return Best(worth=0.0, bound=float(sum(sorted(worth)[-len(weight) :])), visits=())
    visits = tuple(field for field, k in column_of.items() if found.x[k] > 0.5)
    return Best(worth=-float(found.fun), bound=-float(found.mip_dual_bound), visits=visits)


def _exclude(
    rows: _Rows, slots: list[Slot], column_of: dict[tuple[int, int], int], observing_s: float, options: PlanOptions
) -> None:
    """A field and the fields of a later slot that cannot be reached from it."""
    farthest_s = 180.0 / options.slew.rate_deg_s + options.slew.settling_s + observing_s
    for number, slot in enumerate(slots):
        for other in range(number + 1, len(slots)):
            later = slots[other]
            time_s = later.start_s - slot.start_s
            if time_s >= farthest_s:
                break
            angle = np.degrees(np.arccos(np.clip(slot.direction @ later.direction.T, -1.0, 1.0)))
            needed_s = np.where(np.radians(angle) < 1e-6, 0.0, angle / options.slew.rate_deg_s + options.slew.settling_s)
            for place in range(len(slot.target)):
                out = np.flatnonzero(needed_s[place] + observing_s > time_s)
                if len(out):
                    mine = [column_of[number, place], *(column_of[other, int(p)] for p in out)]
                    rows.add(mine, [1.0] * len(mine), -np.inf, 1.0)


def windows_case(seed: int, *, slots: int, targets: int, visit_s: float) -> tuple[list[Slot], NDArray[np.float64]]:
    """Targets in groups over 120 deg of the sky, each seen in two windows of three to five slots.

    Visits of one window tell nearly the same, visits of the other something else; errors of targets differ by a factor of sixty.
    """
    rng = np.random.default_rng(seed)
    group = rng.integers(0, max(2, targets // 2), targets)
    centre = rng.uniform(0.0, np.radians(120.0), targets)[group]
    angle = centre + rng.normal(0.0, np.radians(1.0), targets)
    height = rng.uniform(-0.3, 0.3, targets)[group] + rng.normal(0.0, np.radians(1.0), targets)
    direction = np.stack([np.cos(angle) * np.cos(height), np.sin(angle) * np.cos(height), np.sin(height)], axis=1)
    scale = rng.uniform(0.5, 30.0, targets)
    told: dict[int, list[tuple[int, NDArray[np.float64]]]] = {}
    for target in range(targets):
        for start in rng.choice(slots // 6 + 1, 2, replace=False) * 5:
            of_window = rng.normal(size=(2, 6))
            for number in range(start, min(start + int(rng.integers(3, 6)), slots)):
                visit = scale[target] * (of_window + 0.2 * rng.normal(size=(2, 6)))
                told.setdefault(number, []).append((target, visit))
    made = []
    for number in range(slots):
        here = told.get(number, [])
        seen = np.array([target for target, _ in here], dtype=np.int64)
        rows = np.array([visit for _, visit in here]).reshape(-1, 2, 6)
        made.append(Slot(start_s=number * visit_s, target=seen, direction=direction[seen], told=rows))
    return made, rng.uniform(0.5, 2.0, targets)
