"""A picture of a tracklet: its path on the sky, how far its directions lie from a smooth passage, and its light curve."""

import io
from collections.abc import Sequence
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from ground.products.light_curve import light_curve
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

_STYLE: Final = {"svg.hashsalt": "sboc", "svg.fonttype": "none", "font.size": 8, "axes.grid": True, "grid.alpha": 0.25}


def tracklet_svg(tracklet: Tracklet, members: Sequence[StreakMeasurement]) -> str:
    """SVG document of a tracklet and its streaks. Without dates, so that bytes repeat."""
    curve = light_curve(members)
    t_s = np.asarray((tracklet.t_tai_ns - tracklet.t_tai_ns.min()) * 1e-9, dtype=np.float64)
    good = np.isfinite(tracklet.ra_deg) & np.isfinite(tracklet.dec_deg)
    t_s, dec = t_s[good], np.radians(tracklet.dec_deg[good])
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib's names of settings are a literal type
        figure = Figure(figsize=(9.0, 3.0), layout="constrained")
        sky, rest, magnitudes = figure.subplots(1, 3)
        if len(t_s):
            ra = np.unwrap(np.radians(tracklet.ra_deg[good]))
            east = np.degrees((ra - ra[0]) * np.cos(dec.mean())) * 60.0
            north = np.degrees(dec - dec[0]) * 60.0
            sky.plot(east, north, ".-", lw=0.8)
            along, cross = _from_smooth(t_s, east * 60.0, north * 60.0)
            rest.errorbar(t_s, along, tracklet.sigma_along_arcsec[good], fmt="o", ms=3, label="along")
            rest.errorbar(t_s, cross, tracklet.sigma_cross_arcsec[good], fmt="s", ms=3, label="across")
            rest.legend(fontsize=7)
        magnitudes.errorbar(curve.t_s, curve.mag, curve.mag_err, fmt="o", ms=3)
        magnitudes.invert_yaxis()
        sky.invert_xaxis()
        sky.set(xlabel="east (arcmin)", ylabel="north (arcmin)", title=f"tracklet {tracklet.tracklet_id}")
        rest.set(xlabel="time (s)", ylabel="from a quadratic motion (arcsec)", title=f"{tracklet.rate_deg_s:.4g} deg/s")
        title = f"period {curve.period_s:.3g} s" if np.isfinite(curve.period_s) else "no period"
        magnitudes.set(xlabel="time (s)", ylabel="V (mag)", title=title)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def _from_smooth(t_s: np.ndarray, east: np.ndarray, north: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of a quadratic in time, along and across the mean motion."""
    degree = min(2, len(np.unique(t_s)) - 1)
    left = np.stack([v - np.polyval(np.polyfit(t_s, v, degree), t_s) for v in (east, north)])
    way = np.array([east[-1] - east[0], north[-1] - north[0]])
    way = way / max(float(np.hypot(*way)), 1e-12)
    return way @ left, np.array([-way[1], way[0]]) @ left
