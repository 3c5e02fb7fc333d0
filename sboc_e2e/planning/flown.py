"""The scenario beside a schedule: the chain flies its first visits, pixel by pixel."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground.planning.schedule import Schedule
from ground.planning.sky import Orbit, Site, sky_of
from sboc_e2e.files.frame_fits import utc_text
from sboc_e2e.planning.request import PlanRequest
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import Scenario, from_document
from sboc_e2e.scenario.shown import text
from simulator.platform.kepler import elements_of


def scenario_toml(
    request: PlanRequest, found: Scenario, station: Site | Orbit, objects: Path | None, schedule: Schedule, registry: Registry
) -> str:
    """A scenario that begins with the first visit and holds `flown` of them, on the orbit that the plan was made for.

    objects : file of the targets; they replace the scenario's own objects.
    schedule : with the directions of the optical axis.
    """
    visits = schedule.visits[: request.flown]
    first = visits[0].start_tai_ns
    rows = []
    for visit in visits:
        ra = float(np.degrees(np.arctan2(visit.boresight[1], visit.boresight[0])) % 360.0)
        dec = float(np.degrees(np.arcsin(visit.boresight[2])))
        start_s, end_s = ((t - first) * 1e-9 for t in (visit.start_tai_ns, visit.end_tai_ns))
        rows.append({"start": f"{start_s:.3f} s", "end": f"{end_s:.3f} s", "ra": f"{ra:.6f} deg", "dec": f"{dec:.6f} deg"})
    document = found.document()
    document["description"] = f"{len(visits)} visits of a plan: {request.description or request.scenario}"
    document["epoch_utc"] = utc_text(first, 9)
    document["frames"] = max(1, int((visits[-1].end_tai_ns - first) * 1e-9 * found.simulator.frame_rate_hz))
    document["pointing"] = {**document["pointing"], "law": "schedule", "visits": rows}
    if isinstance(station, Orbit):
        sky = sky_of(station, np.array([first]))
        document["platform"] = {**document["platform"], **kepler_keys(sky.station_km[0], sky.station_km_s[0])}
    if objects is not None:
        document["population"] = {**document["population"], "classes": []}
        size = f"{request.plan.size_m!r} m"
        chosen = {"file": str(objects), "names": list(request.names), "size": size, "albedo": request.plan.albedo}
        document["objects"] = {"satellites": {**document["objects"]["satellites"], **chosen}, "passing": []}
    return text(from_document(document, name="scenario", registry=registry, where="plan"))


def kepler_keys(position_km: NDArray[np.float64], velocity_km_s: NDArray[np.float64]) -> dict[str, object]:
    """Keys of a Kepler platform from its state (3,) km, (3,) km/s, GCRS axes."""
    elements = elements_of(position_km, velocity_km_s)
    angles = {
        "inclination": elements.i_rad, "node": elements.node_rad, "perigee": elements.argp_rad,
        "mean_anomaly": elements.mean_anomaly_rad,
    }  # fmt: skip
    return {
        "kind": "kepler",
        "semi_major_axis": f"{float(elements.a_km)!r} km",
        "eccentricity": float(elements.e),
        **{key: f"{float(np.degrees(angle))!r} deg" for key, angle in angles.items()},
    }
