"""Lists of objects that are seen for half a minute in each visit."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simulator.platform.all_forces import between
from tests.association.list_simulator import Seen, Survey, light, observer_states, survey


def of_half_minutes(seed: int, hours: Sequence[float]) -> Survey:
    """Three geostationary objects in visits of 30 s at some hours, 24 directions of 0.75 arcsec each."""
    one = survey(seed, objects=3, clutter=0, days=3.0)
    rng, sigma = np.random.default_rng([seed, 3]), math.radians(0.75 / 3600.0)
    seen = []
    for hour in hours:
        for k in range(3):
            t = 3600.0 * hour + 60.0 + np.linspace(0.0, 30.0, 24)
            observer = observer_states(t, one.sky.sun[0])
            line = light(between(one.truth[k], t), observer) + sigma * rng.normal(size=(24, 3))
            line /= np.linalg.norm(line, axis=1, keepdims=True)
            seen.append(Seen(owner=k, t_s=t, observer=observer, direction=line))
    return replace(one, seen=seen, sigma_rad=sigma)
