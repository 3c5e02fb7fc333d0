"""Estimate of the camera parameters that all frames share, with a focal length that may drift.

Ground does not know how fast a tube warms, and the rate changes from hour to hour. With too little process noise the focal length
lags behind the truth. With too much, the information of earlier frames is lost. Therefore several motions are followed in
parallel, and the residuals of the frames select among them (interacting multiple models, Blom &
Bar-Shalom 1988, IEEE Trans. Automatic Control 33, 780). Each motion has a Kalman filter. The estimate is the weighted mean of
all; its covariance includes the scatter of their means.

Errors of the catalogue, and of stars that blend, are the same in each frame that shows the same stars, so they do not average
out. They are modelled as a separate bias of the parameters, which changes as the field moves (a considered state, Schmidt 1966).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.camera import SHARED
from ground.astrometry.camera_fit import CameraPrior

Array = NDArray[np.float64]

N: Final = len(SHARED)
FOCAL, BIAS, RATE = 0, slice(N, 2 * N), 2 * N
STATE: Final = 2 * N + 1
"""A state: shared parameters, their bias by the catalogue, rate of the logarithm of the focal length (1/s)."""

MOTIONS: Final = ((False, 0.0), (True, 0.1), (True, 1.0), (False, 3.0), (False, 20.0))
"""Whether the rate persists, and the random walk of the rate (in drift rates for each root of a second) or, if it does not
persist, of the logarithm of the focal length (in drift rates times the root of a second): at rest, two smooth drifts as heating
and cooling make them, two random walks."""

AT_REST: Final = 0.6
"""Prior probability that the camera does not drift."""

CHANGES_S: Final = 1000.0
"""Mean time between changes of motion, seconds: the typical distance of eclipses and slews. Longer gaps count as this."""

LEAST_WEIGHT: Final = 1e-12
"""Keeps the logarithm of a hypothesis' weight finite and lets it come back."""
UNKNOWN: Final = 1e-9
"""Combinations of parameters on which a frame has this share of the information of the best known one or less are unmeasured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameEvidence:
    """Information of one frame's stars on the shared parameters, attitude unknown: ``gradient + information (x - values)``.

    values : (5,) where the model was linearised. gradient : (5,) of the log-likelihood there. information : (5, 5).
    catalogue : (5, 5) share of the information's noise from errors that persist as long as the field does, such as those of the
    catalogue; the rest is independent from frame to frame. lasting : correlation of these errors with those of the frame before.
    """

    values: Array
    gradient: Array
    information: Array
    catalogue: Array
    lasting: float


@dataclass(frozen=True, kw_only=True, eq=False)
class SharedKnowledge:
    """Weighted states of the motions, in units of `scale`.

    weight : (m,). mean : (m, 11). covariance : (m, 11, 11). scale : (5,) prior errors of the parameters. drift_s : prior error
    of the drift rate (1/s), 0 for a camera that is known not to drift.
    """

    weight: Array
    mean: Array
    covariance: Array
    scale: Array
    drift_s: float

    @classmethod
    def prior(cls, mean: Array, sigma: Array, drift_s: float) -> "SharedKnowledge":
        """Before the first frame. mean, sigma : (5,)."""
        motions = MOTIONS if drift_s > 0.0 else MOTIONS[:1]
        m = len(motions)
        state = np.concatenate((mean / sigma, np.zeros(N + 1)))
        variance = np.concatenate((np.ones(N), np.zeros(N), [(drift_s / sigma[FOCAL]) ** 2]))
        return cls(
            weight=_usual(m),
            mean=np.tile(state, (m, 1)),
            covariance=np.tile(np.diag(variance), (m, 1, 1)),
            scale=sigma,
            drift_s=drift_s,
        )

    @property
    def values(self) -> Array:
        """(5,) best estimate of the shared parameters."""
        return np.asarray(self.scale * (self.weight @ self.mean)[:N])

    @property
    def errors(self) -> Array:
        """(5, 5) covariance of `values`."""
        off = self.mean - self.weight @ self.mean
        total = np.einsum("i,iab->ab", self.weight, self.covariance + off[:, :, None] * off[:, None, :])
        return np.asarray(total[:N, :N] * np.outer(self.scale, self.scale))

    def as_prior(self) -> CameraPrior:
        """The knowledge as one Gaussian."""
        information = np.linalg.inv(self.errors / np.outer(self.scale, self.scale)) / np.outer(self.scale, self.scale)
        return CameraPrior(mean=self.values, information=0.5 * (information + information.T))

    def after(self, seconds: float) -> "SharedKnowledge":
        """The knowledge at a later epoch, without anything seen in between."""
        dt = float(np.clip(seconds, 0.0, CHANGES_S))
        m = len(self.weight)
        change = -np.expm1(-dt / CHANGES_S) if m > 1 else 0.0
        turn = (1.0 - change) * np.eye(m) + change * _usual(m)[None, :]
        weight = np.maximum(self.weight @ turn, LEAST_WEIGHT)
        share = self.weight[:, None] * turn / weight
        mean = share.T @ self.mean
        off = self.mean[:, None, :] - mean[None]
        covariance = np.einsum("ij,iab->jab", share, self.covariance) + np.einsum("ij,ija,ijb->jab", share, off, off)
        drift = self.drift_s / self.scale[FOCAL]
        for k, (lasts, walk) in enumerate(MOTIONS[:m]):
            move, noise = np.eye(STATE), np.zeros((STATE, STATE))
            spread = (walk * drift) ** 2 * dt
            if lasts:
                move[FOCAL, RATE] = dt
                noise[FOCAL, FOCAL], noise[RATE, RATE] = spread * dt * dt / 3.0, spread
                noise[FOCAL, RATE] = noise[RATE, FOCAL] = spread * dt / 2.0
            else:
                # the rate waits at its prior for the day when a drift begins
                move[RATE, RATE] = 0.0
                noise[FOCAL, FOCAL], noise[RATE, RATE] = spread, drift**2
            mean[k] = move @ mean[k]
            covariance[k] = move @ covariance[k] @ move.T + noise
        return SharedKnowledge(
            weight=weight / weight.sum(), mean=mean, covariance=covariance, scale=self.scale, drift_s=self.drift_s
        )

    def seen(self, frame: FrameEvidence) -> "SharedKnowledge":
        """The knowledge with a frame at the same epoch."""
        units = np.outer(self.scale, self.scale)
        information, catalogue = frame.information * units, frame.catalogue * units
        size, axes = np.linalg.eigh(information)
        told = size > UNKNOWN * max(float(size[-1]), 1e-300)
        size, axes = size[told], axes[:, told]
        root = np.sqrt(size)
        # measured, with unit noise in all: root * axes.T @ (parameters + bias)
        place = axes / root
        observed = place.T @ (frame.gradient * self.scale + information @ (frame.values / self.scale))
        by_catalogue = place.T @ catalogue @ place
        noise = np.eye(len(root)) - by_catalogue
        spread = axes / np.where(size > 1.0, root, np.inf)
        bias = spread @ by_catalogue @ spread.T
        design = np.zeros((len(root), STATE))
        design[:, :N] = design[:, BIAS] = (axes * root).T

        mean, covariance = self.mean.copy(), self.covariance.copy()
        keep = frame.lasting
        mean[:, BIAS] *= keep
        covariance[:, BIAS, :] *= keep
        covariance[:, :, BIAS] *= keep
        covariance[:, BIAS, BIAS] += (1.0 - keep * keep) * bias
        log_weight = np.log(np.maximum(self.weight, LEAST_WEIGHT))
        for k in range(len(mean)):
            expected = design @ covariance[k] @ design.T + noise
            missed = observed - design @ mean[k]
            gain = np.linalg.solve(expected, design @ covariance[k]).T
            mean[k] += gain @ missed
            rest = np.eye(STATE) - gain @ design
            covariance[k] = rest @ covariance[k] @ rest.T + gain @ noise @ gain.T
            log_weight[k] -= 0.5 * (float(missed @ np.linalg.solve(expected, missed)) + float(np.linalg.slogdet(expected)[1]))
        weight = np.exp(log_weight - log_weight.max())
        return SharedKnowledge(
            weight=weight / weight.sum(), mean=mean, covariance=covariance, scale=self.scale, drift_s=self.drift_s
        )


def _usual(m: int) -> Array:
    """(m,) probabilities of the motions before anything is seen."""
    if m == 1:
        return np.ones(1)
    return np.array([AT_REST, *[(1.0 - AT_REST) / (m - 1)] * (m - 1)])
