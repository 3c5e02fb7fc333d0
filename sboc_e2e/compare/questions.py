"""What a comparison asks of each seam: the figures of the score that its step decides."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from sboc_e2e.report.headlines import figure_at
from sboc_e2e.score.figures import Figure, absent, figure

_DETECTION: Final = (
    ("detection.{half}.completeness_snr8", "completeness, S/N >= 8"),
    ("detection.{half}.snr50", "half-completeness S/N"),
    ("detection.{half}.false_per_frame", "false per frame"),
)
_POSITIONS: Final = (
    ("astrometry.cross_crlb_ratio", "across the trail / CRLB"),
    ("astrometry.cross_pull_std", "pulls across (1: errors are stated right)"),
    ("astrometry.along_pull_std", "pulls along (1: errors are stated right)"),
    ("astrometry.ends_attainable_ratio", "ends / attainable"),
    ("astrometry.cross_rms_arcsec", "across (arcsec rms)"),
    ("astrometry.along_rms_arcsec", "along (arcsec rms)"),
)
_BITS: Final = (
    ("compression.bits_per_streak", "bits per streak"),
    ("compression.bits_per_frame", "bits per frame"),
    ("compression.bits_per_pixel_lossless", "bits per pixel, whole frame without loss"),
    ("compression.entropy_bound_bits", "entropy of the noise, bits per pixel"),
    ("compression.lossless_bit_exact", "whole frames that came back bit by bit (share)"),
    ("compression.reduction", "raw / downlink"),
)

QUESTIONS: Final[dict[str, tuple[tuple[str, str], ...]]] = {
    "onboard.background": (*_DETECTION, ("compression.captured_flux_fraction", "light inside the regions (share)")),
    "onboard.star_extractor": (
        ("astrometry.frame_rms_arcsec", "frame astrometry (arcsec rms)"),
        ("photometry.zero_point_error_mag", "zero point error (mag)"),
        ("compression.bits_per_star", "bits per star"),
        *_DETECTION,
    ),
    "onboard.detector": (
        *_DETECTION,
        ("detection.onboard.false_unflagged_per_frame", "false per frame that carry no flag"),
        ("detection.onboard.roi_area_fraction", "area of the regions (share of the frame)"),
        ("compression.captured_flux_fraction", "light inside the regions (share)"),
    ),
    "onboard.tracker": (
        *_DETECTION,
        ("detection.onboard.false_unflagged_per_frame", "false per frame that carry no flag"),
        ("linking.completeness", "objects linked (share)"),
        ("compression.bits_per_frame", "bits per frame"),
    ),
    "onboard.codec": (*_BITS, ("photometry.bias_mag", "magnitude bias, which loss would move (mag)")),
    "ground.decoder": _BITS,
    "ground.streak_fitter": (
        *_POSITIONS,
        ("photometry.pull_std", "pulls of magnitudes"),
        ("photometry.rms_mag", "magnitudes (mag rms)"),
    ),
    "ground.vetter": (*_DETECTION, ("linking.veto_loss", "real streaks that it rejects (share)")),
    "ground.astrometry": (
        ("astrometry.frame_rms_arcsec", "frame astrometry (arcsec rms)"),
        ("astrometry.frame_bias_arcsec", "frame bias (arcsec)"),
        *_POSITIONS,
    ),
    "ground.photometry": (
        ("photometry.zero_point_error_mag", "zero point error (mag)"),
        ("photometry.bias_mag", "magnitude bias (mag)"),
        ("photometry.rms_mag", "magnitudes (mag rms)"),
        ("photometry.pull_std", "pulls of magnitudes"),
    ),
    "ground.linker": (
        ("linking.completeness", "objects linked (share)"),
        ("linking.purity", "purity of tracklets"),
        ("linking.fragments_per_object", "tracklets for each linked object"),
        ("linking.direction_correct", "sense of motion right (share)"),
        ("linking.false_tracklets_per_1000_frames", "false tracklets in 1,000 frames"),
    ),
    "ground.orbit": (
        ("orbit.range_error_median", "range error, median (share)"),
        ("orbit.interval_coverage_90", "90 % intervals that hold the range (share)"),
        ("orbit.altitude_error_median_km", "altitude error, median (km)"),
        ("orbit.inclination_error_median_deg", "inclination error, median (deg)"),
        ("orbit.trivial_root_rate", "orbits that fell to the trivial root (share)"),
    ),
}


def answers(seam: str, scores: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[dict[str, Any]]:
    """For each question of a seam its label, its name in score.json and a figure for each choice.

    scores : for each choice the score of each seed.
    """
    half = "onboard" if seam.startswith("onboard.") else "ground"
    out = []
    for path, label in QUESTIONS[seam]:
        name = path.format(half=half)
        found = {choice: joined([figure_at(score, name) for score in runs]) for choice, runs in scores.items()}
        out.append({"figure": name, "label": label, "choices": found})
    return out


def joined(figures: Sequence[Figure]) -> Figure:
    """One figure of several seeds: the mean weighted by n, and the interval of such a mean of independent runs."""
    present = [f for f in figures if f["value"] is not None]
    if not present:
        return absent(str(figures[0].get("reason", "no reason was recorded")), sum(f["n"] for f in figures))
    if len(present) == 1:
        return dict(present[0])
    weights = [max(f["n"], 1) for f in present]
    total = sum(weights)

    def mean(name: str) -> float:
        return float(sum(w * f[name] for w, f in zip(weights, present, strict=True)) / total)

    def reach(name: str) -> float:
        return math.sqrt(sum((w * (f[name] - f["value"])) ** 2 for w, f in zip(weights, present, strict=True))) / total

    value = mean("value")
    return figure(value, sum(f["n"] for f in present), value - reach("low"), value + reach("high"))
