"""Clouds over a ground site: one layer of uneven transmission that the wind carries along."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.randomness import Effect, generator

Array = NDArray[np.float64]

_WAVES: Final = 96
"""Of the field, 16 for each octave of scale: time against repetition. Chosen, not measured."""
_FINEST: Final = 64.0
"""Largest over smallest structure that is drawn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CloudLayer:
    """Transmission ``mean + rms x field``, cut to 0 to 1; the field is a sum of plane waves of variance 1 over the layer.

    Powers fall as k^(-2/3) for each octave, Kolmogorov's spectrum in a plane, which optical depth of clouds follows between
    about 0.1 and 10 km (Davis et al. 1996, J. Atmos. Sci. 53, 1538).
    height_km : of the layer. wave_km : (n, 2) wave vectors, rad/km east and north. drift_km_s : (2,) of the layer.
    """

    mean: float
    rms: float
    height_km: float
    wave_km: Array
    amplitude: Array
    phase_rad: Array
    drift_km_s: Array

    def transmission(self, directions: Array, up: Array, time_s: float) -> Array:
        """Transmission in directions (n, 3) above a site with a zenith (3,), both GCRS, seconds after the epoch of the run."""
        if self.rms == 0.0:
            return np.full(len(directions), self.mean)
        east = np.cross([0.0, 0.0, 1.0], up) + np.array([0.0, 1e-12, 0.0])  # at a pole any direction will do
        east /= np.linalg.norm(east)
        north = np.cross(up, east)
        climb = np.clip(directions @ up, 0.05, 1.0)
        place_km = np.stack([directions @ east, directions @ north], axis=1) * (self.height_km / climb)[:, None]
        angle = (place_km - self.drift_km_s * time_s) @ self.wave_km.T + self.phase_rad
        return np.asarray(np.clip(self.mean + self.rms * (np.cos(angle) @ self.amplitude), 0.0, 1.0))


def draw_clouds(
    mean: float, rms: float, height_km: float, scale_km: float, wind_m_s: float, heading_deg: float, seed: int
) -> CloudLayer:
    """The layer of a seed. scale_km : of its largest structures; heading_deg : where it goes, from north to east."""
    rng = generator(seed, Effect.CLOUDS)
    wave = 2.0 * np.pi / scale_km * _FINEST ** ((np.arange(_WAVES) + rng.random(_WAVES)) / _WAVES)
    turn = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    power = wave ** (-2.0 / 3.0)
    heading = np.radians(heading_deg)
    return CloudLayer(
        mean=mean,
        rms=rms,
        height_km=height_km,
        wave_km=wave[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1),
        amplitude=np.sqrt(2.0 * power / power.sum()),
        phase_rad=rng.uniform(0.0, 2.0 * np.pi, _WAVES),
        drift_km_s=1e-3 * wind_m_s * np.array([np.sin(heading), np.cos(heading)]),
    )
