"""The scenario beside a schedule: the chain flies its first visits, pixel by pixel."""

import json
from typing import Any

import numpy as np

from ground.planning.schedule import Schedule
from sboc_e2e.planning.request import PlanRequest
from sboc_e2e.scenario import Scenario
from sboc_e2e.times import utc_text


def scenario_toml(request: PlanRequest, found: Scenario, schedule: Schedule) -> str:
    """TOML of a scenario that starts with the first visit and holds `flown` of them.

    Its orbit is that of the plan, given at the new epoch by its osculating elements where the platform orbits.
    """
    visits = schedule.visits[: request.flown]
    if not visits:
        return "# the plan holds no visit\n"
    first = visits[0].start_tai_ns
    rows = []
    for visit in visits:
        ra = float(np.degrees(np.arctan2(visit.boresight[1], visit.boresight[0])) % 360.0)
        dec = float(np.degrees(np.arcsin(visit.boresight[2])))
        start_s, end_s = ((t - first) * 1e-9 for t in (visit.start_tai_ns, visit.end_tai_ns))
        rows.append(f'  {{ start = "{start_s:.3f} s", end = "{end_s:.3f} s", ra = "{ra:.6f} deg", dec = "{dec:.6f} deg" }},')
    document = found.document()
    document["description"] = f"{len(visits)} visits of a plan: {request.description or request.scenario}"
    document["epoch_utc"] = utc_text(first)
    seconds = (visits[-1].end_tai_ns - first) * 1e-9
    document["frames"] = max(1, int(seconds * found.simulator.frame_rate_hz))
    document["pointing"] = {**document["pointing"], "law": "schedule", "visits": None}
    text = "\n".join(_lines(document, "", "\n".join(rows)))
    return f"# Written by `sboc plan`.\n{text}\n"
