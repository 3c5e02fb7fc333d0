"""Where the camera was: one orbit through the positions and velocities of all headers near a tracklet."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ground.orbit.dynamics import propagate
from sboc_e2e.icd.frame import FrameHeader

_NEIGHBOURHOOD_S = 30.0
"""Headers this far from a tracklet still help to average the noise of GPS; J2 orbits hold to centimetres that long."""


def observer_orbit(headers: Sequence[FrameHeader], t_first_ns: int, t_last_ns: int, t_ref_ns: int) -> NDArray[np.float64] | None:
    """State (6,) km, km/s at `t_ref_ns` fitted to the telemetered states near the interval; None when there are none."""
    near = [
        h.observer
        for h in headers
        if h.observer is not None
        and t_first_ns - _NEIGHBOURHOOD_S * 1e9 <= h.observer.tai_ns <= t_last_ns + _NEIGHBOURHOOD_S * 1e9
    ]
    if not near:
        return None
    t_s = np.array([(o.tai_ns - t_ref_ns) * 1e-9 for o in near])
    states = np.array([np.concatenate([o.position_m, o.velocity_m_s]) * 1e-3 for o in near])
    sigma = np.array([[max(o.sigma_position_m, 0.1)] * 3 + [max(o.sigma_velocity_m_s, 1e-3)] * 3 for o in near]) * 1e-3
    closest = int(np.argmin(np.abs(t_s)))
    reference = propagate(states[closest], np.array([-t_s[closest]]))[0]
    step = np.array([1e-2] * 3 + [1e-5] * 3)
    for _ in range(2):
        predicted = propagate(reference, t_s)
        jacobian = np.stack([(propagate(reference + dx, t_s) - predicted) / dx.sum() for dx in np.diag(step)], axis=-1)
        design = (jacobian / sigma[:, :, None]).reshape(-1, 6)
        residual = ((states - predicted) / sigma).ravel()
        scale = np.linalg.norm(design, axis=0)
        solution, *_ = np.linalg.lstsq(design / scale, residual, rcond=None)
        reference = reference + solution / scale
    return reference
