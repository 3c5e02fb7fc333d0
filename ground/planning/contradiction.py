"""Why nothing can be seen: the fewest constraints that together forbid every case, in one line."""

from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.planning.constraints import Visibility
from ground.planning.options import PlanOptions

Flags = NDArray[np.bool_]

_KEYS: Final = {
    "Sun": "plan.constraints.sun",
    "Moon": "plan.constraints.moon",
    "Earth's limb": "plan.constraints.limb",
    "elevation": "plan.constraints.elevation",
    "daylight": "plan.constraints.darkness",
    "too fast": "plan.constraints.max_rate",
    "too faint": "plan.faintest_snr",
    "weather": "weather",
    "no position": "objects",
    "Earth's shadow": "the Earth's shadow",
}
"""What a user writes, or meets, for each constraint."""


def contradiction(seen: list[Visibility], too_faint: Flags | None, options: PlanOptions) -> str:
    """The fewest constraints that leave nothing; where it is one, also what it would have to allow.

    seen : one or more sets of cases, all of which are forbidden. too_faint : (m, n) of the only set, None where brightness is
    no constraint.
    """
    free = {name: np.concatenate([one.free[name].ravel() for one in seen]) for name in seen[0].free}
    if too_faint is not None:
        free["too faint"] = ~too_faint.ravel()
    names = _fewest(free)
    if len(names) == 1:
        return f"{_KEYS[names[0]]}: {_alone(names[0], seen, options)}"
    shares = " and ".join(f"{_KEYS[name]} forbids {100.0 * (1.0 - np.mean(free[name])):.0f} %" for name in names)
    return f"{shares} of all cases, and together they forbid all"


def _fewest(free: dict[str, Flags]) -> tuple[str, ...]:
    """The smallest set of constraints that forbids everything; of equals, the one whose members forbid most."""
    order = sorted(free, key=lambda name: float(np.mean(free[name])))
    return next(
        names
        for size in range(1, len(order) + 1)
        for names in combinations(order, size)
        if not np.logical_and.reduce([free[name] for name in names]).any()
    )


def _alone(name: str, seen: list[Visibility], options: PlanOptions) -> str:
    """What a constraint that alone forbids everything would have to allow."""
    asked = options.constraints
    # the largest and the smallest over all sets
    high = {key: max(one.best.get(key, -np.inf) for one in seen) for key in ("Sun", "Moon", "Earth's limb", "elevation")}
    low = {key: min(one.best.get(key, np.inf) for one in seen) for key in ("daylight", "too fast")}
    limb_deg = high["Earth's limb"]
    return {
        "Sun": f"no target is ever more than {high['Sun']:.1f} deg from the Sun, {asked.sun_deg:g} deg are asked",
        "Moon": f"no target is ever more than {high['Moon']:.1f} deg from the Moon, {asked.moon_deg:g} deg are asked",
        "Earth's limb": f"no target is ever more than {limb_deg:.1f} deg above it, {asked.limb_deg:g} deg are asked",
        "elevation": f"no target ever rises above {high['elevation']:.1f} deg, {asked.elevation_deg:g} deg are asked",
        "daylight": f"the Sun never sinks below {low['daylight']:.1f} deg, {asked.darkness_deg:g} deg are asked",
        "too fast": f"no target is ever slower than {low['too fast']:.2g} deg/s, {asked.max_rate_deg_s:g} deg/s are allowed",
        "too faint": f"no target of {options.size_m:g} m ever reaches S/N {options.faintest_snr:g} in one exposure",
        "weather": "the dome is closed throughout the plan",
        "no position": "SGP4 gives no target a position on these days",
        "Earth's shadow": "it covers every target at all times",
    }[name]
