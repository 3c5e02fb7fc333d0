"""Contribution of one object in Earth orbit to a run: rate of crossings, brightness, speed and place.

Candidates are points of the field's pyramid at random frames, each on an orbit of the prior (`ground.orbit`) that passes through
it. An orbit (a, e, i) of uniform node, perigee and anomaly has at radius r and latitude b the density (Kessler 1981, Icarus
48, 39)

    1 / (2 pi^3 r a sqrt((sin^2 i - sin^2 b) (r - q) (Q - r)))        objects / km^3

and an object that stays in the field for D of the W seconds watched is met at a random instant with probability D / W. Time
between frames that did not come down belongs to neither.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from ground.orbit.breakup import draw_breakup, draw_catalogue
from ground.orbit.dynamics import MU_KM3_S2
from ground.orbit.range_scan import SMALL_BELOW_M
from ground.orbit.size import SUN_V_MAG, lambert_phase, log_size_density
from ground.sky.shadow import before_the_earth, sunlit

Array = NDArray[np.float64]

NEAREST_KM: Final = 0.05
"""Where the range scan of tracklets begins, too (`range_scan`: nearest)."""
AU_KM: Final = float(erfa.DAU / 1e3)
"""IAU 2012 resolution B2. The Sun's distance varies by 1.7 %, which the Earth's shadow does not feel."""
NEAR_SHARE: Final = 100.0
"""Ranges below a hundredth of the reach hold a millionth of the volume."""

SLOWEST_DEG_S: Final = 0.1
"""Slower objects share the camera's orbit or are far beyond low orbits. They are left out of the counts and of the exposure."""

FRAMES_EACH: Final = 12
"""Largest number of frames, evenly spread over its stay, in which each object is evaluated."""

CELL_KM: Final = 25.0
"""One altitude bin of the prior's debris histogram, within which the prior knows no more."""
CELL_SINE: Final = 0.02
"""Half widths of the cell over which the density of an orbit is averaged."""

SAME_STEP_S: Final = 1e-6
"""Steps between frames that differ less are the same: epochs are whole nanoseconds, cadences seldom are."""

FLUX_ROUNDS: Final = 4
"""Each orbit is met at this many random instants; a mean over all orbits needs few of each. Chosen, not measured."""

BREAKUP_SHARE: Final = (0.8, 0.1)
"""Share of objects below and above `SMALL_BELOW_M` that carry the velocities of a break-up, as `range_scan` has them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Watch:
    """The watched field and time, from headers and solutions that came down.

    t_s (n,) : mid-exposures; position_km, velocity_km_s (n, 3) : of the camera, GCRS; attitude (n, 3, 3) : GCRS to camera.
    sun (3,) : unit vector. half_row, half_col : tangents of half the field. mid_row, mid_col : of its middle, which lies off the
    boresight where the read-out window does. zero_point_mag : of 1 e-/s. noise_e : of a pixel, one exposure. psf_sigma_px :
    pixel included. frame_s : from one frame to the next; a frame represents the sky for this time.
    """

    t_s: Array
    position_km: Array
    velocity_km_s: Array
    attitude: Array
    sun: Array
    half_row: float
    half_col: float
    focal_px: float
    exposure_s: float
    frame_s: float
    zero_point_mag: float
    noise_e: float
    psf_sigma_px: float
    aperture_m: float
    mid_row: float = 0.0
    mid_col: float = 0.0

    @property
    def span_s(self) -> float:
        """Time watched."""
        return self.frame_s * len(self.t_s)

    def unwatched_s(self, start_s: Array, stop_s: Array) -> Array:
        """Seconds (n,) of intervals (n,) between frames that did not come down, beyond the `frame_s` of those that did.

        Negative where frames follow sooner and represent the same time twice.
        """
        step = np.diff(self.t_s)
        lost = step - self.frame_s
        lost[np.abs(lost) < SAME_STEP_S] = 0.0
        if not lost.any():
            return np.zeros(len(start_s))
        # Such a time lies half-way between two frames.
        half, middle = 0.5 * np.minimum(np.abs(lost), step), 0.5 * (self.t_s[1:] + self.t_s[:-1])
        at = np.stack([middle - half, middle + half], axis=1).ravel()
        total = np.cumsum(np.stack([np.zeros(len(lost)), lost], axis=1).ravel())
        return np.asarray(np.interp(stop_s, at, total) - np.interp(start_s, at, total))


@dataclass(frozen=True, kw_only=True, eq=False)
class Crossings:
    """Candidates of one size class: size_m, albedo, range_km, rate_deg_s (n,); snr and length_px (n, f) in f frames of its stay.

    snr is 0 in frames without it. weight (n,) : expected distinct crossings in the time watched for one object in Earth orbit
    of this class. flux_km2_s : cross-sectional area flux at the camera of one such object (density times relative speed).
    """

    size_m: Array
    albedo: Array
    range_km: Array
    rate_deg_s: Array
    snr: Array
    length_px: Array
    frames_lit: NDArray[np.int64]
    weight: Array
    flux_km2_s: float


def crossings(
    watch: Watch, edges_m: tuple[float, float], n: int, rng: np.random.Generator, *, albedo: float, albedo_sigma_ln: float
) -> Crossings:
    """Draw n candidates of a class; albedo : median of the log-normal distribution that theirs come from.

    Only candidates whose orbits reach their drawn place are returned.
    """
    size = _sizes(edges_m, n, rng)
    own = albedo * np.exp(albedo_sigma_ln * rng.standard_normal(n))
    frame = rng.integers(len(watch.t_s), size=n)
    orbits = _orbits(math.sqrt(edges_m[0] * edges_m[1]) < SMALL_BELOW_M)
    a, e, inclination = orbits[rng.integers(len(orbits), size=n)].T
    observer, ours, attitude = watch.position_km[frame], watch.velocity_km_s[frame], watch.attitude[frame]
    signs = rng.random((2, n)) < 0.5

    u = watch.mid_col + rng.uniform(-watch.half_col, watch.half_col, n)
    v = watch.mid_row + rng.uniform(-watch.half_row, watch.half_row, n)
    slant = np.sqrt(1.0 + u * u + v * v)
    aim = np.stack([u, v, np.ones(n)], axis=1) / slant[:, None]
    sight = np.einsum("ni,nij->nj", aim, attitude)
    reach = _reach_km(size, own, watch)
    last = np.minimum(farthest_km(ours, a, e), _leaves_km(observer, sight, a * (1.0 + e) + CELL_KM))
    far = np.maximum(np.minimum(reach, last), NEAREST_KM * 1.001)
    near = np.maximum(NEAREST_KM, far / NEAR_SHARE)
    span = np.log(far / near)
    # Half of them are even in ln(range), for objects that are bright only because they are near, and half even in area, as
    # crossings of a field are.
    squares = near**2, far**2
    area_like = np.sqrt(squares[0] + rng.random(n) * (squares[1] - squares[0]))
    rho = np.where(rng.random(n) < 0.5, near * np.exp(rng.random(n) * span), area_like)
    per_km = 0.5 / (rho * span) + rho / (squares[1] - squares[0])
    camera = aim * rho[:, None]
    position = observer + sight * rho[:, None]
    volume = 4.0 * watch.half_row * watch.half_col / slant**3 * rho**2 / per_km
    density = density_of(position, a, e, inclination)
    # Most orbits do not come here. Only those that do are processed further.
    kept = np.flatnonzero((density > 0.0) & (reach > NEAREST_KM))
    size, own, rho, camera, position, observer = (x[kept] for x in (size, own, rho, camera, position, observer))
    ours, attitude, t0 = ours[kept], attitude[kept], watch.t_s[frame[kept]]
    velocity = _velocity(position, a[kept], e[kept], inclination[kept], signs[:, kept])
    relative = np.einsum("nij,nj->ni", attitude, velocity - ours)
    across = relative - camera * (np.sum(relative * camera, axis=1) / rho**2)[:, None]
    rate = np.linalg.norm(across, axis=1) / rho
    start, stop = _stay_s(camera, relative, watch)
    opens, closes = watch.t_s[0] - 0.5 * watch.frame_s, watch.t_s[-1] + 0.5 * watch.frame_s
    start, stop = np.maximum(start, opens - t0), np.minimum(stop, closes - t0)
    stay = stop - start
    stay -= np.where(stay > 0.0, watch.unwatched_s(t0 + start, t0 + stop), 0.0)
    met = np.isfinite(velocity).all(axis=1) & (stay > 0.0) & (np.degrees(rate) >= SLOWEST_DEG_S)
    weight = np.where(met, density[kept] * volume[kept] * watch.span_s / np.maximum(stay, 1e-9), 0.0) / n

    phase = np.arccos(np.clip(-np.sum((position - observer) * watch.sun, axis=1) / rho, -1.0, 1.0))
    sunlight_e_s = 10.0 ** (-0.4 * (SUN_V_MAG - watch.zero_point_mag))
    light = sunlight_e_s * own * (0.5 * size) ** 2 / (rho * 1e3) ** 2 * lambert_phase(phase)
    light *= sunlit(position, watch.sun * AU_KM) & before_the_earth(position, observer)
    snr, length, lit = _seen(watch, t0, start, stop, rate, rho, light)
    return Crossings(
        size_m=size,
        albedo=own,
        range_km=rho,
        rate_deg_s=np.degrees(rate),
        snr=np.where(met[:, None], snr, 0.0),
        length_px=np.where(met[:, None], length, 0.0),
        frames_lit=lit,
        weight=weight,
        flux_km2_s=_flux_at_camera(watch, orbits),
    )


def farthest_km(velocity_km_s: Array, a: Array, e: Array) -> Array:
    """Range (n,) beyond which objects on orbits (n,) are slower than `SLOWEST_DEG_S` for a camera of this velocity (n, 3), km/s.

    No relative speed exceeds the camera's and that of the perigee together.
    """
    perigee = np.sqrt(MU_KM3_S2 / a * (1.0 + e) / (1.0 - e))
    return np.asarray((np.linalg.norm(velocity_km_s, axis=1) + perigee) / math.radians(SLOWEST_DEG_S))


def _leaves_km(observer: Array, sight: Array, radius_km: Array) -> Array:
    """Range (n,) at which lines of sight (unit vectors) leave spheres about the Earth, 0 where they miss them."""
    along = -np.sum(observer * sight, axis=1)
    inside = along**2 - np.sum(observer * observer, axis=1) + radius_km**2
    return np.asarray(np.maximum(np.where(inside > 0.0, along + np.sqrt(np.maximum(inside, 0.0)), 0.0), 0.0))


def _flux_at_camera(watch: Watch, orbits: Array) -> float:
    """Density times relative speed at the camera for one object on orbits like these."""
    rng = np.random.default_rng(20270129)
    total, n = 0.0, len(orbits)
    for _ in range(FLUX_ROUNDS):
        frame = rng.integers(len(watch.t_s), size=n)
        place = watch.position_km[frame]
        a, e, inclination = orbits.T
        density = density_of(place, a, e, inclination)
        kept = np.flatnonzero(density > 0.0)
        signs = rng.random((2, len(kept))) < 0.5
        velocity = _velocity(place[kept], a[kept], e[kept], inclination[kept], signs)
        speed = np.linalg.norm(velocity - watch.velocity_km_s[frame[kept]], axis=1)
        total += float(np.sum(np.nan_to_num(density[kept] * speed))) / n
    return total / FLUX_ROUNDS


def trail_snr(flux_e: Array, length_px: Array, range_km: Array, watch: Watch) -> Array:
    """Matched-filter S/N of straight uniform trails; the defocus disc of near objects widens the PSF by its second moment."""
    blur = watch.aperture_m * 1e-3 / range_km * watch.focal_px
    sigma = np.sqrt(watch.psf_sigma_px**2 + blur**2 / 16.0)
    # integrals of the squared profile across the trail, a Gaussian, and along it, a box that this Gaussian blurs
    across = 0.5 / (math.sqrt(math.pi) * sigma)
    x = np.maximum(length_px / (2.0 * sigma), 1e-3)
    along = (x * erf(x) - (1.0 - np.exp(-(x**2))) / math.sqrt(math.pi)) / (2.0 * sigma * x**2)
    return np.asarray(flux_e * np.sqrt(across * along) / watch.noise_e)


def _seen(
    watch: Watch, t0: Array, start: Array, stop: Array, rate: Array, rho: Array, light_e_s: Array
) -> tuple[Array, Array, NDArray[np.int64]]:
    """S/N (0 outside the stay) and length (n, f) in up to f frames of the stay; how many frames the stay has (n,)."""
    first = np.searchsorted(watch.t_s, t0 + start - 0.5 * watch.exposure_s, side="left")
    after = np.searchsorted(watch.t_s, t0 + stop + 0.5 * watch.exposure_s, side="right")
    lit = after - first
    step = np.maximum(lit, 1)[:, None] / FRAMES_EACH
    index = np.where(
        lit[:, None] <= FRAMES_EACH, np.arange(FRAMES_EACH), np.floor(np.arange(FRAMES_EACH) * step).astype(np.int64)
    )
    there = index < lit[:, None]
    at = watch.t_s[np.minimum(first[:, None] + index, len(watch.t_s) - 1)] - t0[:, None]
    half = 0.5 * watch.exposure_s
    seconds = np.clip(np.minimum(at + half, stop[:, None]) - np.maximum(at - half, start[:, None]), 0.0, None)
    length = (rate * watch.focal_px)[:, None] * seconds
    snr = trail_snr(light_e_s[:, None] * seconds, length, rho[:, None], watch)
    return np.where(there, snr, 0.0), length, lit


def _reach_km(size_m: Array, albedo: Array, watch: Watch) -> Array:
    """Range at which an object at rest, at zero phase and in focus, has S/N 4."""
    light = 10.0 ** (-0.4 * (SUN_V_MAG - watch.zero_point_mag)) * albedo * (0.5 * size_m) ** 2 / 1e6 * 2.0 / 3.0
    still = trail_snr(light * watch.exposure_s, np.zeros(len(size_m)), np.full(len(size_m), 1e9), watch)
    return np.sqrt(still / 4.0)


def _stay_s(camera: Array, relative: Array, watch: Watch) -> tuple[Array, Array]:
    """When points that move straight enter and leave the pyramid, seconds from now (negative and positive)."""
    start, stop = np.full(len(camera), -np.inf), np.full(len(camera), np.inf)
    for axis, half, middle in ((0, watch.half_col, watch.mid_col), (1, watch.half_row, watch.mid_row)):
        for sign in (1.0, -1.0):
            # the side of the pyramid is the plane on which half z + sign (x - middle z) is 0
            inside = (half - sign * middle) * camera[:, 2] + sign * camera[:, axis]
            slope = (half - sign * middle) * relative[:, 2] + sign * relative[:, axis]
            with np.errstate(divide="ignore", invalid="ignore"):
                root = -inside / slope
            stop = np.where(slope < 0.0, np.minimum(stop, root), stop)
            start = np.where(slope > 0.0, np.maximum(start, root), start)
    return start, stop


def _velocity(position: Array, a: Array, e: Array, inclination: Array, signs: NDArray[np.bool_]) -> Array:
    """Velocities (n, 3) at positions (n, 3) km, of the apsis for orbits that just miss; signs (2, n) : rising, northwards."""
    r = np.linalg.norm(position, axis=1)
    up = position / r[:, None]
    cos_lat = np.hypot(up[:, 0], up[:, 1])
    east = np.stack([-up[:, 1], up[:, 0], np.zeros(len(r))], axis=1) / cos_lat[:, None]
    north = np.cross(up, east)
    with np.errstate(invalid="ignore"):
        horizontal = np.sqrt(MU_KM3_S2 * a * (1.0 - e**2)) / r
        radial = np.sqrt(np.maximum(MU_KM3_S2 * (2.0 / r - 1.0 / a) - horizontal**2, 0.0))
        sine = np.clip(np.cos(inclination) / cos_lat, -1.0, 1.0)
        cosine = np.sqrt(1.0 - sine**2)
    radial, cosine = np.where(signs[0], radial, -radial), np.where(signs[1], cosine, -cosine)
    return np.asarray(radial[:, None] * up + horizontal[:, None] * (sine[:, None] * east + cosine[:, None] * north))


def density_of(position: Array, a: Array, e: Array, inclination: Array) -> Array:
    """Objects per km^3 at positions (n, 3) of one object on each orbit, 0 where the orbit does not come.

    Mean over `CELL_KM` in radius and `CELL_SINE` in the sine of latitude, both in closed form: at the apsides and at the highest
    latitudes of an orbit its density has no bound, and a sum over drawn orbits would hang on the few that just graze the place.
    """
    r = np.linalg.norm(position, axis=1)
    sine, highest = position[:, 2] / r, np.maximum(np.sin(inclination), 1e-6)
    radial = [np.arcsin(np.clip((r + step - a) / (a * e), -1.0, 1.0)) for step in (-CELL_KM, CELL_KM)]
    lateral = [np.arcsin(np.clip((sine + step) / highest, -1.0, 1.0)) for step in (-CELL_SINE, CELL_SINE)]
    return np.asarray(
        (radial[1] - radial[0]) * (lateral[1] - lateral[0]) / (4.0 * CELL_KM * CELL_SINE) / (2.0 * np.pi**3 * r * a)
    )


def _sizes(edges_m: tuple[float, float], n: int, rng: np.random.Generator) -> Array:
    """Diameters (n,) inside a class by the size law."""
    grid = np.geomspace(*edges_m, 65)
    density = np.exp([log_size_density(float(d)) for d in grid])
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.exp(np.interp(rng.random(n), cumulative / cumulative[-1], np.log(grid)))


@lru_cache(maxsize=2)
def _orbits(small: bool, n: int = 40_000) -> Array:
    """Elements (n, 3) of the prior's low orbits for small or large objects."""
    rng = np.random.default_rng(20270129)
    thrown = int(n * BREAKUP_SHARE[0 if small else 1])
    return np.vstack([draw_breakup(thrown, rng), draw_catalogue(n - thrown, rng)])


def effective_number(weight: Sequence[float] | Array) -> float:
    """(sum w)^2 / sum w^2."""
    w = np.asarray(weight, float)
    total = float(np.sum(w * w))
    return float(w.sum()) ** 2 / total if total > 0.0 else 0.0
