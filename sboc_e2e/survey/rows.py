"""Columns of the samples of pixel runs. Apart from the runs, so that a survey's workers need neither pipeline nor reports."""

from typing import Any, Final

import numpy as np

STREAK_COLUMNS: Final = (
    "object", "frame", "snr", "length_px", "noise_e", "edges", "onboard", "ground", "mag", "mag_error", "mag_pull", "cross_px",
    "cross_pull", "sky_cross_arcsec", "sky_along_arcsec", "along_pull",
)  # fmt: skip
OBJECT_COLUMNS: Final = (
    "object", "size_m", "albedo", "a_km", "e", "i_deg", "weight", "range_km", "rate_deg_s", "altitude_km", "frames", "snr_max",
    "snr_all", "arc_deg", "mag", "detected", "linked", "orbit", "mag_error", "ln_rate_error", "ln_range_error",
    "ln_size_error", "altitude_error_km", "i_error_deg", "size_estimate_m", "light_size_m",
)  # fmt: skip
LEAST_SNR: Final = 3.0
"""Fainter trails are neither found nor counted as missed."""


def columns(rows: list[list[Any]], names: tuple[str, ...]) -> dict[str, Any]:
    """Rows as arrays by name, None as NaN."""
    table = np.array([[np.nan if v is None else v for v in row] for row in rows], dtype=np.float64).reshape(-1, len(names))
    return {name: table[:, k] for k, name in enumerate(names)}
