"""The width of the stars of a frame from outside, by SExtractor's moments (Bertin and Arnouts 1996, doi:10.1051/aas:1996164)."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import sep
from numpy.typing import NDArray

FEWEST_STARS: Final = 5  # The median width of five stars leaves out two that are none. Chosen, not measured.

SAMPLED_PX: Final = 1 << 22
"""Pixels of a frame from which on its stars are measured in a sample of squares: of more it takes half a second. Chosen."""

SQUARES: Final = 4  # of the sample, in each direction. Chosen
SQUARE_PX: Final = 256
"""Side of a square of the sample: sixteen hold a megapixel."""

ENOUGH_STARS: Final = 400
"""Stars of the sample that tell the width to 1.3 %: single ones scatter by a fifth. Of fewer the whole frame is measured."""

SINGLE_PIXEL: Final = 0.35
"""Peak after sep's smoothing (3 x 3, weights 1-2-1) over the one before, up to which a source may be a single pixel: one alone
has 0.25, a star of sigma 0.45 px on the middle of a pixel 0.35."""
RESOLVED: Final = 0.7
"""The same of a star that is no group of hot pixels, at least: on the middle of a pixel it has a sigma of 1.1 px. A star as sharp
as a pixel on the corner of four has 0.6."""
MANY_HOT: Final = 0.5
"""Share of single pixels among round sources from which on they are hot pixels, and not the stars of undersampled optics. In 683
frames of others the rule changes the width in nine, all with hot pixels. Chosen in view of them."""

NO_SOURCES: Final = np.zeros(0, dtype=[(name, "f8") for name in ("x", "y", "a", "b", "flux", "peak", "cpeak")] + [("flag", "i8")])


def star_sigma_px(pixels: NDArray[np.float32]) -> float | None:
    """PSF sigma from round, unblended, unsaturated sources (SExtractor moments); None when there are too few.

    Moments above a threshold miss the wings; sources well above it, as taken here, give the width to 15 %. Below 1 px the
    pixels themselves widen it, by a third at 0.8 px. Of large frames a sample is measured. Where most sources are hot pixels,
    their neighbours' noise passes for a narrow star: those that are resolved tell it there.
    """
    if pixels.size >= SAMPLED_PX:
        peak = float(np.fmax.reduce(pixels, axis=None))
        sampled = _without_hot(np.concatenate([_round_sources(square, peak) for square in _squares(pixels)]))
        if len(sampled) >= ENOUGH_STARS:
            return _sigma_px(sampled)
    stars = _without_hot(_round_sources(pixels))
    return None if len(stars) < FEWEST_STARS else _sigma_px(stars)


def _sigma_px(stars: NDArray[Any]) -> float:
    """Median width of SExtractor's records."""
    return float(np.clip(np.median(np.sqrt(stars["a"] * stars["b"])), 0.4, 20.0))


def _without_hot(stars: NDArray[Any]) -> NDArray[Any]:
    """What is resolved where most are single pixels and enough are resolved; else all, as they come."""
    smoothed = stars["cpeak"] / stars["peak"]
    resolved = stars[smoothed >= RESOLVED]
    hot = len(resolved) >= FEWEST_STARS and float(np.mean(smoothed < SINGLE_PIXEL)) > MANY_HOT
    return resolved if hot else stars


def _squares(pixels: NDArray[np.float32]) -> Iterator[NDArray[np.float32]]:
    """Squares spread evenly over a frame, those without any value left out."""
    for box_row, box_col in np.ndindex(SQUARES, SQUARES):
        top, left = (
            max((2 * k + 1) * side // (2 * SQUARES) - SQUARE_PX // 2, 0)
            for k, side in zip((box_row, box_col), pixels.shape, strict=True)
        )
        square = pixels[top : top + SQUARE_PX, left : left + SQUARE_PX]
        if np.isfinite(square).any():
            yield square


def _round_sources(pixels: NDArray[np.float32], full: float | None = None) -> NDArray[Any]:
    """SExtractor's records of single round sources. full : the highest value of the frame that the pixels are of."""
    sources, noise, peak = sources_of(pixels)
    return sources[
        (sources["flag"] == 0)
        & (sources["b"] > 0.7 * sources["a"])
        & (sources["peak"] > 15.0 * noise)
        & (sources["peak"] < 0.7 * (peak if full is None else full))
    ]


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
