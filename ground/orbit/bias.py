"""Bias of time tags and of pointing, from tracklets of objects whose orbits are known to metres."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ground.link.row_errors import common_errors_arcsec2
from ground.orbit.observer import ObserverOrbit, observer_orbit
from ground.orbit.reference import PreciseOrbit, seen_from
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import Tracklet

_CLIP_SIGMA = 4.5  # a right direction in 150,000 is beyond it: what is beyond is another object or a bad end
_HALF_STEP_S = 0.05  # at 1 deg/s the central difference errs by 1e-7 of the rate


@dataclass(frozen=True, kw_only=True, eq=False)
class Bias:
    """Late time tags (s, positive: the tags are later than the truth) and pointing (arcsec, towards east and north).

    covariance : (3, 3) of (time_s, east_arcsec, north_arcsec), widened by chi2_nu where that exceeds one.
    n_used, n_clipped : directions with both coordinates used, and the others. chi2_nu : of the used coordinates.
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

    Directions of a tracklet share errors (joint fit, pointing of a frame), so they are weighed by their joint covariance.

    If a tag is late by dt, the object had the measured place dt earlier, so it seems behind by rate x dt. The camera's own states
    carry tags of the same clock (contract), so they are right for the tagged epochs. The rate is therefore that of the object's
    motion alone, seen from a camera at rest. Time and pointing can be separated only if objects move in different directions or
    at different rates; the covariance shows how well. Returns None without any direction inside the tables.
    """
    observer = observer_orbit(headers)
    if observer is None:
        return None
    parts = [part for tracklet, orbit in pairs for part in _coordinates(tracklet, orbit, observer, sigma_floor_arcsec)]
    if sum(len(part.values) for part in parts) < 3:
        return None
    use = [np.isfinite(part.values) for part in parts]
    solution, information = np.zeros(3), np.eye(3)
    for _ in range(5):
        whitened = [_whitened(part, chosen) for part, chosen in zip(parts, use, strict=True)]
        design, data = np.concatenate([d for d, _ in whitened]), np.concatenate([v for _, v in whitened])
        information = design.T @ design
        solution = np.linalg.lstsq(design, data, rcond=None)[0]
        off = [np.abs(part.values - part.design @ solution) / np.sqrt(np.diag(part.covariance)) for part in parts]
        spread = max(1.0, 1.4826 * float(np.median(np.concatenate([o[chosen] for o, chosen in zip(off, use, strict=True)]))))
        kept = [np.isfinite(part.values) & (o < _CLIP_SIGMA * spread) for part, o in zip(parts, off, strict=True)]
        if all((k == u).all() for k, u in zip(kept, use, strict=True)):
            break
        use = kept
    residual = data - design @ solution
    chi2_nu = float(residual @ residual) / max(len(residual) - 3, 1)
    # errors that all directions of an object share (states of GPS, the orbit itself) show in chi-square alone
    covariance = np.linalg.pinv(information) * max(1.0, chi2_nu)
    whole = np.concatenate([along & across for along, across in zip(use[::2], use[1::2], strict=True)])
    return Bias(
        time_s=float(solution[0]),
        east_arcsec=float(solution[1]),
        north_arcsec=float(solution[2]),
        covariance=np.asarray(covariance, dtype=np.float64),
        n_used=int(whole.sum()),
        n_clipped=int((~whole).sum()),
        chi2_nu=chi2_nu,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Coordinate:
    """One coordinate, along or across the motion, of all directions of a tracklet, arcsec.

    values : (m,) observed minus computed, design : (m, 3) for (delay, east, north), covariance : (m, m).
    """

    values: NDArray[np.float64]
    design: NDArray[np.float64]
    covariance: NDArray[np.float64]


def _coordinates(
    tracklet: Tracklet, orbit: PreciseOrbit, observer: ObserverOrbit, sigma_floor_arcsec: float
) -> tuple[_Coordinate, ...]:
    """Both coordinates of a tracklet; none where the camera's or the object's states do not reach."""
    t_ns = tracklet.t_tai_ns
    places = observer.states(t_ns)[:, :3]
    if not np.isfinite(places).all():
        return ()
    half_ns = round(_HALF_STEP_S * 1e9)
    before, computed, after = (seen_from(orbit.states, t_ns + shift, places)[0] for shift in (-half_ns, 0, half_ns))
    rate = (after - before) / (2.0 * _HALF_STEP_S)
    speed = np.linalg.norm(rate, axis=1)
    moves = np.isfinite(speed) & (speed > 0.0)
    rate, speed, computed = rate[moves], speed[moves, None], computed[moves]
    ra = np.radians(tracklet.ra_deg[moves])
    seen = unit_vectors(ra, np.radians(tracklet.dec_deg[moves]))
    east = np.stack([-np.sin(ra), np.cos(ra), np.zeros(len(ra))], axis=1)
    north = np.cross(seen, east)
    heading = rate / speed
    common = common_errors_arcsec2(tracklet)
    made = []
    for axis, sigma, shared in (
        (heading, tracklet.sigma_along_arcsec[moves], common[0][np.ix_(moves, moves)]),
        (np.cross(seen, heading), tracklet.sigma_cross_arcsec[moves], common[1][np.ix_(moves, moves)]),
    ):
        design = np.stack([-(rate * axis).sum(1) / ARCSEC_RAD, (east * axis).sum(1), (north * axis).sum(1)], axis=1)
        # A row's own part is at least a thousandth of its variance, so that the covariance stays regular.
        own = np.maximum(sigma**2 - np.diag(shared), 1e-3 * sigma**2) + sigma_floor_arcsec**2
        values = ((seen - computed) * axis).sum(1) / ARCSEC_RAD
        made.append(_Coordinate(values=values, design=design, covariance=np.diag(own) + shared))
    return tuple(made)


def _whitened(part: _Coordinate, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Design and values of the chosen rows in units of their joint error."""
    factor = np.linalg.cholesky(part.covariance[np.ix_(chosen, chosen)])
    return np.linalg.solve(factor, part.design[chosen]), np.linalg.solve(factor, part.values[chosen])
