"""Every figure of `sboc validate`: one comparison of a simulated image with a real one."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.score.figures import SEED, Figure, absent, bootstrap, exact, rate, rms
from sboc_e2e.validation import distances
from sboc_e2e.validation.background import Background, LinearMatch, match, measure_background
from sboc_e2e.validation.noise import NoiseSpectrum, noise_spectrum
from sboc_e2e.validation.sources import Sources, Widths, find_sources, star_widths
from sboc_e2e.validation.star_places import StarMatch, match_known
from sboc_e2e.validation.subjects import Picture

COUNT_SNR: Final = 10.0
"""Stars are counted above this aperture S/N: below it, detection is not complete."""
MOST_PIXELS: Final = 2_000_000
"""Distances sort their samples; two million have a Kolmogorov-Smirnov 1 % point of 0.0016, below what real frames differ by."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """One image and all that was measured on it."""

    picture: Picture
    background: Background
    spectrum: NoiseSpectrum | None
    sources: Sources
    widths: Widths
    stars: StarMatch | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Validation:
    """Both sides, the linear match and the figures."""

    simulated: Side
    real: Side
    match: LinearMatch
    figures: dict[str, Any]


def compare(simulated: Picture, real: Picture) -> Validation:
    """All figures of two images."""
    backgrounds = [measure_background(p.image) for p in (simulated, real)]
    radius_px = aperture_radius(backgrounds[1])
    ours, theirs = (_side(p, b, radius_px) for p, b in zip((simulated, real), backgrounds, strict=True))
    linear = match(ours.background, theirs.background)
    figures = {
        "simulated": {"name": simulated.name, "notes": list(simulated.notes)},
        "real": {"name": real.name, "notes": list(real.notes)},
        "match": {
            "gain": linear.gain,
            "bias_adu": linear.bias,
            "simulated_level_adu": ours.background.level,
            "simulated_noise_adu": ours.background.noise,
            "real_level_adu": theirs.background.level,
            "real_noise_adu": theirs.background.noise,
        },
        "histogram": _histograms(ours, theirs),
        "noise": _noise(ours.spectrum, theirs.spectrum),
        "stars": _stars(ours, theirs),
        "psf": _psf(ours.widths, theirs.widths),
        "catalogue": {"simulated": _catalogue(ours), "real": _catalogue(theirs), "real_minus_simulated": _pairs(ours, theirs)},
    }
    return Validation(simulated=ours, real=theirs, match=linear, figures=_plain(figures))


def aperture_radius(background: Background) -> float:
    """Radius of the apertures on both images, px: 1.2 FWHM of the real image's stars, from a first round of fits."""
    first = find_sources(background, 4.0)
    widths = star_widths(background, first, ceiling=np.inf)
    fwhm_px = float(np.median(np.sqrt(widths.major * widths.minor))) if len(widths) else 2.5
    return float(np.clip(1.2 * fwhm_px, 2.0, 15.0))


def _side(picture: Picture, background: Background, radius_px: float) -> Side:
    sources = find_sources(background, radius_px)
    top = float(np.nanmax(picture.image)) if picture.saturation_adu is None else picture.saturation_adu
    ceiling = 0.7 * (top - background.level) / background.noise
    return Side(
        picture=picture,
        background=background,
        spectrum=noise_spectrum(background),
        sources=sources,
        widths=star_widths(background, sources, ceiling),
        stars=match_known(sources, picture.known) if picture.known is not None else None,
    )


def matched_values(side: Side, *, everything: bool) -> NDArray[np.float64]:
    """Pixels as (value - median) / noise, which is the linear match; whole-number pixels get their rounding back at random.

    everything : all pixels; otherwise the source-free ones, with the smooth background taken out.
    """
    background = side.background
    if everything:
        finite = side.picture.image[np.isfinite(side.picture.image)]
        values = (finite.astype(np.float64) - background.level) / background.noise
    else:
        values = background.free_values.astype(np.float64)
    values = values[:: max(1, len(values) // MOST_PIXELS)]
    step = side.picture.step_adu / background.noise
    if step == 0.0:
        return values
    return np.asarray(values + step * (np.random.default_rng(SEED).random(len(values)) - 0.5))


def _histograms(ours: Side, theirs: Side) -> dict[str, Any]:
    """Distances of pixel values, in units of the noise."""
    result = {}
    for name, everything in (("background", False), ("all_pixels", True)):
        first, second = (matched_values(side, everything=everything) for side in (ours, theirs))
        edges = distances.shared_bins(first, second)
        statistic, _ = distances.kolmogorov_smirnov(first, second)
        result[name] = {
            "wasserstein_sigma": distances.wasserstein(first, second),
            "bhattacharyya": distances.bhattacharyya(distances.histogram(first, edges), distances.histogram(second, edges)),
            "ks": statistic,
            # 1 % point of the statistic for independent samples of one parent (Smirnov 1948)
            "ks_one_percent": 1.628 * float(np.sqrt(1.0 / len(first) + 1.0 / len(second))),
            "n": [len(first), len(second)],
        }
        if not everything:
            result[name] |= {
                "skewness": [_moment(v, 3) for v in (first, second)],
                "excess_kurtosis": [_moment(v, 4) - 3.0 for v in (first, second)],
                "beyond_5_sigma_per_mpx": [1e6 * float(np.mean(np.abs(v) > 5.0)) for v in (first, second)],
            }
    return result


def _moment(values: NDArray[np.float64], order: int) -> float:
    """Standardised moment inside 5 sigma, where single defects and cosmic rays do not rule it."""
    core = values[np.abs(values) < 5.0]
    return float(np.mean(((core - core.mean()) / core.std()) ** order))


def _noise(ours: NoiseSpectrum | None, theirs: NoiseSpectrum | None) -> dict[str, Any]:
    if ours is None or theirs is None:
        return {"reason": "no tile of 64 x 64 px is free of sources"}
    with np.errstate(divide="ignore"):
        log_ratio = np.log(theirs.radial / ours.radial)
    return {
        "frequency_per_px": ours.frequency.tolist(),
        "simulated_power": ours.radial.tolist(),
        "real_power": theirs.radial.tolist(),
        "rms_log_ratio": rms(log_ratio),
        "row_structure": [ours.row_structure, theirs.row_structure],
        "col_structure": [ours.col_structure, theirs.col_structure],
        "n_tiles": [ours.n_tiles, theirs.n_tiles],
    }


def counted(side: Side) -> NDArray[np.float64]:
    """Fluxes (noise units) of the stars that are counted."""
    return side.sources.flux[side.sources.snr > COUNT_SNR]


def slope(flux: NDArray[np.float64]) -> float:
    """Power a of ``N(> F) ~ F^-a``, maximum likelihood (Crawford, Jauncey & Murdoch 1970, ApJ 162, 405)."""
    log = np.log(flux / flux.min())
    return float((len(flux) - 1) / log.sum()) if log.sum() > 0 else float("nan")


def _stars(ours: Side, theirs: Side) -> dict[str, Any]:
    """Counts and fluxes of stars above the counting S/N."""
    result: dict[str, Any] = {"aperture_radius_px": ours.sources.radius_px, "counted_above_snr": COUNT_SNR}
    fluxes = []
    for name, side in (("simulated", ours), ("real", theirs)):
        flux = counted(side)
        fluxes.append(flux)
        area_mpx = side.picture.image.size * 1e-6
        result[name] = {
            "per_mpx": rate(len(flux), area_mpx, len(flux)),
            "slope": bootstrap(flux, slope) if len(flux) >= 10 else absent("fewer than 10 stars", len(flux)),
            "trails": side.sources.n_trails,
        }
    if min(len(f) for f in fluxes) < 5:
        return result | {"flux_ks": absent("fewer than 5 stars on a side", min(len(f) for f in fluxes))}
    statistic, probability = distances.kolmogorov_smirnov(*fluxes)
    logs = [np.log10(f) for f in fluxes]
    return result | {
        "flux_ks": exact(statistic, sum(len(f) for f in fluxes)),
        "flux_ks_probability": probability,
        "flux_wasserstein_mag": 2.5 * distances.wasserstein(*logs),
    }


def _psf(ours: Widths, theirs: Widths) -> dict[str, Any]:
    """Widths of isolated stars."""
    result: dict[str, Any] = {}
    for name, widths in (("simulated", ours), ("real", theirs)):
        result[name] = {
            "fwhm_major_px": bootstrap(widths.major, _median),
            "fwhm_minor_px": bootstrap(widths.minor, _median),
            "axis_ratio": bootstrap(widths.minor / widths.major, _median),
            "scatter_px": bootstrap(np.sqrt(widths.major * widths.minor), _spread),
        }
    if min(len(ours), len(theirs)) < 3:
        return result | {"ks": absent("fewer than 3 isolated stars on a side", min(len(ours), len(theirs)))}
    mean = [np.sqrt(w.major * w.minor) for w in (ours, theirs)]
    statistic, probability = distances.kolmogorov_smirnov(*mean)
    return result | {
        "ks": exact(statistic, len(ours) + len(theirs)),
        "ks_probability": probability,
        "wasserstein_px": distances.wasserstein(*mean),
    }


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values))


def _spread(values: NDArray[np.float64]) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _catalogue(side: Side) -> dict[str, Any]:
    """Detected stars against catalogue ones."""
    if side.stars is None or side.picture.known is None:
        return {"reason": "no WCS and no truth: places of catalogue stars are not known"}
    stars = side.stars
    return {
        "origin": side.picture.known.origin,
        "in_field": len(side.picture.known),
        "matched": len(stars),
        "offset_px": [stars.offset_row, stars.offset_col],
        "row_rms_px": bootstrap(stars.row, rms),
        "col_rms_px": bootstrap(stars.col, rms),
        "magnitude_scatter_mag": _scatter(stars.magnitude),
    }


def _scatter(values: NDArray[np.float64]) -> Figure:
    return bootstrap(values[np.isfinite(values)], lambda v: float(np.std(v, ddof=1)))


def _pairs(ours: Side, theirs: Side) -> dict[str, Any]:
    """The same catalogue stars in both images: where, and how bright."""
    if ours.stars is None or theirs.stars is None:
        return {"reason": "stars of one image are not known"}
    _, i, j = np.intersect1d(ours.stars.star_id, theirs.stars.star_id, return_indices=True)
    if len(i) == 0:
        return {"reason": "no catalogue star was found in both images"}
    row = theirs.stars.place_row[j] - ours.stars.place_row[i]
    col = theirs.stars.place_col[j] - ours.stars.place_col[i]
    magnitude = theirs.stars.magnitude[j] - ours.stars.magnitude[i]
    return {
        "n": len(i),
        "offset_px": [float(np.median(row)), float(np.median(col))],
        "row_rms_px": bootstrap(row - np.median(row), rms),
        "col_rms_px": bootstrap(col - np.median(col), rms),
        "offset_mag": float(np.median(magnitude)),
        "magnitude_scatter_mag": _scatter(magnitude),
    }


def _plain(value: Any) -> Any:
    """JSON-able: numbers that are not finite become null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
