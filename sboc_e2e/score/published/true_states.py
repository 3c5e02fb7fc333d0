"""True orbit states of objects, put together from their trails: direction, range and place of the camera."""

from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from sboc_e2e.score.published.axes import unit_vectors
from sboc_e2e.score.published.gravity import propagated
from sboc_e2e.score.published.true_motion import TrueObserver

Array = NDArray[np.float64]

LIGHT_KM_S: Final = speed_of_light / 1e3
"""Exact by the definition of the metre (SI)."""
FARTHEST_S: Final = 600.0
"""How far from an object's trails a state is compared; gravity is known well enough for more, drag is not."""

_MOST_POINTS: Final = 8
"""Number of trails nearest in time from which a state is made. More trails add no accuracy."""

_ROUNDS: Final = 4  # Six orbits, states 300 s outside trails over 1.75 to 100 s: three rounds give the places of eight to 1 um.


class TrueOrbits:
    """States of objects of a run near the times of their trails."""

    def __init__(self, streaks: Table, objects: Table, observer: TrueObserver | None) -> None:
        """streaks, objects : truth tables. Objects without elements are in no orbit, those without ranges at no place."""
        self._arcs: dict[int, tuple[NDArray[np.int64], Array]] = {}
        if observer is None or not len(streaks):
            return
        owner, range_km = np.asarray(streaks["object_id"], int), np.asarray(streaks["range_km"], float)
        orbiting = {int(o["object_id"]) for o in objects if np.isfinite(float(o["a_km"])) and float(o["a_km"]) != 0.0}
        middle = np.asarray(streaks["path_t_tai_ns"]).shape[1] // 2
        t_ns = np.asarray(streaks["path_t_tai_ns"], np.int64)[:, middle]
        direction = unit_vectors(
            np.asarray(streaks["path_ra_deg"], float)[:, middle], np.asarray(streaks["path_dec_deg"], float)[:, middle]
        )
        position = observer.at(t_ns)[:, :3] * 1e-3 + range_km[:, None] * direction
        left_ns = t_ns - np.rint(np.nan_to_num(range_km) / LIGHT_KM_S * 1e9).astype(np.int64)
        known = np.isfinite(position).all(axis=1) & (range_km > 0.0)
        for number in np.unique(owner[known]):
            rows = np.flatnonzero(known & (owner == number))
            if int(number) in orbiting and len(np.unique(left_ns[rows])) > 1:
                rows = rows[np.argsort(left_ns[rows], kind="stable")]
                self._arcs[int(number)] = left_ns[rows], position[rows]

    def __bool__(self) -> bool:
        """Whether any object has a state."""
        return bool(self._arcs)

    def state(self, number: int, t_tai_ns: int) -> Array | None:
        """State (6,) km, km/s of an object at an instant; None where the truth does not tell."""
        if number not in self._arcs:
            return None
        times, positions = self._arcs[number]
        if max(int(times[0]) - t_tai_ns, t_tai_ns - int(times[-1])) > FARTHEST_S * 1e9:
            return None
        chosen = np.sort(np.argsort(np.abs(times - t_tai_ns), kind="stable")[:_MOST_POINTS])
        return _fitted(times[chosen], positions[chosen], t_tai_ns)


def _fitted(t_ns: NDArray[np.int64], positions: Array, at_ns: int) -> Array:
    """State (6,) at an instant of a free body that passes positions (n, 3) km at their times, n >= 2.

    Gravity is taken from the last round's state; what it lacks or has too much of is a polynomial, linear in its first two
    coefficients, of up to third degree, so that the states rest on the positions and not on a model, but outside their times.
    """
    origin = int(t_ns[len(t_ns) // 2])
    t_s = (t_ns - origin) * 1e-9
    degree = min(len(t_s) - 1, 3)
    design = np.vander(t_s, degree + 1, increasing=True)
    bent = np.zeros_like(positions)
    coefficients = np.zeros((degree + 1, 3))
    for _ in range(_ROUNDS):
        coefficients, *_ = np.linalg.lstsq(design, positions - bent, rcond=None)
        state = coefficients[:2].ravel()
        bent = np.array([propagated(state, float(t))[:3] - state[:3] - t * state[3:] for t in t_s])
    wanted_s = (at_ns - origin) * 1e-9
    inside_s = float(np.clip(wanted_s, t_s[0], t_s[-1]))
    state = propagated(coefficients[:2].ravel(), inside_s)
    for k in range(2, degree + 1):
        state += np.concatenate([coefficients[k] * inside_s**k, k * coefficients[k] * inside_s ** (k - 1)])
    return propagated(state, wanted_s - inside_s)
