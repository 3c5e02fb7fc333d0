"""Weighted samples of orbit states: a table of products/ that is known by its columns."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.score.published.axes import AXES
from sboc_e2e.score.published.kvn import UnreadableProduct

Array = NDArray[np.float64]

_POSITION: Final = ("x_km", "y_km", "z_km")
_VELOCITIES: Final = (("vx_km_s", "vy_km_s", "vz_km_s"), ("x_dot_km_s", "y_dot_km_s", "z_dot_km_s"))
_EPOCHS: Final = ("t_tai_ns", "t_ref_tai_ns")


@dataclass(frozen=True, kw_only=True, eq=False)
class StateSamples:
    """Posterior of one tracklet: weight (n,) of sum 1, state (n, 6) km, km/s, turned to GCRS axes, all at one epoch."""

    tracklet_id: int
    t_tai_ns: int
    weight: Array
    state: Array


def read_samples(path: Path) -> tuple[StateSamples, ...]:
    """Samples of all tracklets of a table. Raises UnreadableProduct where a column is missing or a number makes no sense."""
    table = Table.read(path, format="ascii.ecsv")
    velocity = next((names for names in _VELOCITIES if names[0] in table.colnames), _VELOCITIES[0])
    epoch = next((name for name in _EPOCHS if name in table.colnames), _EPOCHS[0])
    wanted = ("tracklet_id", "weight", epoch, *_POSITION, *velocity)
    missing = [name for name in wanted if name not in table.colnames]
    if missing:
        raise UnreadableProduct(f"{path.name}: lacks the columns {', '.join(missing)}")
    description = str(table[_POSITION[0]].description or "")
    axes = next((matrix for name, matrix in AXES.items() if name in description), None)
    if axes is None:
        raise UnreadableProduct(f"{path.name}: the description of {_POSITION[0]} names none of the axes {', '.join(AXES)}")
    tracklet, t_ns = np.asarray(table["tracklet_id"], int), np.asarray(table[epoch], np.int64)
    weight = np.asarray(table["weight"], float)
    state = np.stack([np.asarray(table[name], float) for name in (*_POSITION, *velocity)], axis=1)
    state = (state.reshape(-1, 2, 3) @ axes.T).reshape(-1, 6)
    if not (np.isfinite(state).all() and np.isfinite(weight).all() and (weight >= 0.0).all()):
        raise UnreadableProduct(f"{path.name}: expected finite states and weights that are not negative")
    out = []
    for number in np.unique(tracklet):
        rows = tracklet == number
        if len(np.unique(t_ns[rows])) > 1 or weight[rows].sum() <= 0.0:
            raise UnreadableProduct(f"{path.name}: tracklet {number}: expected one epoch and a sum of weights above 0")
        out.append(
            StateSamples(
                tracklet_id=int(number), t_tai_ns=int(t_ns[rows][0]), weight=weight[rows] / weight[rows].sum(), state=state[rows]
            )
        )
    return tuple(out)
