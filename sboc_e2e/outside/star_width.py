"""The width of the stars of a frame from outside, by SExtractor's moments (Bertin and Arnouts 1996, doi:10.1051/aas:1996164)."""

from typing import Any, Final

import numpy as np
import sep
from numpy.typing import NDArray

FEWEST_STARS: Final = 5  # The median width of five stars leaves out two that are none. Chosen, not measured.

NO_SOURCES: Final = np.zeros(0, dtype=[(name, "f8") for name in ("x", "y", "a", "b", "flux", "peak")] + [("flag", "i8")])


def star_sigma_px(pixels: NDArray[np.float32]) -> float | None:
    """PSF sigma from round, unblended, unsaturated sources (SExtractor moments); None when there are too few.

    Moments above a threshold miss the wings; sources well above it, as taken here, give the width to 15 %. Below 1 px the
    pixels themselves widen it, by a third at 0.8 px.
    """
    sources, noise, peak = sources_of(pixels)
    stars = sources[
        (sources["flag"] == 0)
        & (sources["b"] > 0.7 * sources["a"])
        & (sources["peak"] > 15.0 * noise)
        & (sources["peak"] < 0.7 * peak)
    ]
    if len(stars) < FEWEST_STARS:
        return None
    return float(np.clip(np.median(np.sqrt(stars["a"] * stars["b"])), 0.4, 20.0))


def sources_of(pixels: NDArray[Any]) -> tuple[NDArray[Any], float, float]:
    """SExtractor's records of what is brighter than 5 sigma, none in frames too crowded for it; noise and highest value."""
    image = np.array(pixels, dtype=np.float32, order="C")
    if not np.isfinite(image).all():
        image = np.nan_to_num(image, nan=float(np.nanmedian(pixels)))
    background = sep.Background(image)
    noise, peak = max(float(background.globalrms), 1e-6), float(image.max())
    image -= background.back()
    try:
        return sep.extract(image, 5.0, err=noise, minarea=5), noise, peak
    except Exception as error:  # sep raises bare Exception when its buffers overflow in crowded frames
        if "internal pixel buffer full" in str(error) or "object deblending overflow" in str(error):
            return NO_SOURCES, noise, peak
        raise
