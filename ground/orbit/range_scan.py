"""`ground.orbit: range_scan`: posterior of range and orbit from a short arc of directions."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.orbit.attributable import Attributable, attributable_of
from ground.orbit.observer import observer_orbit
from ground.orbit.posterior import Posterior, modes, normal_pairs, quantiles, scan
from ground.orbit.prior import PriorShares, PriorTable, prior_table
from ground.orbit.scan import Problem
from ground.orbit.size import diameter_m, log_size_density, magnitude_draws, sun_direction
from ground.orbit.states import angle_quantiles_deg, elements_of, latitude_argument_of, state_of
from ground.sky.apparent import EARTH_RADIUS_KM
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import OrbitEstimate, OrbitState, Tracklet

_TYPICAL_RANGE_KM = 1000.0
"""The range at which a small piece in low orbit is seen. It only turns a rate error into a velocity for `draws`."""
_DRAW_STEP_KM_S = 0.02
"""Uncertainty of the transverse velocity at the typical range that asks for one more set of draws; orbits differ by as little."""
_MOST_DRAWS = 12  # sets of draws, a budget of work: 0.24 km/s at the typical range
_MAG_UNKNOWN = 12.0
"""V assumed for the size law's weight when a tracklet has no magnitude: about the limit of detection."""

SMALL_BELOW_M: Final = 0.1
"""Diameter that divides small from large objects."""

SIGMA_FLOOR_ARCSEC: Final = 0.1
"""Error of each direction beyond the stated one, added in quadrature."""


@dataclass(frozen=True, kw_only=True)
class RangeScan:
    """Scan range; at each one weigh range rates and transverse rates by the data, by the population's orbits and sizes.

    The prior determines the range of short arcs: catalogued LEO fragments, the same with the NASA model's breakup velocities,
    and a tail that allows any bound orbit. The measure of phase space is d3r d3v. Its volume vanishes at the camera. The camera's
    own orbit, which always solves the equations, therefore has no weight in the posterior.
    """

    breakup_share_small: float = field(
        default=0.8, metadata={"doc": "of small objects that carry breakup velocities", "min": 0.0, "max": 1.0}
    )
    breakup_share_large: float = field(
        default=0.1, metadata={"doc": "of larger ones, whose catalogued orbits hold them already", "min": 0.0, "max": 1.0}
    )
    tail_share: float = field(default=0.02, metadata={"doc": "of objects on any bound orbit at all", "min": 1e-6, "max": 1.0})
    ring_share: float = field(
        default=0.02, metadata={"doc": "of objects on or near the geostationary ring", "min": 0.0, "max": 1.0}
    )
    albedo: float = field(default=0.13, metadata={"doc": "of a Lambert sphere, median", "min": 0.001, "max": 1.0})
    albedo_sigma_ln: float = field(
        default=0.5, metadata={"doc": "log-normal scatter of the albedo in the size interval", "min": 0.0, "max": 3.0}
    )
    nearest_km: float = field(default=0.05, metadata={"doc": "where the scan begins", "min": 1e-3, "max": 1e4})
    farthest_km: float = field(default=60000.0, metadata={"doc": "where the scan ends", "min": 1.0, "max": 1e6})
    draws: int = field(
        default=3,
        metadata={"doc": "transverse rates tried at each range, more where they are poorly known", "min": 1, "max": 100},
    )

    def __post_init__(self) -> None:
        if self.nearest_km >= self.farthest_km:
            raise UserError(f"nearest: {self.nearest_km:g} km; allowed is less than farthest, {self.farthest_km:g} km")
        if self.tail_share + self.ring_share > 1.0:
            raise UserError(
                f"tail_share and ring_share: {self.tail_share:g} and {self.ring_share:g}; allowed is a sum of 1 at most, "
                "low orbits have the rest"
            )

    def estimate(self, tracklet: Tracklet, headers: Sequence[FrameHeader]) -> OrbitEstimate:
        """Posterior of one tracklet; not converged, with NaN, without sky positions or observer states near it."""
        data = attributable_of(tracklet, SIGMA_FLOOR_ARCSEC)
        if data is None:
            return self._nothing(tracklet, "fewer than two directions at different epochs")
        path = observer_orbit(headers)
        if path is None:
            return self._nothing(tracklet, "no state of the observer in the run")
        node_ns = data.t_ref_tai_ns + np.round(np.append(data.form.node_s, 0.0) * 1e9).astype(np.int64)
        observed_from = path.states(node_ns)
        if not np.isfinite(observed_from).all():
            return self._nothing(tracklet, "no state of the observer near its epochs")
        observer = observed_from[-1]
        mag = tracklet.mag if math.isfinite(tracklet.mag) else _MAG_UNKNOWN
        phase_rad = math.acos(max(-1.0, min(1.0, -float(data.axes[2] @ sun_direction(data.t_ref_tai_ns)))))
        small, large = (self._prior(share) for share in (self.breakup_share_small, self.breakup_share_large))

        def law_of_range(range_km: float) -> tuple[PriorTable, float]:
            """Orbits of objects as large as the magnitude makes them there; volume of phase space per ln(rho) and the size law.

            d3r d3v = rho^4 d(direction) d(rate) d(rho) d(rho rate).
            """
            size_m = float(diameter_m(mag, range_km, self.albedo, phase_rad))
            return small if size_m < SMALL_BELOW_M else large, 5.0 * math.log(range_km) + log_size_density(size_m)

        sigma_km_s = _TYPICAL_RANGE_KM * math.sqrt(float(np.trace(data.rate_covariance)))
        draws = self.draws * min(1 + int(sigma_km_s / _DRAW_STEP_KM_S), _MOST_DRAWS)
        limits_km = (self.nearest_km, self.farthest_km)
        problem = problem_of(data, observer, observed_from[:-1, :3])
        posterior = scan(problem, law_of_range, limits_km, draws)
        if posterior is None:
            return self._nothing(tracklet, "no bound orbit fits within the ranges that were tried")
        state = state_of(posterior, data, problem, path.covariances(node_ns[-1:])[0])
        return self._summary(tracklet, data, observer, posterior, state, phase_rad)

    def _summary(
        self,
        tracklet: Tracklet,
        data: Attributable,
        observer: NDArray[np.float64],
        posterior: Posterior,
        state: OrbitState,
        phase_rad: float,
    ) -> OrbitEstimate:
        """The contract's record of a posterior. The size includes the scatter of the magnitude and of the albedo."""
        weight = posterior.weight
        position = observer[:3] + posterior.range_km[:, None] * data.axes[2]
        altitude = np.linalg.norm(position, axis=1) - EARTH_RADIUS_KM
        if math.isfinite(tracklet.mag):
            normal = normal_pairs(0, len(weight))
            albedo = self.albedo * np.exp(self.albedo_sigma_ln * normal[:, 0])
            size = quantiles(diameter_m(magnitude_draws(tracklet, normal[:, 1]), posterior.range_km, albedo, phase_rad), weight)
        else:
            size = np.full(3, np.nan)
        rho = np.exp(posterior.log_range)
        angles = elements_of(state.sample_state)[:, 3:]
        latitude_argument = latitude_argument_of(state.sample_state)
        a_km, e, i_deg = (quantiles(column, weight) for column in (posterior.a_km, posterior.e, np.degrees(posterior.i_rad)))
        return OrbitEstimate(
            tracklet_id=tracklet.tracklet_id,
            t_ref_tai_ns=data.t_ref_tai_ns,
            range_km=quantiles(posterior.range_km, weight),
            altitude_km=quantiles(altitude, weight),
            a_km=a_km,
            e=e,
            i_deg=i_deg,
            size_m=size,
            modes=modes(posterior, (a_km[1], e[1], i_deg[1])),
            range_grid_km=rho,
            range_posterior=posterior.density / rho,
            prior=self._words(),
            converged=True,
            node_deg=angle_quantiles_deg(angles[:, 0]),
            perigee_deg=angle_quantiles_deg(angles[:, 1]),
            mean_anomaly_deg=angle_quantiles_deg(angles[:, 2]),
            latitude_argument_deg=angle_quantiles_deg(latitude_argument),
            state=state,
        )

    def _prior(self, breakup_share: float) -> PriorTable:
        """Mixture with this share of breakup fragments."""
        low_orbits = 1.0 - self.tail_share - self.ring_share
        return prior_table(
            PriorShares(
                catalogue=(1.0 - breakup_share) * low_orbits,
                breakup=breakup_share * low_orbits,
                tail=self.tail_share,
                ring=self.ring_share,
            )
        )

    def _nothing(self, tracklet: Tracklet, lacks: str) -> OrbitEstimate:
        """The record of a tracklet that allows no estimate, and what it lacks."""
        unknown = np.full(3, np.nan)
        return OrbitEstimate(
            tracklet_id=tracklet.tracklet_id,
            t_ref_tai_ns=tracklet.t_ref_tai_ns,
            range_km=unknown,
            altitude_km=unknown,
            a_km=unknown,
            e=unknown,
            i_deg=unknown,
            size_m=unknown,
            modes=np.zeros((0, 5)),
            range_grid_km=np.zeros(0),
            range_posterior=np.zeros(0),
            prior=self._words(),
            converged=False,
            lacks=lacks,
        )

    def _words(self) -> str:
        """The assumptions, in words."""
        return (
            f"phase-space volume; orbits of catalogued LEO fragments (2023), with NASA breakup velocities for "
            f"{100 * self.breakup_share_small:.0f} % of objects below {100 * SMALL_BELOW_M:g} cm and "
            f"{100 * self.breakup_share_large:.0f} % of larger ones; {100 * self.tail_share:.3g} % on any bound orbit, "
            f"{100 * self.ring_share:.3g} % near the "
            f"geostationary ring; size law d^-2.10 below 1 cm and d^-1.45 above; albedo {self.albedo:g}"
        )


def problem_of(data: Attributable, observer: NDArray[np.float64], at_node_km: NDArray[np.float64]) -> Problem:
    """The arrays of the scan; observer : state (6,) km, km/s at the reference epoch; at_node_km : (k, 3) places."""
    lower = np.linalg.cholesky(data.rate_covariance + 1e-24 * np.eye(2))
    return Problem(
        observer=observer,
        observer_at_node=np.ascontiguousarray(at_node_km),
        axes=np.ascontiguousarray(data.axes),
        rate=data.rate_rad_s,
        form=data.form,
        rate_factor=np.ascontiguousarray(lower),
    )
