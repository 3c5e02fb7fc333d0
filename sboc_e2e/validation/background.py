"""The background of an image: level, noise, the pixels that are free of sources, and the match of one image to another."""

from dataclasses import dataclass

import cv2
import numpy as np
import sep
from numpy.typing import NDArray

MESH_PX = 64
"""SExtractor's default BACK_SIZE, and sep's. The spectrum of the noise is not used below two periods of it."""
DETECT_SIGMA = 2.5
"""Of a pixel. Chosen, not measured: above SExtractor's 1.5, as what is masked by chance narrows the noise."""
MIN_AREA_PX = 5
"""Connected pixels of a source: SExtractor's default DETECT_MINAREA, and sep's."""
GROW_PX = 4
"""Detected pixels are grown by this, so that the wings of stars do not pass for noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Background:
    """level, noise : median and robust rms (1.4826 MAD) of source-free pixels, ADU. residual : (rows, cols) image minus the
    smooth background, 0 where masked. free : (rows, cols) pixels without sources and with a number."""

    level: float
    noise: float
    residual: NDArray[np.float32]
    free: NDArray[np.bool_]

    @property
    def free_values(self) -> NDArray[np.float32]:
        """Residuals of source-free pixels, in units of the noise."""
        return np.asarray(self.residual[self.free] / np.float32(self.noise))


def measure_background(image: NDArray[np.float32]) -> Background:
    """Smooth background (mesh of clipped modes, Bertin & Arnouts 1996), sources masked in two rounds.

    image : (rows, cols) ADU, NaN where masked.
    """
    bad = ~np.isfinite(image)
    filled = np.where(bad, np.float32(np.nanmedian(image)), image).astype(np.float32)
    sources = bad
    for _ in range(2):
        mesh = sep.Background(filled, mask=sources, bw=MESH_PX, bh=MESH_PX)
        residual = filled - mesh.back(dtype=np.float32)
        noise = robust_rms(residual[~sources])
        _, segments = sep.extract(residual, DETECT_SIGMA, err=noise, mask=bad, minarea=MIN_AREA_PX, segmentation_map=True)
        sources = bad | _grown(segments > 0)
        if sources.mean() > 0.9:
            sources = bad | (segments > 0)
    free = ~sources
    noise = robust_rms(residual[free])
    level = float(np.median(image[free]))
    return Background(level=level, noise=noise, residual=np.where(bad, np.float32(0.0), residual), free=free)


def robust_rms(values: NDArray[np.float32]) -> float:
    """1.4826 times the median absolute deviation; where quantisation makes it 0, the clipped standard deviation."""
    middle = np.median(values)
    spread = 1.4826 * float(np.median(np.abs(values - middle)))
    if spread > 0.0:
        return spread
    clipped = values[np.abs(values - middle) <= 5.0 * max(float(values.std()), 1e-30)]
    return max(float(clipped.std()), 1e-12)


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask widened by `GROW_PX` in rows and columns."""
    kernel = np.ones((2 * GROW_PX + 1, 2 * GROW_PX + 1), np.uint8)
    return np.asarray(cv2.dilate(mask.astype(np.uint8), kernel) > 0)


@dataclass(frozen=True, kw_only=True)
class LinearMatch:
    """``real = gain * simulated + bias``: the linear map that gives both source-free backgrounds one median and one rms."""

    gain: float
    bias: float


def match(simulated: Background, real: Background) -> LinearMatch:
    """The map of simulated ADU to real ADU."""
    gain = real.noise / simulated.noise
    return LinearMatch(gain=gain, bias=real.level - gain * simulated.level)
