"""A plan, read aloud: instants, sky, targets, constraints, light, worth, schedule."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ground.planning.constraints import Visibility, visibility_of
from ground.planning.contradiction import contradiction
from ground.planning.greedy import Chosen, Slot, best_visits
from ground.planning.light import PlannedCamera, angle_sigma_rad, magnitudes, snr_of
from ground.planning.options import PlanOptions
from ground.planning.schedule import Schedule, Visit
from ground.planning.sky import Orbit, Site, sky_of
from ground.planning.targets import Targets, states_of
from ground.planning.windows import windows_of
from ground.planning.worth import Views, views_of
from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]


def plan_visits(
    targets: Targets, station: Site | Orbit, camera: PlannedCamera, start_tai_ns: int, options: PlanOptions
) -> Schedule:
    """Where to point from `start_tai_ns` on so that the orbits of the targets become known best.

    UserError for no targets, for a visit that its exposures do not fit into, and where nothing can be seen at all.
    """
    observing_s = options.exposures * camera.period_s
    if observing_s + options.slew.settling_s > options.visit_s:
        raise UserError(
            f"plan.visit: {options.exposures} exposures take {observing_s:g} s and settling {options.slew.settling_s:g} s; "
            f"a visit of {options.visit_s:g} s is too short, allowed is >= {observing_s + options.slew.settling_s:g} s"
        )
    if not len(targets):
        raise UserError("plan: there are no targets; allowed is one or more")
    n_slots = max(1, int(options.days * 86400.0 / options.visit_s))
    slot_start_s: Array = np.arange(n_slots, dtype=np.float64) * options.visit_s
    middle_s: Array = slot_start_s + options.visit_s - 0.5 * observing_s
    epochs = start_tai_ns + np.round(np.concatenate([[0.0], middle_s]) * 1e9).astype(np.int64)
    position, velocity = states_of(targets.known, epochs)
    at_start = np.concatenate([position[:, 0], velocity[:, 0]], axis=1)
    sky = sky_of(station, epochs[1:])
    seen = visibility_of(position[:, 1:], velocity[:, 1:], sky, options.constraints)
    known = seen.free["no position"] & np.isfinite(at_start).all(axis=1)[:, None]
    seen = replace(seen, free={**seen.free, "no position": known})
    snr = snr_of(magnitudes(targets.size_m, options.albedo, seen), seen.rate_rad_s, camera, seen.air_mass)
    with np.errstate(invalid="ignore"):
        bright = snr >= options.faintest_snr
    usable = seen.allowed & bright
    if not usable.any():
        raise UserError(f"plan: no target can be seen at any time: {contradiction([seen], ~bright, options)}")
    forbidden = {**seen.forbidden, "too faint": float(1.0 - np.mean(bright))}
    views, sigma = _views(seen, usable, snr, at_start, middle_s, camera, options)
    slots = _slots(views, seen, slot_start_s)
    chosen = best_visits(slots, targets.weight, camera.half_field_rad, observing_s, options)
    if not chosen:
        raise UserError("plan.knowledge: no visit adds anything to orbits that are known so well")
    notes = _notes(targets, usable, sigma)
    made = _schedule(chosen, slots, start_tai_ns, observing_s, len(targets), forbidden, notes, options)
    return replace(made, windows=windows_of(targets.known, station, options.constraints, epochs[1:], seen.allowed))


def _views(
    seen: Visibility,
    usable: NDArray[np.bool_],
    snr: Array,
    at_start: Array,
    middle_s: Array,
    camera: PlannedCamera,
    options: PlanOptions,
) -> tuple[Views, Array]:
    """All observations that can be made, and the error of each."""
    slot, target = np.nonzero(usable.T)
    there = target, slot
    sigma = angle_sigma_rad(snr[there], seen.rate_rad_s[there], camera, options.exposures, seen.air_mass[there])
    line_km = seen.direction[target, slot] * seen.range_km[target, slot, None]
    safe = np.where(np.isfinite(at_start), at_start, 1.0)
    return views_of(safe, middle_s, target, slot, line_km, sigma, options.knowledge), sigma


def _slots(views: Views, seen: Visibility, slot_start_s: Array) -> list[Slot]:
    """Observations by slot; `views` are sorted by it."""
    borders = np.searchsorted(views.slot, np.arange(len(slot_start_s) + 1))
    slots = []
    for number, start_s in enumerate(slot_start_s):
        mine = slice(borders[number], borders[number + 1])
        target = views.target[mine]
        slots.append(Slot(start_s=float(start_s), target=target, direction=seen.direction[target, number], told=views.told[mine]))
    return slots


def _notes(targets: Targets, usable: NDArray[np.bool_], sigma: Array) -> tuple[str, ...]:
    """What a reader of the schedule should know."""
    never = np.flatnonzero(~usable.any(axis=1))
    named = ", ".join(targets.known.names[k] for k in never[:5])
    notes = [f"one visit measures an angle to {np.degrees(np.median(sigma)) * 3600:.2f} arcsec (median)"]
    if len(never):
        notes.append(f"{len(never)} of {len(targets)} targets can never be seen: {named}{', ...' if len(never) > 5 else ''}")
    return tuple(notes)


def _schedule(
    chosen: list[Chosen], slots: list[Slot], start_tai_ns: int, observing_s: float, n_targets: int,
    forbidden: dict[str, float], notes: tuple[str, ...], options: PlanOptions,
) -> Schedule:  # fmt: skip
    """Visits with epochs; a visit is the time in which the camera rests."""
    gain = np.zeros(n_targets)
    visits = []
    for one in chosen:
        slot = slots[one.slot]
        seen = slot.target[one.members]
        gain[seen] += one.gains
        end_ns = start_tai_ns + round((slot.start_s + options.visit_s) * 1e9)
        visits.append(
            Visit(
                start_tai_ns=end_ns - round(observing_s * 1e9),
                end_tai_ns=end_ns,
                boresight=(float(one.boresight[0]), float(one.boresight[1]), float(one.boresight[2])),
                targets=tuple(int(k) for k in seen),
                gain=float(one.gains.sum()),
            )
        )
    return Schedule(visits=tuple(visits), gain_nats=gain, forbidden=forbidden, n_slots=len(slots), notes=notes)
