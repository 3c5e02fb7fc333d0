"""An independent little camera for streak tests: trails by brute-force integration, their noise and their Cramér-Rao bounds.

A trail is a dense row of point sources along its path, each integrated over pixels by differences of the error function.
Nothing of the fitter's closed forms is used, and the Fisher matrix is numerical.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sboc_e2e.icd.products import StreakPixels
from sboc_e2e.icd.signals import Detection

READ_NOISE_E = 2.3
SKY_E = 2.78
VARIANCE_E2 = SKY_E + READ_NOISE_E**2
PSF_SIGMA_PX = 0.85
STEPS_PER_PX = 12


@dataclass(frozen=True, kw_only=True)
class Trail:
    """Ends (PSF centres), flux, PSF sigma; sagitta px; brightness 1 + gradient (x - 1/2) + amplitude sin(2 pi cycles x)."""

    row0: float
    col0: float
    row1: float
    col1: float
    flux_e: float
    sigma_px: float = PSF_SIGMA_PX
    sagitta_px: float = 0.0
    gradient: float = 0.0
    amplitude: float = 0.0
    cycles: float = 0.0
    wiggle_px: float = 0.0

    @property
    def length_px(self) -> float:
        return math.hypot(self.row1 - self.row0, self.col1 - self.col0)

    @property
    def axes(self) -> tuple[float, float]:
        """(cos, sin): direction of (col, row) along the trail."""
        return (self.col1 - self.col0) / self.length_px, (self.row1 - self.row0) / self.length_px

    def nodes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(row, col, electrons) of its point sources."""
        n = max(int(STEPS_PER_PX * self.length_px), 24)
        x = (np.arange(n) + 0.5) / n
        cos, sin = self.axes
        v = 4.0 * self.sagitta_px * x * (1.0 - x) + self.wiggle_px * np.sin(2 * np.pi * self.cycles * x)
        light = 1.0 + self.gradient * (x - 0.5) + self.amplitude * np.sin(2 * np.pi * self.cycles * x)
        u = x * self.length_px
        return self.row0 + u * sin + v * cos, self.col0 + u * cos - v * sin, self.flux_e * light / n

    def moved(self, along0: float, along1: float, across0: float, across1: float, flux: float) -> "Trail":
        """The trail with displaced ends and more flux: the parameters of the Fisher matrix."""
        cos, sin = self.axes
        return replace(
            self,
            row0=self.row0 + along0 * sin + across0 * cos,
            col0=self.col0 + along0 * cos - across0 * sin,
            row1=self.row1 + along1 * sin + across1 * cos,
            col1=self.col1 + along1 * cos - across1 * sin,
            flux_e=self.flux_e + flux,
        )


def trail_at(
    rng: np.random.Generator, length_px: float, *, angle_rad: float | None = None, centre: float = 2000.0, **shape: float
) -> Trail:
    """A trail of unit flux at a random angle and sub-pixel position, ends by growing col."""
    angle = rng.uniform(-0.5 * np.pi, 0.5 * np.pi) if angle_rad is None else angle_rad
    row, col = centre + rng.uniform(-0.5, 0.5, 2)
    drow, dcol = 0.5 * length_px * math.sin(angle), 0.5 * length_px * math.cos(angle)
    return Trail(row0=row - drow, col0=col - dcol, row1=row + drow, col1=col + dcol, flux_e=1.0, **shape)


@njit(cache=True)
def accumulate(row, col, light, sigma, row_min, col_min, image):
    reach = int(6.0 * sigma + 2.0)
    scale = 1.0 / (sigma * math.sqrt(2.0))
    count = 2 * reach + 1
    weight_r, weight_c = np.empty(count), np.empty(count)
    for i in range(row.size):
        r0, c0 = math.floor(row[i] + 0.5) - reach, math.floor(col[i] + 0.5) - reach
        for k in range(count):
            weight_r[k] = 0.5 * (math.erf((r0 + k + 0.5 - row[i]) * scale) - math.erf((r0 + k - 0.5 - row[i]) * scale))
            weight_c[k] = 0.5 * (math.erf((c0 + k + 0.5 - col[i]) * scale) - math.erf((c0 + k - 0.5 - col[i]) * scale))
        for a in range(count):
            r = r0 + a - row_min
            if 0 <= r < image.shape[0]:
                for b in range(count):
                    c = c0 + b - col_min
                    if 0 <= c < image.shape[1]:
                        image[r, c] += light[i] * weight_r[a] * weight_c[b]


def render(trail: Trail, row: NDArray[np.int32], col: NDArray[np.int32]) -> NDArray[np.float64]:
    """Expected electrons of the given pixels, (n,)."""
    row_min, col_min = int(row.min()), int(col.min())
    image = np.zeros((int(row.max()) - row_min + 1, int(col.max()) - col_min + 1))
    accumulate(*trail.nodes(), trail.sigma_px, row_min, col_min, image)
    return image[row - row_min, col - col_min]


def strip(trail: Trail, *, margin_px: float, half_px: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Pixels within `half_px` of the chord and `margin_px` of its ends."""
    cos, sin = trail.axes
    middle = (0.5 * (trail.row0 + trail.row1), 0.5 * (trail.col0 + trail.col1))
    reach = 0.5 * trail.length_px + margin_px
    major = np.arange(math.floor(-reach - half_px), math.ceil(reach + half_px) + 1)
    width = math.ceil(1.5 * half_px) + 1
    minor = np.arange(-width, width + 1)
    if abs(cos) >= abs(sin):
        col = np.rint(middle[1] + major).astype(np.int32)[:, None] + 0 * minor
        row = np.rint(middle[0] + (col - middle[1]) * sin / cos).astype(np.int32) + minor
    else:
        row = np.rint(middle[0] + major).astype(np.int32)[:, None] + 0 * minor
        col = np.rint(middle[1] + (row - middle[0]) * cos / sin).astype(np.int32) + minor
    u = (col - middle[1]) * cos + (row - middle[0]) * sin
    v = (row - middle[0]) * cos - (col - middle[1]) * sin
    inside = (np.abs(u) <= reach) & (np.abs(v) <= half_px)
    return row[inside].astype(np.int32), col[inside].astype(np.int32)


def attainable_px(length_px: float, snr: float) -> float:
    """Change-point law of one end: 4.39 L / S^2 (sqrt(16 zeta(3)), posterior mean)."""
    return 4.39 * length_px / snr**2


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposure:
    """A noisy trail in its strip: pixels, a detection as bad as a detector's, and the truth."""

    trail: Trail
    pixels: StreakPixels
    detection: Detection
    snr: float

    def bounds(self) -> dict[str, float]:
        """Cramér-Rao bounds (1 sigma) of flux_e, end_px, cross_px (of the middle) and the ends' 2 x 2 covariance."""
        covariance = fisher_covariance(self.trail, self.pixels.row, self.pixels.col)
        return {
            "flux_e": math.sqrt(covariance[0, 0]),
            "end_px": math.sqrt(0.5 * (covariance[1, 1] + covariance[2, 2])),
            "cross_px": 0.5 * math.sqrt(covariance[3, 3] + covariance[4, 4] + 2 * covariance[3, 4]),
            "end_cov_px2": 0.5 * (covariance[1, 2] + covariance[2, 1]),
        }


def fisher_covariance(trail: Trail, row: NDArray[np.int32], col: NDArray[np.int32]) -> NDArray[np.float64]:
    """Inverse Fisher matrix (5, 5) of (flux, along0, along1, across0, across1), the object's Poisson noise included."""
    steps = np.array([1e-3 * trail.flux_e, 0.02, 0.02, 0.02, 0.02])
    derivatives = []
    for k in range(5):
        change = np.zeros(5)
        change[k] = steps[k]
        up, down = (trail.moved(*(s * change[1:]), s * change[0]) for s in (1.0, -1.0))
        derivatives.append((render(up, row, col) - render(down, row, col)) / (2.0 * steps[k]))
    jacobian = np.array(derivatives)
    return np.linalg.inv((jacobian / (VARIANCE_E2 + render(trail, row, col))) @ jacobian.T)


def expose(
    rng: np.random.Generator,
    trail: Trail,
    snr: float,
    *,
    extra_e: NDArray[np.float64] | None = None,
    half_px: float = 8.0,
    margin_px: float | None = None,
    cross_error_px: float = 0.5,
) -> Exposure:
    """A noisy exposure of the trail, its flux scaled to the matched-filter S/N.

    The detection's ends are off by the attainable law along the trail and by `cross_error_px` across it.
    """
    law = attainable_px(trail.length_px, snr)
    margin = 10.0 + 4.0 * law + 0.05 * trail.length_px if margin_px is None else margin_px
    row, col = strip(trail, margin_px=margin, half_px=half_px)
    unit = render(replace(trail, flux_e=1.0), row, col)
    trail = replace(trail, flux_e=snr / math.sqrt(float(np.sum(unit**2)) / VARIANCE_E2))
    mean = trail.flux_e * unit + (0.0 if extra_e is None else extra_e)
    value = rng.poisson(mean + SKY_E) - SKY_E + rng.normal(0.0, READ_NOISE_E, mean.shape)
    pixels = StreakPixels(
        row=row,
        col=col,
        value_e=value,
        variance_e2=np.full(row.shape, VARIANCE_E2),
        psf_sigma_px=PSF_SIGMA_PX,
        frame_shape=(4096, 4096),
    )
    bound = math.sqrt(2.0 * math.sqrt(math.pi) * trail.sigma_px * trail.length_px) / snr
    along = np.clip(rng.normal(0.0, max(law, bound), 2), -0.25 * trail.length_px, 0.25 * trail.length_px)
    across = rng.normal(0.0, cross_error_px, 2)
    guess = trail.moved(along[0], along[1], across[0], across[1], 0.0)
    detection = Detection(row0=guess.row0, col0=guess.col0, row1=guess.row1, col1=guess.col1, snr=snr)
    return Exposure(trail=trail, pixels=pixels, detection=detection, snr=snr)


def residuals(trail: Trail, row0: float, col0: float, row1: float, col1: float) -> tuple[float, float, float]:
    """(along of end 0, along of end 1, across of the middle) of measured ends, px; ends in either order."""
    cos, sin = trail.axes
    if (row1 - row0) * sin + (col1 - col0) * cos < 0.0:
        row0, col0, row1, col1 = row1, col1, row0, col0
    d0, d1 = (row0 - trail.row0, col0 - trail.col0), (row1 - trail.row1, col1 - trail.col1)
    across = 0.5 * ((d0[0] + d1[0]) * cos - (d0[1] + d1[1]) * sin)
    return d0[0] * sin + d0[1] * cos, d1[0] * sin + d1[1] * cos, across


def best_equivariant_end_px(trail: Trail, rng: np.random.Generator, draws: int) -> float:
    """Rms of the best possible estimate of one end, everything else known: line, density, the other end.

    Pitman's estimator, the posterior mean under a flat prior, has the least rms of all estimators that move with the data
    (Pitman 1939). It bounds what any fit of all parameters can reach, also where neither the Cramér-Rao bound nor the
    change-point law holds. Likelihood: normal, with the object's own Poisson noise.
    """
    density = trail.flux_e / trail.length_px
    variance = VARIANCE_E2
    information = density**2 / (2.0 * math.sqrt(math.pi) * trail.sigma_px * variance)
    # the posterior falls off like exp(-information x / 8)
    reach = 44.0 / information + 6.0 * trail.sigma_px
    step = max(1.0 / STEPS_PER_PX, reach / 400.0)
    cos, sin = trail.axes
    candidates = np.arange(-reach, reach + 0.5 * step, step)
    span = reach + 6.0 * trail.sigma_px

    def lit(start: float, stop: float) -> Trail:
        return replace(
            trail, row0=start * sin, col0=start * cos, row1=stop * sin, col1=stop * cos, flux_e=density * (stop - start)
        )

    row, col = strip(lit(-span, span), margin_px=0.0, half_px=4.0 * trail.sigma_px)
    means = [render(lit(reach, span + 8.0 * trail.sigma_px), row, col)]
    for stop, start in zip(candidates[:0:-1], candidates[-2::-1], strict=True):
        means.append(means[-1] + render(lit(start, stop), row, col))
    mean = np.array(means[::-1])
    truth = len(candidates) // 2
    noisy = rng.poisson(mean[truth] + SKY_E, (draws, row.size)) - SKY_E + rng.normal(0.0, READ_NOISE_E, (draws, row.size))
    weight = 1.0 / (variance + mean)
    log = noisy @ (mean * weight).T - 0.5 * (noisy**2) @ weight.T - 0.5 * np.sum(mean**2 * weight - np.log(weight), axis=1)
    posterior = np.exp(log - log.max(axis=1, keepdims=True))
    estimate = posterior @ candidates / posterior.sum(axis=1)
    return float(np.sqrt(np.mean((estimate - candidates[truth]) ** 2)))
