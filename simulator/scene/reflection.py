"""Sunlight on an object: Lambert sphere, tumbling, glints, and the Earth's shadow."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from simulator.platform.earth import AU_KM, EARTH_RADIUS_KM, SUN_RADIUS_KM

Array = NDArray[np.float64]

MIRROR_PHASE: Final = 0.375
"""Light of a mirror-like sphere, a d^2 / 16 R^2 in every direction, over a Lambert sphere's at full phase, a d^2 / 6 R^2."""

SUN_V_MAG: Final = -26.76
"""Apparent V (Vega system) of the Sun at 1 au: absolute V 4.81 (Willmer 2018, ApJS 236, 47, table 3)."""


def lambert_flux(
    size_m: float,
    albedo: float,
    object_km: Array,
    observer_km: Array,
    sun_km: Array,
    *,
    phase_function: bool = True,
    specular: Array | float = 0.0,
) -> Array:
    """Flux of a sunlit Lambert sphere, in units of a V = 0 star; the Earth's shadow is not in it.

    specular : share of its light that goes as from a mirror-like sphere, equally in all directions (phi = 3/8 then).
    ``F = F_sun (a d^2 / 6 R^2) phi(alpha)``, ``phi = (sin alpha + (pi - alpha) cos alpha) / pi``: Bond albedo a of a Lambert
    sphere of diameter d has the geometric albedo 2a/3 (Russell 1916, ApJ 43, 173). Positions (..., 3), GCRS, km.
    Without phase function, ``phi = 1``.
    """
    to_observer = observer_km - object_km
    to_sun = sun_km - object_km
    range2 = np.sum(to_observer * to_observer, axis=-1)
    sun2 = np.sum(to_sun * to_sun, axis=-1)
    cosine = np.clip(np.sum(to_observer * to_sun, axis=-1) / np.sqrt(range2 * sun2), -1.0, 1.0)
    alpha = np.arccos(cosine)
    phase = (np.sin(alpha) + (np.pi - alpha) * cosine) / np.pi if phase_function else 1.0
    phase = (1.0 - specular) * phase + specular * MIRROR_PHASE
    return np.asarray(10.0 ** (-0.4 * SUN_V_MAG) * albedo * size_m**2 * 1e-6 / 6.0 * phase / range2 * AU_KM**2 / sun2)


def sunlit_fraction(object_km: Array, sun_km: Array) -> Array:
    """Share of the Sun's disc that the spherical Earth leaves uncovered, 0 in the umbra (..., 3) -> (...).

    Overlap of two discs (Montenbruck & Gill, Satellite Orbits, section 3.4.2); refraction by the atmosphere is left out.
    """
    to_sun = sun_km - object_km
    sun_distance = np.linalg.norm(to_sun, axis=-1)
    radius = np.linalg.norm(object_km, axis=-1)
    a = np.arcsin(SUN_RADIUS_KM / sun_distance)
    b = np.arcsin(np.clip(EARTH_RADIUS_KM / radius, 0.0, 1.0))
    c = np.arccos(np.clip(-np.sum(object_km * to_sun, axis=-1) / (radius * sun_distance), -1.0, 1.0))
    ring = 1.0 - np.minimum((b / a) ** 2, 1.0)
    out = np.asarray(np.where(c < a - b, ring, np.where(c < b - a, 0.0, 1.0)))
    cut = (c >= np.abs(a - b)) & (c <= a + b)
    a, b, c = a[cut], b[cut], c[cut]
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (c * c + a * a - b * b) / (2.0 * c)
        y = np.sqrt(np.clip(a * a - x * x, 0.0, None))
        overlap = a * a * np.arccos(np.clip(x / a, -1, 1)) + b * b * np.arccos(np.clip((c - x) / b, -1, 1)) - c * y
        out[cut] = np.clip(1.0 - overlap / (np.pi * a * a), 0.0, 1.0)
    return out


def in_sight(object_km: Array, observer_km: Array) -> NDArray[np.bool_]:
    """Whether the spherical Earth leaves the line from observers to objects (..., 3) free."""
    line = object_km - observer_km
    share = np.clip(-np.sum(observer_km * line, axis=-1) / np.sum(line * line, axis=-1), 0.0, 1.0)
    nearest = observer_km + share[..., None] * line
    grounded = np.sum(observer_km * line, axis=-1) >= 0.0  # it looks upwards, from a site too
    return np.asarray(grounded | (np.sum(nearest * nearest, axis=-1) > EARTH_RADIUS_KM**2))


FLASH_REACH: Final = 4.0
"""Sigmas of a flash within which its light falls, but for 6e-5 of it."""


@dataclass(frozen=True, kw_only=True)
class LightCurve:
    """A tumbling body: a sinusoid on its mean brightness, and periodic glints.

    amplitude : half of the peak-to-peak change over the mean, 0 to 1; of it the share `facets` comes twice in a turn, with
    a phase of its own: faces that are not alike. A glint is a Gaussian flash of `glint_factor` times
    the mean flux and `glint_width_s` (sigma), once each period.
    """

    period_s: float = 10.0
    amplitude: float = 0.0
    phase_rad: float = 0.0
    facets: float = 0.0
    facet_phase_rad: float = 0.0
    glint_factor: float = 0.0
    glint_width_s: float = 0.01

    def factor(self, time_s: Array) -> Array:
        """Brightness relative to the mean of the steady body."""
        angle = 2.0 * np.pi * time_s / self.period_s + self.phase_rad
        steady = 1.0 + self.amplitude * (
            (1.0 - self.facets) * np.sin(angle) + self.facets * np.sin(2.0 * angle + self.facet_phase_rad)
        )
        if self.glint_factor == 0.0:
            return np.asarray(steady)
        since = (np.mod(angle + np.pi, 2.0 * np.pi) - np.pi) * self.period_s / (2.0 * np.pi)
        return np.asarray(steady + self.glint_factor * np.exp(-0.5 * (since / self.glint_width_s) ** 2))

    def mean_factor(self, start_s: Array, end_s: Array) -> Array:
        """Mean brightness between pairs of times, in closed form: a flash shorter than the interval keeps its light."""
        half_turn = np.pi * (end_s - start_s) / self.period_s
        middle = np.pi * (start_s + end_s) / self.period_s + self.phase_rad
        once = np.sin(middle) * np.sinc(half_turn / np.pi)
        twice = np.sin(2.0 * middle + self.facet_phase_rad) * np.sinc(2.0 * half_turn / np.pi)
        steady = 1.0 + self.amplitude * ((1.0 - self.facets) * once + self.facets * twice)
        if np.all(self.glint_factor == 0.0):
            return np.asarray(steady)
        flashes = self._flash_integral(end_s) - self._flash_integral(start_s)
        return np.asarray(steady + self.glint_factor * flashes / (end_s - start_s))

    def _flash_integral(self, time_s: Array) -> Array:
        """Integral (s) of the flashes, each of peak 1 and cut half a period from its peak, up to times."""
        turns = time_s / self.period_s + self.phase_rad / (2.0 * np.pi) + 0.5
        whole = np.floor(turns)
        since = (turns - whole - 0.5) * self.period_s
        width = self.glint_width_s
        cut = ndtr(-0.5 * self.period_s / width)
        return np.asarray(np.sqrt(2.0 * np.pi) * width * (whole * (1.0 - 2.0 * cut) + ndtr(since / width) - cut))

    def flashes_s(self, from_s: float, to_s: float) -> Array:
        """Times of the peaks of the flashes whose light falls between two times; none without glints."""
        if self.glint_factor == 0.0:
            return np.zeros(0)
        reach = min(FLASH_REACH * self.glint_width_s, 0.5 * self.period_s)
        shift = self.phase_rad / (2.0 * np.pi)
        first = np.ceil((from_s - reach) / self.period_s + shift)
        last = np.floor((to_s + reach) / self.period_s + shift)
        return np.asarray((np.arange(first, last + 1.0) - shift) * self.period_s)


STEADY: Final = LightCurve()
