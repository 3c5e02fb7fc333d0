"""The figures that stand first, the good ones and the bad ones: on the pages of a run and at the end of `sboc run`."""

from collections.abc import Mapping
from typing import Any, Final

from sboc_e2e.report.words import Row, figure_words
from sboc_e2e.score.figures import Figure, absent

HEADLINES: Final = (
    ("detection.ground.completeness_snr8", "completeness, S/N >= 8"),
    ("detection.ground.false_per_frame", "false streaks per frame"),
    ("detection.ground.snr50", "half-completeness S/N"),
    ("astrometry.frame_rms_arcsec", "frame astrometry (arcsec)"),
    ("astrometry.cross_crlb_ratio", "cross-track / CRLB"),
    ("astrometry.ends_attainable_ratio", "ends / attainable"),
    ("astrometry.along_rms_arcsec", "along-track (arcsec rms)"),
    ("photometry.rms_mag", "streak magnitudes (mag rms)"),
    ("linking.completeness", "objects linked"),
    ("linking.purity", "tracklet purity"),
    ("compression.reduction", "raw / downlink"),
    ("timing.onboard_cpu_s_per_frame", "on-board CPU-s per frame, this run"),
    ("timing.realtime_factor_onboard", "on board, x real time on one core, this run"),
    ("timing.onboard_peak_rss_mb", "on-board process, peak MB, this run"),
)


def figure_at(score: Mapping[str, Any], path: str) -> Figure:
    """A figure of a score by its dotted name; absent where an older score has none."""
    node: Any = score
    for key in path.split("."):
        if not isinstance(node, Mapping) or key not in node:
            return absent("not in this score, which an earlier version made; run: sboc score RUN_DIR")
        node = node[key]
    return dict(node)


def headline_rows(score: Mapping[str, Any]) -> list[Row]:
    """Label, value with interval, n or reason."""
    return [(label, *figure_words(figure_at(score, path))) for path, label in HEADLINES]
