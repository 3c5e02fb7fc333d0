"""Search for motions: pairs of streaks that one object could have made, grown frame by frame into candidates."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ground.link.hypotheses import ENTERING, FULL, LEAVING, POINT, Nodes
from ground.link.motion import (
    N_PARAMETERS,
    anchor,
    fit_motion,
    is_full,
    kappa_sigma,
    position_on_plane,
    to_plane,
    usable,
    velocity_on_plane,
)

_GATE = 6.0
"""Sigmas within which a cheap test passes a pair on to the fit."""


@njit(cache=True)
def _agrees(nodes: Nodes, node: int, chord: NDArray[np.float64], dt_s: float, floor_rad: float) -> bool:
    """Whether shape and speed of a hypothesis agree with a mean motion of `chord` (3,) (rad) in `dt_s`."""
    distance = math.sqrt(chord[0] ** 2 + chord[1] ** 2 + chord[2] ** 2)
    speed = distance / dt_s
    kind = nodes.kind[node]
    if kind == POINT:
        return speed <= nodes.fastest_rad_s[node]
    length = max(nodes.length_rad[node], 1e-12)
    along = 0.0
    for c in range(3):
        along += chord[c] * (nodes.unit[node, 1, c] - nodes.unit[node, 0, c]) / length
    if along < 0.0 and distance > floor_rad:
        return False
    across = math.sqrt(max(distance * distance - along * along, 0.0))
    # the plane's curvature bends a chord over the sky by about half its square
    lever = 1.0 + 2.0 * distance / length
    if across > _GATE * nodes.sigma_rad[node, 2] * lever + 0.5 * distance * (distance + length) + floor_rad:
        return False
    duration = nodes.duration_s[node]
    if kind != FULL:
        return length <= 1.3 * speed * duration + floor_rad
    own = length / duration
    sigma = math.hypot(nodes.sigma_rad[node, 0], nodes.sigma_rad[node, 1]) / duration
    drift = _drift(speed, dt_s + 0.5 * duration)
    return abs(speed - own) <= _GATE * sigma + speed * drift + floor_rad / dt_s


@njit(cache=True)
def _key_window(nodes: Nodes, node: int, dt_s: float, fastest_rad_s: float, floor_rad: float) -> tuple[float, float]:
    """Where, along the sorting axis, the middle of a streak about dt_s later can lie."""
    unit = nodes.unit[node]
    here = 0.5 * (unit[0, nodes.axis] + unit[1, nodes.axis])
    limit = min(fastest_rad_s, nodes.fastest_rad_s[node])
    span = abs(dt_s) + nodes.duration_s[node]
    if not is_full(nodes, node):
        reach = limit * span + floor_rad + nodes.length_rad[node]
        return here - reach, here + reach
    own = nodes.length_rad[node] / nodes.duration_s[node]
    noise = _GATE * (nodes.sigma_rad[node, 0] + nodes.sigma_rad[node, 1]) / nodes.duration_s[node]
    drift = _drift(own + noise, span)
    slow, fast = max(own / (1.0 + drift) - noise, 0.0), min((own + noise) * (1.0 + drift), limit)
    heading = (unit[1, nodes.axis] - unit[0, nodes.axis]) / max(nodes.length_rad[node], 1e-12)
    # the epoch of a streak depends on its row: dt_s is good to the time of reading out the frame, covered by half the span
    near, far = heading * slow * 0.5 * abs(dt_s), heading * fast * span
    across = _GATE * nodes.sigma_rad[node, 2] * (1.0 + 2.0 * fast * span / max(nodes.length_rad[node], 1e-12)) + floor_rad
    across += 0.5 * (fast * span) ** 2
    return here + min(near, far) - across, here + max(near, far) + across


@njit(cache=True)
def _drift(speed_rad_s: float, dt_s: float) -> float:
    """Largest relative change of speed to allow within dt_s: three sigma of the prior of range rate over range."""
    return min(3.0 * kappa_sigma(speed_rad_s) * dt_s, 3.0)


@njit(cache=True)
def find_pairs(
    nodes: Nodes,
    reach: int,
    fastest_rad_s: float,
    floor_rad: float,
    log_area: float,
    sigma_acceleration: float,
    lowest: float,
    capacity: int,
) -> tuple[int, NDArray[np.int64], NDArray[np.float64]]:
    """Pairs of hypotheses at most `reach` frames apart whose common motion beats chance by more than exp(lowest).

    Returns the number of pairs found (those beyond `capacity` are counted and not kept), pairs (capacity, 2), and the gain
    in log evidence over chance, without the rate of new objects.
    """
    pairs = np.empty((capacity, 2), dtype=np.int64)
    gains = np.empty(capacity)
    found = 0
    centre, basis, theta = np.empty(3), np.empty((2, 3)), np.empty(N_PARAMETERS)
    factor = np.empty((N_PARAMETERS, N_PARAMETERS))
    members = np.empty(2, dtype=np.int64)
    chord = np.empty(3)
    n_frames = len(nodes.first) - 1
    for f in range(n_frames):
        for i in nodes.order[nodes.first[f] : nodes.first[f + 1]]:
            if not usable(nodes, i) or nodes.kind[i] == LEAVING:
                continue
            p = anchor(nodes, i, True)
            for g in range(f + 1, min(f + 1 + reach, n_frames)):
                here = nodes.order[nodes.first[g] : nodes.first[g + 1]]
                if len(here) == 0:
                    continue
                keys = nodes.sorted_key[nodes.first[g] : nodes.first[g + 1]]
                low, high = _key_window(nodes, i, nodes.t_s[here[0], 1] - nodes.t_s[i, p], fastest_rad_s, floor_rad)
                for place in range(np.searchsorted(keys, low), len(here)):
                    if keys[place] > high:
                        break
                    j = here[place]
                    if not usable(nodes, j) or nodes.kind[j] == ENTERING or (nodes.vetoed[i] and nodes.vetoed[j]):
                        continue
                    q = anchor(nodes, j, False)
                    dt = nodes.t_s[j, q] - nodes.t_s[i, p]
                    if dt <= 0.0:
                        continue
                    square = 0.0
                    for c in range(3):
                        chord[c] = nodes.unit[j, q, c] - nodes.unit[i, p, c]
                        square += chord[c] * chord[c]
                    if square > (fastest_rad_s * dt) ** 2:
                        continue
                    if not (_agrees(nodes, i, chord, dt, floor_rad) and _agrees(nodes, j, chord, dt, floor_rad)):
                        continue
                    members[0], members[1] = i, j
                    chi2, evidence, rows, _ = fit_motion(
                        nodes, members, log_area, sigma_acceleration, centre, basis, theta, factor
                    )
                    gain = evidence - nodes.log_clutter[i] - nodes.log_clutter[j] + nodes.log_odds[i] + nodes.log_odds[j]
                    if gain > lowest and chi2 < chi2_gate(rows):
                        if found < capacity:
                            pairs[found, 0], pairs[found, 1] = i, j
                            gains[found] = gain
                        found += 1
    return found, pairs, gains


@njit(cache=True)
def chi2_gate(rows: int) -> float:
    """Chi-square that a true track of `rows` coordinates exceeds in fewer than one case in 10,000, tails included."""
    free = max(rows - 4, 1)
    return free + 6.0 * math.sqrt(2.0 * free) + 14.0


Model = tuple[float, float, float, float]
"""log_area, sigma_acceleration, log_seen, log_missed."""


@njit(cache=True)
def gain_of(
    nodes: Nodes,
    members: NDArray[np.int64],
    model: Model,
    centre: NDArray[np.float64],
    basis: NDArray[np.float64],
    theta: NDArray[np.float64],
    factor: NDArray[np.float64],
) -> tuple[float, float, int, float]:
    """Log evidence of one object over chance, chi-square, coordinates and reference epoch of a track."""
    log_area, sigma_acceleration, log_seen, log_missed = model
    chi2, gain, rows, t_ref = fit_motion(nodes, members, log_area, sigma_acceleration, centre, basis, theta, factor)
    n = len(members)
    missed = nodes.frame[members[n - 1]] - nodes.frame[members[0]] + 1 - n
    gain += n * log_seen + missed * log_missed
    for k in range(n):
        gain += nodes.log_odds[members[k]] - nodes.log_clutter[members[k]]
    return gain, chi2, rows, t_ref


@njit(cache=True)
def grow(
    nodes: Nodes,
    seed: NDArray[np.int64],
    used: NDArray[np.bool_],
    reach: int,
    floor_rad: float,
    model: Model,
) -> tuple[NDArray[np.int64], float]:
    """Extend a track at both ends, frame by frame, with the streak that raises its evidence most; members and gain.

    used : (m // 2,) streaks that belong to other tracks already. reach : frames that may pass without a streak.
    """
    n_frames = len(nodes.first) - 1
    members = seed.copy()
    centre, basis, theta = np.empty(3), np.empty((2, 3)), np.empty(N_PARAMETERS)
    factor = np.empty((N_PARAMETERS, N_PARAMETERS))
    trial_theta = np.empty(N_PARAMETERS)
    gain, _, _, t_ref = gain_of(nodes, members, model, centre, basis, theta, factor)
    trial_centre, trial_basis = np.empty(3), np.empty((2, 3))
    for forward in (True, False):
        extending = True
        while extending:
            extending = False
            edge = members[len(members) - 1] if forward else members[0]
            if nodes.kind[edge] == (LEAVING if forward else ENTERING):
                break
            f = nodes.frame[edge]
            arc = nodes.t_s[members[len(members) - 1], 1] - nodes.t_s[members[0], 0]
            p_edge = anchor(nodes, edge, forward)
            for step in range(1, reach + 1):
                g = f + step if forward else f - step
                if g < 0 or g >= n_frames:
                    break
                best, best_gain = -1, -math.inf
                for j in nodes.order[nodes.first[g] : nodes.first[g + 1]]:
                    if used[j // 2] or not usable(nodes, j) or nodes.kind[j] == (ENTERING if forward else LEAVING):
                        continue
                    q = anchor(nodes, j, not forward)
                    t = nodes.t_s[j, q] - t_ref
                    x, y = to_plane(nodes.unit[j, q], centre, basis)
                    px, py = position_on_plane(theta, t)
                    vx, vy = velocity_on_plane(theta, t)
                    dt = abs(nodes.t_s[j, q] - nodes.t_s[edge, p_edge])
                    speed = math.hypot(vx, vy)
                    lever = 1.0 + 2.0 * dt / max(arc, 1e-3)
                    noise = nodes.sigma_rad[j, 0] + nodes.sigma_rad[j, 1] + nodes.sigma_rad[edge, 0] + nodes.sigma_rad[edge, 1]
                    tolerance = _GATE * noise * lever + floor_rad + model[1] * dt * (dt + arc) * _GATE
                    tolerance += speed * dt * _drift(speed, dt + arc)
                    if math.hypot(x - px, y - py) > tolerance:
                        continue
                    trial = np.empty(len(members) + 1, dtype=np.int64)
                    if forward:
                        trial[:-1], trial[-1] = members, j
                    else:
                        trial[1:], trial[0] = members, j
                    trial_gain, chi2, rows, _ = gain_of(nodes, trial, model, trial_centre, trial_basis, trial_theta, factor)
                    if trial_gain > best_gain and chi2 < chi2_gate(rows):
                        best, best_gain = j, trial_gain
                if best >= 0 and best_gain > gain:
                    longer = np.empty(len(members) + 1, dtype=np.int64)
                    if forward:
                        longer[:-1], longer[-1] = members, best
                    else:
                        longer[1:], longer[0] = members, best
                    members = longer
                    gain, _, _, t_ref = gain_of(nodes, members, model, centre, basis, theta, factor)
                    extending = True
                    break
    return members, gain


@njit(cache=True)
def candidates(
    nodes: Nodes,
    pairs: NDArray[np.int64],
    reach: int,
    floor_rad: float,
    model: Model,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Grow every pair (best first) that no better candidate holds; flat members, offsets (k + 1,), gains (k,)."""
    used = np.zeros(len(nodes.frame) // 2, dtype=np.bool_)
    holder = np.full(len(nodes.frame), -1, dtype=np.int64)
    offsets = np.zeros(len(pairs) + 1, dtype=np.int64)
    gains = np.empty(len(pairs))
    flat = np.empty(max(16, 4 * len(pairs)), dtype=np.int64)
    count = 0
    for s in range(len(pairs)):
        i, j = pairs[s, 0], pairs[s, 1]
        if holder[i] >= 0 and holder[i] == holder[j]:
            continue
        members, gain = grow(nodes, pairs[s], used, reach, floor_rad, model)
        end = offsets[count] + len(members)
        if end > len(flat):
            bigger = np.empty(2 * end, dtype=np.int64)
            bigger[: offsets[count]] = flat[: offsets[count]]
            flat = bigger
        flat[offsets[count] : end] = members
        gains[count] = gain
        for k in members:
            if holder[k] < 0 or gains[holder[k]] < gain:
                holder[k] = count
        count += 1
        offsets[count] = end
    return flat[: offsets[count]], offsets[: count + 1], gains[:count]
