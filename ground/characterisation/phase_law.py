"""How an object's light falls with the phase angle: a diffuse and a mirror-like sphere, mixed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.characterisation.passes import LightPass

Array = NDArray[np.float64]

LEAST_SPREAD_RAD: Final = np.radians(20.0)
"""Phases that differ by less do not tell the two laws apart."""

_POGSON: Final = 2.5 / np.log(10.0)


@dataclass(frozen=True, kw_only=True)
class PhaseLaw:
    """standard_mag : V at 1,000 km and a phase of 90 deg, with its error from the scatter of the passes; diffuse : share of the
    light at that phase that a diffuse sphere would give, 0 to 1, with its error; NaN where the phases are too alike to tell.
    """

    standard_mag: float
    standard_mag_err: float
    diffuse: float = float("nan")
    diffuse_err: float = float("nan")


def diffuse_sphere(phase_rad: Array) -> Array:
    """Light of a Lambert sphere over that at 90 deg: (sin p + (pi - p) cos p) (Lambert 1760; 1 at 90 deg)."""
    return np.asarray(np.sin(phase_rad) + (np.pi - phase_rad) * np.cos(phase_rad))


def phase_law(passes: Sequence[LightPass]) -> PhaseLaw:
    """Non-negative mixture of both spheres, by least squares of the mean light of each pass; errors by leaving passes out.

    A mirror-like sphere is as bright at every phase. One pass gives the magnitude of a diffuse sphere, without an error.
    """
    used = [p for p in passes if len(p.t_s)]
    if not used:
        return PhaseLaw(standard_mag=float("nan"), standard_mag_err=float("nan"))
    phase = np.array([float(np.mean(p.phase_rad)) for p in used])
    light = np.array([float(np.mean(10.0 ** (-0.4 * p.mag))) for p in used])
    spread = float(np.ptp(phase))
    mixed = len(used) >= 3 and spread >= LEAST_SPREAD_RAD
    whole, share = _fit(phase, light, mixed)
    if len(used) == 1:
        return PhaseLaw(standard_mag=-_POGSON * float(np.log(whole)), standard_mag_err=float("nan"))
    kept = [np.delete(np.arange(len(used)), k) for k in range(len(used))]
    parts = np.array([_fit(phase[k], light[k], mixed) for k in kept])
    error = np.sqrt((len(used) - 1.0) * np.var(np.column_stack([np.log(parts[:, 0]), parts[:, 1]]), axis=0))
    return PhaseLaw(
        standard_mag=-_POGSON * float(np.log(whole)),
        standard_mag_err=_POGSON * float(error[0]),
        diffuse=share if mixed else float("nan"),
        diffuse_err=float(error[1]) if mixed else float("nan"),
    )


def _fit(phase: Array, light: Array, mixed: bool) -> tuple[float, float]:
    """Light at 90 deg and the diffuse share of it, relative errors alike."""
    law = diffuse_sphere(phase)
    if not mixed:
        return float(np.exp(np.mean(np.log(light / law)))), 1.0
    shares = np.linspace(0.0, 1.0, 101)
    logs = np.log(light) - np.log(shares[:, None] * law + (1.0 - shares[:, None]))
    best = int(np.argmin(np.var(logs, axis=1)))
    return float(np.exp(np.mean(logs[best]))), float(shares[best])
