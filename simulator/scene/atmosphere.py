"""The atmosphere over a ground site: refraction, extinction, seeing, scintillation, clouds and sky glow."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform.earth import EARTH_RADIUS_KM
from simulator.platform.earth_orientation import ARCSEC_RAD
from simulator.randomness import Effect, generator
from simulator.scene.clouds import CloudLayer, draw_clouds
from simulator.scene.turbulence import Unsteadiness, crossing_s, draw_unsteadiness, tilt_variance_rad2

Array = NDArray[np.float64]

SCALE_HEIGHT_KM = 8.0
"""Of air at 273 K: R T / g = 287.05 x 273.15 / 9.80665 m = 8.0 km."""
LOWEST_DEG = 8.0
"""Fields below this elevation are refused: the expansions of refraction and air mass end there."""


@dataclass(frozen=True, kw_only=True)
class AtmosphereOptions:
    """The air above a site; a camera in orbit has none."""

    temperature_k: float = field(default=288.15, metadata={"doc": "air temperature at the site", "min": 200.0, "max": 330.0})
    pressure: float = field(
        default=1.0, metadata={"doc": "pressure over the standard one at the site's height", "min": 0.0, "max": 1.3}
    )
    humidity: float = field(default=0.4, metadata={"doc": "relative humidity", "min": 0.0, "max": 1.0})
    wavelength_nm: float = field(
        default=600.0, metadata={"doc": "effective wavelength of refraction", "min": 300.0, "max": 2500.0}
    )
    extinction_mag: float = field(default=0.15, metadata={"doc": "extinction for each air mass", "min": 0.0, "max": 5.0})
    seeing_arcsec: float = field(default=1.5, metadata={"doc": "FWHM at the zenith", "min": 0.0, "max": 60.0})
    seeing_error: float = field(
        default=0.0, metadata={"doc": "the night's seeing over that of the camera file, less 1", "min": -0.5, "max": 5.0}
    )
    scintillation: bool = field(default=True, metadata={"doc": "stars and objects scintillate"})
    image_motion: bool = field(default=True, metadata={"doc": "objects wander in the seeing disc during an exposure"})
    wind_m_s: float = field(
        default=10.0, metadata={"doc": "wind that carries the turbulence over the aperture", "min": 0.5, "max": 100.0}
    )
    outer_scale_m: float = field(default=20.0, metadata={"doc": "outer scale of the turbulence", "min": 1.0, "max": 1e4})
    glow_mag_arcsec2: float = field(
        default=21.8, metadata={"doc": "airglow and scattered light at the zenith, V", "min": 5.0, "max": 30.0}
    )
    cloud_transmission: float = field(default=1.0, metadata={"doc": "mean transmission of clouds", "min": 0.0, "max": 1.0})
    cloud_variation: float = field(default=0.0, metadata={"doc": "rms change of it over the layer", "min": 0.0, "max": 0.5})
    cloud_height_km: float = field(default=5.0, metadata={"doc": "height of the layer above the site", "min": 0.1, "max": 20.0})
    cloud_scale_km: float = field(default=4.0, metadata={"doc": "largest structures of the layer", "min": 0.01, "max": 1e3})
    cloud_wind_m_s: float = field(default=15.0, metadata={"doc": "wind that carries the layer", "min": 0.0, "max": 150.0})
    cloud_heading_deg: float = field(
        default=90.0, metadata={"doc": "where it goes, from north to east", "min": -360.0, "max": 360.0}
    )


def clouds_of(options: AtmosphereOptions, seed: int) -> CloudLayer:
    """The cloud layer of a run."""
    return draw_clouds(
        options.cloud_transmission,
        options.cloud_variation,
        options.cloud_height_km,
        options.cloud_scale_km,
        options.cloud_wind_m_s,
        options.cloud_heading_deg,
        seed,
    )


def refractivity(wavelength_um: float, pressure_hpa: float, temperature_k: float, humidity: float) -> float:
    """``n - 1`` of air: Edlen 1953 (JOSA 43, 339) scaled by density, water vapour by Edlen 1966 (Metrologia 2, 71)."""
    sigma2 = 1.0 / wavelength_um**2
    standard = 1e-8 * (6432.8 + 2949810.0 / (146.0 - sigma2) + 25540.0 / (41.0 - sigma2))
    celsius = temperature_k - 273.15
    vapour_hpa = humidity * 6.112 * np.exp(17.62 * celsius / (243.12 + celsius))  # Magnus; WMO guide no. 8
    dry = standard * (pressure_hpa / 1013.25) * (288.15 / temperature_k)
    return float(dry - 1e-8 * (5.722 - 0.0457 * sigma2) * vapour_hpa * 0.750062)


def standard_pressure_hpa(height_m: float) -> float:
    """Pressure of the US Standard Atmosphere 1976 below 11 km."""
    return float(1013.25 * (1.0 - 2.25577e-5 * height_m) ** 5.25588)


def refraction_constants(n_minus_1: float, temperature_k: float) -> tuple[float, float]:
    """A and B (rad) of ``R = A tan z + B tan^3 z``, z the observed zenith distance (Stone 1996, PASP 108, 1051, eq. 4-9)."""
    beta = 0.001254 * temperature_k / 273.15
    return n_minus_1 * (1.0 - beta), -n_minus_1 * (beta - 0.5 * n_minus_1)


def air_mass(cos_zenith: Array) -> Array:
    """Air mass of a true zenith distance (Young 1994, Appl. Opt. 33, 1108)."""
    c = cos_zenith
    return np.asarray((1.002432 * c * c + 0.148386 * c + 0.0096467) / (c**3 + 0.149864 * c * c + 0.0102963 * c + 0.000303978))


def scintillation_rms(aperture_m: float, mass: Array | float, height_m: float, exposure_s: float) -> Array:
    """Relative rms of the flux: ``0.09 D^(-2/3) X^1.75 exp(-h/8000) / sqrt(2 T)``, D in cm (Young 1967, AJ 72, 747)."""
    diameter_cm = 100.0 * aperture_m
    return np.asarray(
        0.09 * diameter_cm ** (-2 / 3) * np.asarray(mass) ** 1.75 * np.exp(-height_m / 8000.0) / np.sqrt(2.0 * exposure_s)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Atmosphere:
    """The air at one instant. up : (3,) zenith of the site, GCRS axes; time_s : seconds after the epoch of the run."""

    options: AtmosphereOptions
    up: Array
    height_m: float
    clouds: CloudLayer
    time_s: float

    @property
    def _n_minus_1(self) -> float:
        o = self.options
        return refractivity(
            o.wavelength_nm * 1e-3, o.pressure * standard_pressure_hpa(self.height_m), o.temperature_k, o.humidity
        )

    def refracted(self, directions: Array, range_km: Array | float = np.inf) -> Array:
        """Directions (n, 3) lifted towards the zenith.

        An object at a finite range is lifted less: a ray bends on its last kilometres, and a bend by dR at a distance s moves
        the object by dR (d - s) / d, which takes ``(n - 1) H tan z sec z / d`` away in a layer of scale height H.
        """
        n_minus_1 = self._n_minus_1
        a, b = refraction_constants(n_minus_1, self.options.temperature_k)
        cosine = np.clip(directions @ self.up, np.sin(np.radians(1.0)), 1.0)
        true_zenith = np.arccos(cosine)
        observed = true_zenith
        for _ in range(4):
            tangent = np.tan(observed)
            near = n_minus_1 * SCALE_HEIGHT_KM * tangent / np.cos(observed) / range_km
            observed = true_zenith - (a * tangent + b * tangent**3 - near)
        return _lifted(directions, self.up, true_zenith - observed)

    def unrefracted(self, directions: Array) -> Array:
        """True directions of distant sources that are seen in directions (n, 3)."""
        a, b = refraction_constants(self._n_minus_1, self.options.temperature_k)
        tangent = np.tan(np.arccos(np.clip(directions @ self.up, np.sin(np.radians(1.0)), 1.0)))
        return _lifted(directions, self.up, -(a * tangent + b * tangent**3))

    def mass(self, directions: Array) -> Array:
        """Air mass in directions (n, 3)."""
        return air_mass(np.clip(directions @ self.up, 0.02, 1.0))

    def transmission(self, directions: Array) -> Array:
        """Extinction times clouds in directions (n, 3)."""
        clear = 10.0 ** (-0.4 * self.options.extinction_mag * self.mass(directions))
        return np.asarray(clear * self.clouds.transmission(directions, self.up, self.time_s))

    def seeing_sigma_rad(self, direction: Array) -> float:
        """Gaussian sigma of the seeing disc; it grows with the 0.6th power of air mass (Kolmogorov)."""
        return float(self.options.seeing_arcsec / 2.354820 * ARCSEC_RAD * self.mass(direction[None])[0] ** 0.6)

    def flicker(
        self, n: int, direction: Array, aperture_m: float, exposure_s: float, seed: int, frame: int, block: int = 0
    ) -> Array:
        """Log-normal factors (n,) of mean 1 with Young's rms at the air mass of a direction: stars of a whole exposure."""
        if not self.options.scintillation:
            return np.ones(n)
        rms = scintillation_rms(aperture_m, self.mass(direction[None]), self.height_m, exposure_s)[0]
        sigma2 = np.log1p(rms**2)
        draw = generator(seed, Effect.SCINTILLATION, frame, block).standard_normal(n)
        return np.asarray(np.exp(np.sqrt(sigma2) * draw - 0.5 * sigma2))

    def unsteadiness(
        self, direction: Array, aperture_m: float, from_s: float, to_s: float, rng: np.random.Generator
    ) -> Unsteadiness | None:
        """Effect of turbulence on an object in a direction (3,) between two times; None with both effects switched off."""
        o = self.options
        if not (o.scintillation or o.image_motion):
            return None
        rms = float(scintillation_rms(aperture_m, self.mass(direction[None]), self.height_m, 1.0)[0])
        sigma_rad = self.seeing_sigma_rad(direction)
        return draw_unsteadiness(
            rng,
            from_s=from_s,
            to_s=to_s,
            crossing=crossing_s(aperture_m, o.wind_m_s),
            long_exposure_rms_1s=rms if o.scintillation else 0.0,
            tilt_variance=tilt_variance_rad2(sigma_rad, o.wavelength_nm * 1e-9, aperture_m) if o.image_motion else 0.0,
            lowest_hz=o.wind_m_s / o.outer_scale_m,
        )

    def glow_flux(self, directions: Array) -> Array:
        """Glow of a square arcsecond in units of a V = 0 star, in directions (n, 3).

        A thin layer 90 km up is seen ``(1 - (sin z / (1 + h/R))^2)^-1/2`` times deeper (van Rhijn 1921), less the extinction
        beyond that of the zenith.
        """
        o = self.options
        cosine = np.clip(directions @ self.up, 0.02, 1.0)
        depth = 1.0 / np.sqrt(1.0 - (1.0 - cosine**2) / (1.0 + 90.0 / EARTH_RADIUS_KM) ** 2)
        return np.asarray(10.0 ** (-0.4 * (o.glow_mag_arcsec2 + o.extinction_mag * (self.mass(directions) - 1.0))) * depth)

    def moonlight(self, directions: Array, moon_direction: Array, moon_v0: float) -> Array:
        """Moonlight that the air scatters from a square arcsecond in directions (n, 3), in units of a V = 0 star.

        Krisciunas & Schaefer 1991, PASP 103, 1033, eq. 1, 3, 8, 15 and 21; they find it good to 8 to 23 %.
        `moon_v0` : the Moon's light outside the air, in units of a V = 0 star.
        """
        moon_sine2 = 1.0 - float(moon_direction @ self.up) ** 2
        sine2 = 1.0 - np.clip(directions @ self.up, 0.0, 1.0) ** 2
        masses = (1.0 - 0.96 * moon_sine2) ** -0.5, (1.0 - 0.96 * sine2) ** -0.5
        cosine = np.clip(directions @ moon_direction, -1.0, 1.0)
        apart_deg = np.degrees(np.arccos(cosine))
        scattering = 10.0**5.36 * (1.06 + cosine**2) + 10.0 ** (6.15 - apart_deg / 40.0)
        k = self.options.extinction_mag
        illuminance = moon_v0 * 10.0 ** (-0.4 * 16.57)
        nanolambert = scattering * illuminance * 10.0 ** (-0.4 * k * masses[0]) * (1.0 - 10.0 ** (-0.4 * k * masses[1]))
        return np.asarray(nanolambert / 34.08 * np.exp(-20.7233))

    def refuse_low(self, direction: Array) -> None:
        """UserError when a field centre stands too low."""
        elevation_deg = float(np.degrees(np.arcsin(direction @ self.up)))
        if elevation_deg < LOWEST_DEG:
            raise UserError(
                f"pointing: the field stands at {elevation_deg:.1f} deg elevation; allowed is above {LOWEST_DEG:g} deg"
            )


def seeing_sigma_rad(air: Atmosphere, boresight: Array) -> float:
    """Sigma of the seeing disc in the middle of a field.

    UserError for a field that stands too low.
    """
    air.refuse_low(boresight)
    return air.seeing_sigma_rad(boresight)


def _lifted(directions: Array, up: Array, angle_rad: Array) -> Array:
    """Directions (n, 3) turned towards the zenith by angles (n,)."""
    upwards = up - (directions @ up)[:, None] * directions
    length = np.linalg.norm(upwards, axis=1, keepdims=True)
    towards = upwards / np.maximum(length, 1e-15)
    return np.asarray(np.cos(angle_rad)[:, None] * directions + np.sin(angle_rad)[:, None] * towards)
