"""Bias of time tags and of pointing, from tracklets of objects whose orbits are known to metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.orbit.observer import observer_orbit
from ground.orbit.reference import PreciseOrbit, seen_from
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import Tracklet

_CLIP_SIGMA = 4.5
_HALF_STEP_S = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Bias:
    """Late time tags (s, positive: the tags are later than the truth) and pointing (arcsec, towards east and north).

    covariance : (3, 3) of (time_s, east_arcsec, north_arcsec), widened by chi2_nu where that exceeds one.
    n_used, n_clipped : directions of which both coordinates were used, and the others. chi2_nu : of what was used.
    """

    time_s: float
    east_arcsec: float
    north_arcsec: float
    covariance: NDArray[np.float64]
    n_used: int
    n_clipped: int
    chi2_nu: float


def estimate_bias(
    pairs: Sequence[tuple[Tracklet, PreciseOrbit]], headers: Sequence[FrameHeader], *, sigma_floor_arcsec: float = 0.05
) -> Bias | None:
    """Weighted least squares of ``observed - computed = -rate x delay + (east, north)``, clipped at 4.5 sigma.

    A tag that is late by dt belongs to a place the object had passed dt earlier, so the object seems behind by rate x dt. The
    camera's own states carry the same clock's tags (contract), so that they are right for the tagged epochs: the rate is that
    of the object's motion alone, seen from a camera at rest. Time and pointing part only if objects move in different directions
    or at different rates: the covariance says how well. None without any direction inside the tables.
    """
    rows, values = [], []
    observer = observer_orbit(headers)
    if observer is None:
        return None
    for tracklet, orbit in pairs:
        t_ns = tracklet.t_tai_ns
        places = observer.states(t_ns)
        if not np.isfinite(places).all():
            continue
        computed, _ = seen_from(orbit.states, t_ns, places[:, :3])
        half_ns = round(_HALF_STEP_S * 1e9)
        rate = (
            seen_from(orbit.states, t_ns + half_ns, places[:, :3])[0] - seen_from(orbit.states, t_ns - half_ns, places[:, :3])[0]
        )
        rate /= 2.0 * _HALF_STEP_S
        ra = np.radians(tracklet.ra_deg)
        seen = unit_vectors(ra, np.radians(tracklet.dec_deg))
        east = np.stack([-np.sin(ra), np.cos(ra), np.zeros(len(ra))], axis=1)
        north = np.cross(seen, east)
        for k in range(len(t_ns)):
            speed = float(np.linalg.norm(rate[k]))
            if not np.isfinite(speed) or speed == 0.0:
                continue
            heading = rate[k] / speed
            side = np.cross(seen[k], heading)
            for axis, sigma in ((heading, tracklet.sigma_along_arcsec[k]), (side, tracklet.sigma_cross_arcsec[k])):
                weight = 1.0 / np.hypot(sigma, sigma_floor_arcsec)
                rows.append(
                    np.array([-float(rate[k] @ axis) / ARCSEC_RAD, float(east[k] @ axis), float(north[k] @ axis)]) * weight
                )
                values.append(float((seen[k] - computed[k]) @ axis) / ARCSEC_RAD * weight)
    if len(rows) < 3:
        return None
    design, data = np.array(rows), np.array(values)
    use = np.isfinite(data)
    solution, information = np.zeros(3), np.eye(3)
    for _ in range(5):
        information = design[use].T @ design[use]
        solution = np.linalg.lstsq(design[use], data[use], rcond=None)[0]
        residual = data - design @ solution
        spread = max(1.0, 1.4826 * float(np.median(np.abs(residual[use]))))
        kept = np.isfinite(data) & (np.abs(residual) < _CLIP_SIGMA * spread)
        if (kept == use).all():
            break
        use = kept
    residual = (data - design @ solution)[use]
    chi2_nu = float(residual @ residual) / max(len(residual) - 3, 1)
    # errors that all directions of an object share (states of GPS, the orbit itself) show in chi-square alone
    covariance = np.linalg.pinv(information) * max(1.0, chi2_nu)
    whole = use.reshape(-1, 2).all(axis=1)
    return Bias(
        time_s=float(solution[0]),
        east_arcsec=float(solution[1]),
        north_arcsec=float(solution[2]),
        covariance=np.asarray(covariance, dtype=np.float64),
        n_used=int(whole.sum()),
        n_clipped=int((~whole).sum()),
        chi2_nu=chi2_nu,
    )
