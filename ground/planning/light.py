"""How bright a target is in one exposure, and how well its direction can then be measured."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.planning.constraints import Visibility

Array = NDArray[np.float64]

SUN_V_MAG: Final = -26.76
"""Willmer 2018, ApJS 236, 47."""
FRAME_ERROR_PX: Final = 0.03
"""Of the frame solution: 0.15 arcsec at 4.6 arcsec per pixel, as the chain measures in `sso_antisun`."""


@dataclass(frozen=True, kw_only=True)
class PlannedCamera:
    """What the plan must know of a camera.

    zero_point_e_s : electrons per second of V = 0, outside the air. period_s : from one exposure to the next. sigma_px : of the
    PSF, the width of a pixel included. scale_arcsec : of a pixel. noise_e : rms of a pixel in an exposure, sky included.
    half_field_rad : radius of the circle inscribed in the field. extinction_mag : for each air mass. seeing_sigma_px : of the
    seeing disc at the zenith.
    """

    zero_point_e_s: float
    exposure_s: float
    period_s: float
    noise_e: float
    sigma_px: float
    scale_arcsec: float
    half_field_rad: float
    extinction_mag: float = 0.0
    seeing_sigma_px: float = 0.0

    def width_px(self, air_mass: Array | float) -> Array:
        """Sigma of a point at air masses, 0 in orbit; the seeing disc grows with their 0.6th power (Kolmogorov)."""
        return np.asarray(np.hypot(self.sigma_px, self.seeing_sigma_px * np.asarray(air_mass) ** 0.6))


def magnitudes(size_m: Array, albedo: float, seen: Visibility) -> Array:
    """V (m, n), outside the air, of diffuse (Lambert) spheres of diameters (m,): Russell 1916, ApJ 43, 173; the Sun at 1 au."""
    phase = seen.phase_rad
    shape = (np.sin(phase) + (np.pi - phase) * np.cos(phase)) / np.pi
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = albedo * (size_m[:, None] * 1e-3) ** 2 / 6.0 * np.maximum(shape, 0.0) / seen.range_km**2
        return np.asarray(SUN_V_MAG - 2.5 * np.log10(ratio))


def snr_of(magnitude: Array, rate_rad_s: Array, camera: PlannedCamera, air_mass: Array | float = 0.0) -> Array:
    """S/N of a trail, its own photons included: ``F / sqrt(V A + F)`` with the effective area A in pixels.

    ``A = sqrt(4 pi) s sqrt(4 pi s^2 + L^2)`` is 4 pi s^2 for a point and 2 sqrt(pi) s L for a long trail (the inverse of the
    integral of the squared profile), and at most 4 % off in between. magnitude : V outside the air. air_mass : 0 in orbit.
    """
    seen_mag = magnitude + camera.extinction_mag * np.asarray(air_mass)
    flux_e = camera.zero_point_e_s * 10.0 ** (-0.4 * seen_mag) * camera.exposure_s
    length_px = np.degrees(rate_rad_s) * 3600.0 * camera.exposure_s / camera.scale_arcsec
    point = 4.0 * np.pi * camera.width_px(air_mass) ** 2
    area_px = np.sqrt(point) * np.sqrt(point + length_px**2)
    return np.asarray(flux_e / np.sqrt(camera.noise_e**2 * area_px + flux_e))


def angle_sigma_rad(snr: Array, rate_rad_s: Array, camera: PlannedCamera, exposures: int, air_mass: Array | float = 0.0) -> Array:
    """Error of a visit's mean direction, rms of both coordinates: that of a centroid, whose variance along a trail is larger.

    Across it is ``s / S/N``, along it ``sqrt(s^2 + L^2 / 12) / S/N``; frame solution and PSF add `FRAME_ERROR_PX` to each frame.
    """
    length_px = np.degrees(rate_rad_s) * 3600.0 * camera.exposure_s / camera.scale_arcsec
    sigma_px = np.sqrt(camera.width_px(air_mass) ** 2 + length_px**2 / 24.0) / np.maximum(snr, 1e-9)
    sigma_px = np.sqrt(sigma_px**2 + FRAME_ERROR_PX**2) / np.sqrt(exposures)
    return np.asarray(np.radians(sigma_px * camera.scale_arcsec / 3600.0))
