"""Which tracklets are known objects: directions and rates against a catalogue of element sets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sgp4.api import Satrec, SatrecArray

from ground.orbit.attributable import attributable_of
from ground.orbit.dynamics import LIGHT_KM_S
from ground.orbit.observer import observer_orbit
from ground.orbit.reference import teme_to_gcrs, utc_jd
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.element_sets import element_sets
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import Tracklet

_FARTHEST_SIGMA = 4.0  # of four numbers, place and rate: 0.3 % of right candidates are beyond (chi2 of four, 16)
_LARGEST_CHANCE = 0.01
"""Largest chance-match probability of a known object. Above it, a single candidate is a hypothesis too."""
_FIELD_COSINE = 0.95
"""Objects within 18 deg of a tracklet give the density around it,"""
_RATE_SHARE = 0.5
"""and of these the ones whose rates differ by less than this share of the tracklet's own."""
_NEIGHBOURS = 10  # of the density: its relative error is then 1 / sqrt(8) = 0.35; more would smear the change over the sky


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownObjects:
    """A catalogue: names, catalogue numbers (n,) and the propagators of its element sets."""

    names: tuple[str, ...]
    numbers: NDArray[np.int64]
    satellites: tuple[Satrec, ...]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A catalogue object that fits a tracklet: distance in expected errors, and chance-match probability.

    chance_probability : probability that at least one unrelated object lies as near in place and rate, from the density of
    predicted objects around the tracklet.
    """

    number: int
    name: str
    sigmas: float
    chance_probability: float


@dataclass(frozen=True, kw_only=True)
class CatalogueMatch:
    """The nearest catalogue object for a tracklet, observed minus computed, and every object that fits.

    sigmas : distance in units of the element sets' expected errors. candidates : objects within four of them, nearest first, one
    for each number. known : exactly one candidate, with a chance-match probability below 1 %. Several candidates,
    or one in a crowded field, are hypotheses.
    """

    tracklet_id: int
    known: bool
    number: int
    name: str
    along_arcsec: float
    cross_arcsec: float
    rate_residual_arcsec_s: float
    range_km: float
    sigmas: float
    chance_probability: float
    candidates: tuple[Candidate, ...]

    @property
    def n_candidates(self) -> int:
        """Number of objects that fit."""
        return len(self.candidates)


def read_elements(text: str) -> KnownObjects:
    """Objects of a two- or three-line element file; a name line may begin with ``0 ``.

    Errors: a `UserError` that names the line for one with a wrong checksum, for half a set, and for one that cannot be read.
    """
    names, satellites = [], []
    for name, first, second in element_sets(text, "element sets"):
        try:
            satellites.append(Satrec.twoline2rv(first, second))
        except ValueError as error:
            raise UserError(f"element sets: expected a two-line element set, got '{first[:30]}...'") from error
        names.append(name)
    numbers = np.array([s.satnum for s in satellites], dtype=np.int64)
    return KnownObjects(names=tuple(names), numbers=numbers, satellites=tuple(satellites))


def match_catalogue(
    tracklets: Sequence[Tracklet],
    headers: Sequence[FrameHeader],
    known: KnownObjects,
    *,
    along_km: float = 3.0,
    cross_km: float = 1.0,
    age_km_day: float = 1.0,
) -> tuple[CatalogueMatch, ...]:
    """The best match of each tracklet that has sky positions and an observer state; the others are left out.

    along_km, cross_km : one sigma of fresh element sets along and across the object's motion; age_km_day is added along it.
    """
    out = []
    array = SatrecArray(list(known.satellites)) if known.satellites else None
    path = observer_orbit(headers)
    for tracklet in tracklets:
        data = attributable_of(tracklet, 0.1)
        if data is None or array is None or path is None:
            continue
        t_ns = data.t_ref_tai_ns
        observer = path.states(np.array([t_ns]))[0]
        if not np.isfinite(observer).all():
            continue
        day, fraction = utc_jd([t_ns])
        failed, position, velocity = array.sgp4(day, fraction)
        turn = teme_to_gcrs(t_ns)
        position, velocity = position[:, 0] @ turn.T, velocity[:, 0] @ turn.T
        relative = position - observer[:3]
        rho = np.linalg.norm(relative, axis=1)
        # the light left rho / c earlier
        relative -= velocity * (rho / LIGHT_KM_S)[:, None]
        plane, depth = relative @ data.axes[:2].T, relative @ data.axes[2]
        ahead = (failed[:, 0] == 0) & (depth > _FIELD_COSINE * rho)
        offset = -plane / np.where(ahead, depth, np.nan)[:, None]
        moving = (velocity - observer[3:]) @ data.axes[:2].T / rho[:, None]
        speed = np.linalg.norm(moving, axis=1, keepdims=True)
        heading = moving / np.where(speed > 0.0, speed, 1.0)
        along = np.einsum("ij,ij->i", offset, heading)
        cross = heading[:, 0] * offset[:, 1] - heading[:, 1] * offset[:, 0]
        rate_error = np.linalg.norm(data.rate_rad_s - moving, axis=1)
        age_day = np.abs(np.array([s.jdsatepoch + s.jdsatepochF for s in known.satellites]) - day[0] - fraction[0])
        along_sigma = (along_km + age_km_day * age_day) / rho
        cross_sigma = cross_km / rho
        rate_sigma = np.sqrt(np.trace(data.rate_covariance)) + 2e-3 * (along_km + age_km_day * age_day) / rho
        sigmas = np.sqrt((along / along_sigma) ** 2 + (cross / cross_sigma) ** 2 + (rate_error / rate_sigma) ** 2)
        sigmas = np.where(np.isfinite(sigmas), sigmas, np.inf)
        best = int(np.argmin(sigmas))
        if not np.isfinite(sigmas[best]):
            out.append(_nothing_near(tracklet.tracklet_id))
            continue
        angle = np.where(ahead, np.arccos(np.clip(depth / rho, -1.0, 1.0)), np.inf)
        size = along_sigma * cross_sigma * rate_sigma**2
        within = np.flatnonzero(sigmas < _FARTHEST_SIGMA)
        # several element sets of one object are one candidate
        nearest = dict.fromkeys(known.numbers[k] for k in within[np.argsort(sigmas[within], kind="stable")])
        best_of = {n: min((k for k in within if known.numbers[k] == n), key=lambda k: sigmas[k]) for n in nearest}

        reach_rad_s = _RATE_SHARE * float(np.hypot(*data.rate_rad_s))
        chances: dict[int, float] = {}
        for k in (best, *(int(one) for one in best_of.values())):
            others = known.numbers != known.numbers[k]
            density = local_density(angle[others], rate_error[others], reach_rad_s)
            chances[k] = chance_probability(density, float(sigmas[k]), float(size[k]))
        candidates = tuple(
            Candidate(number=int(n), name=known.names[int(k)], sigmas=float(sigmas[k]), chance_probability=chances[int(k)])
            for n, k in best_of.items()
        )
        chance = chances[best]
        out.append(
            CatalogueMatch(
                tracklet_id=tracklet.tracklet_id,
                known=len(candidates) == 1 and chance < _LARGEST_CHANCE,
                number=int(known.numbers[best]),
                name=known.names[best],
                along_arcsec=float(along[best] / ARCSEC_RAD),
                cross_arcsec=float(cross[best] / ARCSEC_RAD),
                rate_residual_arcsec_s=float(rate_error[best] / ARCSEC_RAD),
                range_km=float(rho[best]),
                sigmas=float(sigmas[best]),
                chance_probability=chance,
                candidates=candidates,
            )
        )
    return tuple(out)


def _nothing_near(tracklet_id: int) -> CatalogueMatch:
    """Result for a tracklet in a part of the sky without any catalogue object."""
    nan = float("nan")
    return CatalogueMatch(
        tracklet_id=tracklet_id,
        known=False,
        number=-1,
        name="-",
        along_arcsec=nan,
        cross_arcsec=nan,
        rate_residual_arcsec_s=nan,
        range_km=nan,
        sigmas=nan,
        chance_probability=nan,
        candidates=(),
    )


def local_density(angle_rad: NDArray[np.float64], rate_error_rad_s: NDArray[np.float64], rate_reach_rad_s: float) -> float:
    """Predicted objects per sr and (rad/s)^2 around a tracklet.

    angle_rad, rate_error_rad_s : (n,) distances of the objects from it in place and in rate. A cell that is 18 deg wide in place
    and `rate_reach_rad_s` in rate shrinks in both until it holds `_NEIGHBOURS` objects: the density is (k - 1) / volume, without
    bias (Loftsgaarden & Quesenberry 1965, Ann. Math. Statist. 36, 1049). With fewer, half an object is added.
    """
    widest = np.arccos(_FIELD_COSINE)
    reach = max(rate_reach_rad_s, ARCSEC_RAD)
    share = np.sort(np.maximum(angle_rad / widest, rate_error_rad_s / reach))
    inside = int((share < 1.0).sum())
    if inside < _NEIGHBOURS:
        return (inside + 0.5) / (2.0 * np.pi * (1.0 - _FIELD_COSINE) * np.pi * reach**2)
    edge = float(share[_NEIGHBOURS - 1])
    solid_angle = 2.0 * np.pi * (1.0 - np.cos(edge * widest))
    return (_NEIGHBOURS - 1) / float(solid_angle * np.pi * (edge * reach) ** 2)


def chance_probability(density: float, sigmas: float, size: float) -> float:
    """That at least one unrelated object lies within `sigmas` of a tracklet, for objects strewn at random with this density.

    size : product of the four expected errors, along x cross (rad^2) x rate twice (rad^2/s^2). The ball of four dimensions
    holds pi^2 / 2 times the fourth power of its radius.
    """
    return float(-np.expm1(-density * 0.5 * np.pi**2 * sigmas**4 * size))
