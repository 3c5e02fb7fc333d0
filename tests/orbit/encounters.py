"""Encounters of a space telescope with debris, drawn without the package's own densities: Kessler's spatial density instead.

An orbit (a, e, i) with uniform node, perigee and anomaly spends, per unit of volume at distance R (Kessler 1981, Icarus 48, 39),
the share ``1 / (4 pi^2 R a sqrt((R - rp)(ra - R)))  x  (2/pi) / sqrt(sin^2 i - sin^2 latitude)`` of its time; four velocities
are possible there.
"""

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.products import Tracklet

MU = 398600.4418
T0_NS = 2_177_950_000 * 1_000_000_000
PIXEL_ARCSEC = 4.64
LIGHT_KM_S = 299792.458
ALBEDO = 0.13


@dataclass(frozen=True, kw_only=True, eq=False)
class Encounter:
    """Truth: state at T0 (km, km/s), elements (km, 1, deg), range, rate, size, V, S/N."""

    state: NDArray[np.float64]
    elements: NDArray[np.float64]
    range_km: float
    rate_deg_s: float
    size_m: float
    mag: float
    snr: float


def sun_and_observer() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Direction to the Sun at T0 (low precision) and a 700 km Sun-synchronous observer over the terminator."""
    days = T0_NS / 86400e9 + 2436204.5 - 2451545.0
    g = np.radians(357.528 + 0.9856003 * days)
    lon = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(g))
    eps = np.radians(23.439)
    sun = np.array([np.cos(lon), np.cos(eps) * np.sin(lon), np.sin(eps) * np.sin(lon)])
    node, inc, u = np.arctan2(sun[1], sun[0]) + np.pi / 2, np.radians(98.19), 0.7
    r, v = 7078.137, np.sqrt(MU / 7078.137)
    n = np.array([np.cos(node), np.sin(node), 0.0])
    m = np.array([-np.cos(inc) * np.sin(node), np.cos(inc) * np.cos(node), np.sin(inc)])
    return sun, np.concatenate([r * (np.cos(u) * n + np.sin(u) * m), v * (-np.sin(u) * n + np.cos(u) * m)])


def catalogue_orbits(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Elements (n, 3) from the histogram's cells; perigee above 120 km."""
    with np.load(str(files("ground.orbit") / "leo_deb_hist_2023.npz")) as h:
        cells = rng.choice(h["H"].size, size=2 * n, p=h["H"].ravel() / h["H"].sum())
        ia, ie, ii = np.unravel_index(cells, h["H"].shape)
        edges = h["alt_edges"] + 6378.137, h["ecc_edges"], np.radians(h["inc_edges"])
    u = rng.random((3, 2 * n))
    out = np.stack([e[k] + x * (e[k + 1] - e[k]) for e, k, x in zip(edges, (ia, ie, ii), u, strict=True)], axis=1)
    return out[out[:, 0] * (1 - out[:, 1]) > 6498.137][:n]


def breakup_orbits(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Catalogued orbits after a collision fragment's velocity change (Johnson et al. 2001), in radius, speed and plane."""
    el = catalogue_orbits(n, rng)
    a, e, i = el.T
    f = _true_anomaly(rng.random(len(el)) * 2 * np.pi, e)
    r = a * (1 - e**2) / (1 + e * np.cos(f))
    # plane-fixed axes: radial, transverse, normal
    vr, vt = np.sqrt(MU / (a * (1 - e**2))) * e * np.sin(f), np.sqrt(MU / (a * (1 - e**2))) * (1 + e * np.cos(f))
    size = (0.001**-1.71 - rng.random(len(el)) * (0.001**-1.71 - 0.1**-1.71)) ** (-1 / 1.71)
    lam = np.log10(size)
    mean = np.interp(lam, [-1.75, -1.25], [-0.3, -1.0])
    chi = mean + np.where(lam <= -3.5, 0.2, 0.2 + 0.1333 * (lam + 3.5)) * rng.standard_normal(len(el))
    dv = 10 ** (0.9 * chi + 2.9 + 0.4 * rng.standard_normal(len(el))) / 1000.0
    d = rng.standard_normal((3, len(el)))
    dr, dt, dn = dv * d / np.linalg.norm(d, axis=0)
    vr, vt2 = vr + dr, np.hypot(vt + dt, dn)
    # normal part of dv turns the plane about the radius vector: new inclination from the argument of latitude
    lat = rng.random(len(el)) * 2 * np.pi
    tilt = np.arctan2(dn, vt + dt)
    cos_i = np.cos(i) * np.cos(tilt) - np.sin(i) * np.cos(lat) * np.sin(tilt)
    a2 = 1 / (2 / r - (vr**2 + vt2**2) / MU)
    e2 = np.sqrt(np.maximum(1 - (r * vt2) ** 2 / (MU * a2), 0))
    good = (a2 > 0) & (a2 * (1 - e2) > 6498.137) & (a2 < 6e4)
    return np.stack([a2, e2, np.arccos(np.clip(cos_i, -1, 1))], axis=1)[good]


def _true_anomaly(mean: NDArray[np.float64], e: NDArray[np.float64]) -> NDArray[np.float64]:
    ecc = mean + e * np.sin(mean)
    for _ in range(30):
        ecc = mean + e * np.sin(ecc)
    return 2 * np.arctan2(np.sqrt(1 + e) * np.sin(ecc / 2), np.sqrt(1 - e) * np.cos(ecc / 2))


def larger_than(size_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """N(> d) of the project's size law."""
    return np.where(size_m < 0.01, 1.04e6 * (size_m / 0.01) ** -2.1, 3.65e4 * (size_m / 0.1) ** -1.45)


def snr_of(mag: NDArray[np.float64], rate_deg_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Matched-filter S/N of a trail in 0.2 s: flux over noise 2.84 e- in a strip of 3 px."""
    length = np.maximum(rate_deg_s * 0.2 * 3600 / PIXEL_ARCSEC, 3.0)
    return 4.7e8 * 10 ** (-0.4 * mag) * 0.2 / (2.84 * np.sqrt(3.0 * length))


def draw_encounters(
    n: int, rng: np.random.Generator, *, population: str, pool: int = 400_000, passes: bool = False
) -> list[Encounter]:
    """n encounters above S/N 8 that stay in the field for at least three frames, in nature's proportions.

    passes : in proportion to objects that pass through the field, each once, as a long run's tracklets are; otherwise to objects
    in the field at an instant, among which those that hardly move, companions of the camera's own orbit, are in the majority.

    population : "catalogue" or "breakup" for orbits of that kind at every size; "natural" has breakup velocities below 9.5 cm
    and none above; "volume" leaves sizes and S/N out: catalogued orbits uniform in the field's volume to 3,000 km, no magnitude.
    """
    sun, observer = sun_and_observer()
    if population == "natural":
        el = np.vstack([catalogue_orbits(pool // 2, rng), breakup_orbits(pool // 2, rng)])
        thrown = np.arange(len(el)) >= pool // 2
    else:
        el = (breakup_orbits if population == "breakup" else catalogue_orbits)(pool, rng)
        thrown = np.full(len(el), population == "breakup")
    m = len(el)
    rho = np.exp(rng.uniform(np.log(1.0), np.log(6000.0), m))
    tilt, turn = np.radians(2.64) * np.sqrt(rng.random(m)), rng.random(m) * 2 * np.pi
    east = np.cross([0.0, 0.0, 1.0], -sun)
    east /= np.linalg.norm(east)
    north = np.cross(-sun, east)
    u = -sun + np.tan(tilt)[:, None] * (np.cos(turn)[:, None] * east + np.sin(turn)[:, None] * north)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    position = observer[:3] + rho[:, None] * u
    big_r = np.linalg.norm(position, axis=1)
    sin_b = position[:, 2] / big_r
    a, e, i = el.T
    inside = (big_r - a * (1 - e)) * (a * (1 + e) - big_r)
    steep = np.sin(i) ** 2 - sin_b**2
    good = (inside > 0) & (steep > 0)
    density = np.where(good, 1 / (big_r * a * np.sqrt(np.where(good, inside * steep, 1.0))), 0.0)
    vt = np.sqrt(MU * a * (1 - e**2)) / big_r
    vr = np.sqrt(np.maximum(MU * (2 / big_r - 1 / a) - vt**2, 0)) * rng.choice([-1, 1], m)
    cos_b = np.sqrt(1 - sin_b**2)
    cos_az = np.clip(np.cos(i) / cos_b, -1, 1)
    sin_az = np.sqrt(1 - cos_az**2) * rng.choice([-1, 1], m)
    radial = position / big_r[:, None]
    e_hat = np.cross([0.0, 0.0, 1.0], radial)
    e_hat /= np.linalg.norm(e_hat, axis=1, keepdims=True)
    velocity = vr[:, None] * radial + vt[:, None] * (cos_az[:, None] * e_hat + sin_az[:, None] * np.cross(radial, e_hat))
    relative = velocity - observer[3:]
    rate = np.degrees(np.linalg.norm(relative - np.einsum("ij,ij->i", relative, u)[:, None] * u, axis=1) / rho)
    mag_limit = -2.5 * np.log10(8.0 / snr_of(np.zeros(m), rate))
    faintest = 2e3 * rho * np.sqrt(10 ** (-0.4 * (mag_limit + 26.76)) / (ALBEDO * 2 / 3))
    floor, ceiling = np.zeros(m), np.full(m, np.inf)
    if population == "natural":
        floor, ceiling = np.where(thrown, 0.0, 0.095), np.where(thrown, 0.095, np.inf)
    most = larger_than(np.maximum(faintest, floor))
    least = np.where(np.isfinite(ceiling), larger_than(np.minimum(ceiling, 1e3)), 0.0)
    sizes = np.where(population == "volume", (rho < 3000.0).astype(float), np.maximum(most - least, 0.0))
    weight = np.where(rate < 5.28 / 0.75, density * rho**3 * sizes * (rate if passes else 1.0), 0.0)
    picked = rng.choice(m, size=n, replace=False, p=weight / weight.sum())
    out = []
    for k in picked:
        count = least[k] + (most[k] - least[k]) * rng.random()
        size = 0.01 * (count / 1.04e6) ** (-1 / 2.1) if count > 1.04e6 else 0.1 * (count / 3.65e4) ** (-1 / 1.45)
        mag = -26.76 - 2.5 * np.log10(ALBEDO * 2 / 3 * (size / (2e3 * rho[k])) ** 2)
        out.append(
            Encounter(
                state=np.concatenate([position[k], velocity[k]]), elements=el[k] * [1, 1, 180 / np.pi], range_km=float(rho[k]),
                rate_deg_s=float(rate[k]), size_m=float(size), mag=float(mag) if population != "volume" else np.nan,
                snr=float(snr_of(mag, rate[k])),
            )
        )  # fmt: skip
    return out


def trajectory(state: NDArray[np.float64], t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """States (n, 6) by an adaptive integrator with J2, written apart from the package's."""

    def force(_: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        r = np.linalg.norm(y[:3])
        k = 1.5 * 1.0826359e-3 * (6378.1366 / r) ** 2
        z = 5 * y[2] ** 2 / r**2
        return np.concatenate([y[3:], -MU / r**3 * y[:3] * (1 + k * np.array([1 - z, 1 - z, 3 - z]))])

    out = np.empty((len(t_s), 6))
    for side in (t_s >= 0, t_s < 0):
        times = t_s[side]
        if len(times) == 0:
            continue
        order = np.argsort(np.abs(times))
        last = times[order[-1]] if times[order[-1]] != 0 else 1e-3
        got = solve_ivp(force, (0.0, last), state, t_eval=times[order], method="DOP853", rtol=1e-11, atol=1e-9).y.T
        block = np.empty((len(times), 6))
        block[order] = got
        out[side] = block
    return out


def observed(
    encounter: Encounter, rng: np.random.Generator, *, cadence_s: float = 0.25, exposure_s: float = 0.2, longest_s: float = 10.0,
    error_px: float | None = None, steady: float = 0.0,
) -> tuple[Tracklet, tuple[FrameHeader, ...]]:  # fmt: skip
    """A tracklet of both ends in every frame of the pass, with errors that go with its S/N, and headers with noisy GPS states.

    steady : share of the variance of GPS errors (10 m, 0.1 m/s) that all states have in common.
    """
    _, observer = sun_and_observer()
    arc = min(4.0 / encounter.rate_deg_s, longest_s)
    n_frames = max(3, int(arc / cadence_s))
    start = (np.arange(n_frames) - 0.5 * (n_frames - 1)) * cadence_s
    t_s = np.sort(np.concatenate([start - 0.5 * exposure_s, start + 0.5 * exposure_s]))
    seen_from = trajectory(observer, t_s)
    delay = np.full(len(t_s), encounter.range_km / LIGHT_KM_S)
    for _ in range(3):
        relative = trajectory(encounter.state, t_s - delay)[:, :3] - seen_from[:, :3]
        delay = np.linalg.norm(relative, axis=1) / LIGHT_KM_S
    unit = relative / np.linalg.norm(relative, axis=1, keepdims=True)
    length = encounter.rate_deg_s * exposure_s * 3600 / PIXEL_ARCSEC
    along, cross = max(2.0 / encounter.snr, 4.39 * length / encounter.snr**2), 2.0 / encounter.snr
    along, cross = (min(along, 0.4 * length + 0.3), max(cross, 0.03)) if error_px is None else (error_px, error_px)
    way = unit[-1] - unit[0]
    way /= np.linalg.norm(way)
    side = np.cross(unit, way)
    error = np.radians(PIXEL_ARCSEC / 3600) * rng.standard_normal((2, len(t_s)))
    unit = unit + along * error[0][:, None] * way + cross * error[1][:, None] * side
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    tracklet = Tracklet(
        tracklet_id=0, streak_ids=np.arange(n_frames), frames=np.arange(n_frames),
        t_tai_ns=T0_NS + np.round(t_s * 1e9).astype(np.int64), ra_deg=np.degrees(np.arctan2(unit[:, 1], unit[:, 0])) % 360,
        dec_deg=np.degrees(np.arcsin(unit[:, 2])), sigma_along_arcsec=np.full(len(t_s), along * PIXEL_ARCSEC),
        sigma_cross_arcsec=np.full(len(t_s), cross * PIXEL_ARCSEC), t_ref_tai_ns=T0_NS, ra_ref_deg=0.0, dec_ref_deg=0.0,
        rate_deg_s=encounter.rate_deg_s, rate_err_deg_s=0.0, position_angle_deg=0.0,
        mag=encounter.mag + 0.1 * rng.standard_normal(), mag_err=0.1, chi2_nu=1.0, probability=1.0, direction_resolved=True,
        flags=StreakFlag(0),
    )  # fmt: skip
    frame_t = start - 0.5 * exposure_s
    states = trajectory(observer, frame_t) * 1e3
    fresh = np.sqrt(1.0 - steady)
    states[:, :3] += 10.0 * fresh * rng.standard_normal((n_frames, 3))
    states[:, 3:] += 0.1 * fresh * rng.standard_normal((n_frames, 3))
    if steady > 0.0:
        states += np.sqrt(steady) * np.array([10.0] * 3 + [0.1] * 3) * rng.standard_normal(6)
    headers = tuple(
        FrameHeader(
            frame=k, t_start_tai_ns=T0_NS + round(t * 1e9), exposure_ns=round(exposure_s * 1e9), line_time_ns=10_000, rows=4096,
            cols=4096,
            observer=ObserverState(
                tai_ns=T0_NS + round(t * 1e9), position_m=state[:3], velocity_m_s=state[3:], sigma_position_m=10.0,
                sigma_velocity_m_s=0.1,
            ),
        )
        for k, (t, state) in enumerate(zip(frame_t, states, strict=True))
    )  # fmt: skip
    return tracklet, headers
