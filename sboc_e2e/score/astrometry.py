"""Residuals of streaks and frames: in pixels against the true path and its bounds, on the sky in arcseconds."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.score.bounds import TrailBounds
from sboc_e2e.score.figures import absent, bootstrap, proportion, pull_width, rms
from sboc_e2e.score.matching import TruthStreak, distance_to_path

ARCSEC_PER_RAD = math.degrees(1.0) * 3600.0
SHORTEST_LINE_PX = 4.0
"""A shorter chord has no sure direction: an FWHM of 2 px at both ends. Its middle is judged instead. Chosen, not measured."""


def _along_of_ends(measured: NDArray[np.float64], truth: TruthStreak) -> NDArray[np.float64]:
    """Along-track residual of both measured ends, outward positive, in truth order (nearest assignment)."""
    true_ends = truth.ends
    chord = true_ends[1] - true_ends[0]
    along = chord / max(float(np.hypot(*chord)), 1e-9)
    ends = measured if float((measured[1] - measured[0]) @ along) >= 0 else measured[::-1]
    return np.array([-(ends[0] - true_ends[0]) @ along, (ends[1] - true_ends[1]) @ along])


def _across_of_line(ends: NDArray[np.float64], sagitta_px: float, truth: TruthStreak) -> float:
    """Mean distance (px) of the measured arc across the true path, over what both cover; of its middle where it has no length.

    The bound is that of a trail moved as a whole. Jitter bends the path within an exposure, so a point of it is not the whole.
    Positive to the side that is the motion turned from (drow, dcol) to (-dcol, drow).
    """
    chord = ends[1] - ends[0]
    half = 0.5 * float(np.hypot(*chord))
    if half < SHORTEST_LINE_PX / 2:
        return distance_to_path(ends.mean(axis=0), truth.path)[0]
    along = chord / (2.0 * half)
    normal = np.array([-along[1], along[0]])
    nodes = np.stack([truth.path.row, truth.path.col], axis=1) - ends.mean(axis=0)
    x = nodes @ along / half
    common = np.abs(x) <= 1.0
    if np.count_nonzero(common) < 2:
        return distance_to_path(ends.mean(axis=0), truth.path)[0]
    # the contract: a positive sagitta bends the chord towards (+dcol, -drow)
    offset = -sagitta_px * (1.0 - x[common] ** 2) - nodes[common] @ normal
    mean = float(np.trapezoid(offset, x[common]) / (x[common][-1] - x[common][0]))
    return mean if float((truth.ends[1] - truth.ends[0]) @ along) >= 0.0 else -mean


def streak_astrometry(
    streaks: Table, pairs: Mapping[int, TruthStreak], bounds: Mapping[int, TrailBounds], truth_sky: Mapping[int, "SkyPath"]
) -> tuple[dict[str, Any], list[dict[str, float]]]:
    """Figures, and one row of residuals for each matched streak (for plots).

    streaks : products/streaks.ecsv. pairs : its row -> truth. bounds, truth_sky : by truth index, as far as they are known.
    """
    rows: list[dict[str, float]] = []
    for index, truth in pairs.items():
        s = streaks[index]
        ends = np.array([[s["row0"], s["col0"]], [s["row1"], s["col1"]]], dtype=float)
        cross_px = _across_of_line(ends, float(s["sagitta_px"]), truth)
        bound = bounds.get(truth.index)
        out = {
            "row": float(index),
            "snr": truth.snr,
            "length_px": truth.length_px,
            "cross_px": cross_px,
            "cross_ratio": cross_px / bound.cross_px if bound else math.nan,
            "cross_pull": cross_px / float(s["sigma_cross_px"]) if s["sigma_cross_px"] > 0 else math.nan,
        }
        if truth.length_px >= 10.0:
            end_px = _along_of_ends(ends, truth)
            for which, cut in ((0, truth.path.edge0), (1, truth.path.edge1)):
                if not cut:
                    out[f"end{which}_px"] = float(end_px[which])
                crlb = (bound.end0_px, bound.end1_px)[which] if bound else None
                if bound and crlb is not None:
                    out[f"end{which}_ratio"] = float(end_px[which]) / crlb
                    out[f"end{which}_attainable"] = float(end_px[which]) / bound.attainable(crlb)
        sky = truth_sky.get(truth.index)
        if sky is not None and np.isfinite(s["ra_mid_deg"]) and s["t_mid_tai_ns"] > 0:
            along, across = sky.offset_arcsec(float(s["ra_mid_deg"]), float(s["dec_mid_deg"]), int(s["t_mid_tai_ns"]))
            out["sky_cross_arcsec"] = across
            # A trail that the frame cuts and no other frame times has no epoch along its track.
            timed = not (truth.path.edge0 or truth.path.edge1) or int(s["flags"]) & StreakFlag.DIRECTION_RESOLVED
            if timed:
                out["sky_along_arcsec"] = along
                if s["sigma_along_arcsec"] > 0:
                    out["along_pull"] = along / float(s["sigma_along_arcsec"])
        rows.append(out)

    def column(*names: str, snr_min: float = 8.0) -> NDArray[np.float64]:
        values = [r[name] for r in rows for name in names if name in r and not r["snr"] < snr_min]
        values = [v for v in values if math.isfinite(v)]
        return np.array(values, dtype=np.float64)

    inside = column("along_pull")
    few = "too few to measure" if bounds or not pairs else "the truth gives no flux, so there are no bounds"
    figures = {
        "cross_rms_px": bootstrap(column("cross_px"), rms),
        "ends_rms_px": bootstrap(column("end0_px", "end1_px"), rms),
        "cross_crlb_ratio": bootstrap(column("cross_ratio"), rms, few),
        "ends_attainable_ratio": bootstrap(column("end0_attainable", "end1_attainable"), rms, few),
        "ends_crlb_ratio": bootstrap(column("end0_ratio", "end1_ratio"), rms, few),
        "cross_pull_std": bootstrap(column("cross_pull"), pull_width),
        "along_pull_std": bootstrap(inside, pull_width),
        "along_coverage_68": proportion(int((np.abs(inside) <= 1.0).sum()), len(inside), "no matched streak on the sky"),
        "cross_rms_arcsec": bootstrap(column("sky_cross_arcsec"), rms),
        "along_rms_arcsec": bootstrap(column("sky_along_arcsec"), rms),
    }
    return figures, rows


class SkyPath:
    """Published directions of a truth streak as unit vectors over time."""

    def __init__(self, t_tai_ns: NDArray[np.int64], ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]) -> None:
        self._t0 = int(t_tai_ns[0])
        self._t_s = (t_tai_ns - self._t0) / 1e9
        self._unit = _unit(ra_deg, dec_deg)

    def offset_arcsec(self, ra_deg: float, dec_deg: float, t_tai_ns: int) -> tuple[float, float]:
        """Measured minus true direction at the measured epoch: along the motion and across it."""
        t_s = (t_tai_ns - self._t0) / 1e9
        span = max(float(self._t_s[-1] - self._t_s[0]), 1e-9)
        # Beyond the ends (time errors, point-like trails) the path goes on straight.
        where = float(np.clip(np.searchsorted(self._t_s, t_s) - 1, 0, len(self._t_s) - 2))
        i = int(where)
        step_s = max(float(self._t_s[i + 1] - self._t_s[i]), 1e-12)
        true = self._unit[i] + (self._unit[i + 1] - self._unit[i]) * ((t_s - self._t_s[i]) / step_s)
        true = true / np.linalg.norm(true)
        motion = (self._unit[-1] - self._unit[0]) / span
        motion = motion - (motion @ true) * true
        norm = float(np.linalg.norm(motion))
        along = motion / norm if norm > 1e-12 else _east(true)
        across = np.cross(true, along)
        offset = _unit(np.array([ra_deg]), np.array([dec_deg]))[0] - true
        return float(offset @ along) * ARCSEC_PER_RAD, float(offset @ across) * ARCSEC_PER_RAD


def _unit(ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def _east(unit: NDArray[np.float64]) -> NDArray[np.float64]:
    east = np.array([-unit[1], unit[0], 0.0])
    return np.asarray(east / max(float(np.linalg.norm(east)), 1e-12))


def _axes_of_frame(
    row: NDArray[np.float64], col: NDArray[np.float64], unit: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors (3,) on the sky of growing row and of growing col, mean over the field. row, col : (n,); unit : (n, 3)."""
    slopes = np.linalg.lstsq(np.stack([np.ones_like(row), row, col], axis=-1), unit, rcond=None)[0][1:]
    along_row, along_col = slopes / np.maximum(np.linalg.norm(slopes, axis=-1, keepdims=True), 1e-300)
    return along_row, along_col


def frame_astrometry(frames: Table, truth_frames: Table) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """`frame_rms_arcsec` and `frame_bias_arcsec` on the 9 x 9 grid of each solved frame, and the grids for plots.

    Grids have the offsets (arcsec) along the directions in which row and col grow, which is how a frame is drawn.
    """
    by_number = {int(t["frame"]): t for t in truth_frames}
    frame_rms, biases, grids = [], [], []
    for s in frames:
        truth = by_number.get(int(s["frame"]))
        if truth is None or int(s["flags"]) & FrameFlag.NO_SOLUTION or not np.isfinite(truth["grid_ra_app_deg"]).all():
            continue
        row, col = np.asarray(truth["grid_row"], float), np.asarray(truth["grid_col"], float)
        # both tables have the directions of the same pixels, so no model of a camera is needed here
        solved = _unit(np.asarray(s["grid_ra_app_deg"], float), np.asarray(s["grid_dec_app_deg"], float))
        true = _unit(np.asarray(truth["grid_ra_app_deg"], float), np.asarray(truth["grid_dec_app_deg"], float))
        east = np.stack([-true[:, 1], true[:, 0], np.zeros(len(true))], axis=-1)
        east /= np.linalg.norm(east, axis=-1, keepdims=True)
        north = np.cross(true, east)
        offset = (solved - true) * ARCSEC_PER_RAD
        de, dn = np.einsum("ij,ij->i", offset, east), np.einsum("ij,ij->i", offset, north)
        frame_rms.append(float(np.sqrt(np.mean(de**2 + dn**2))))
        biases.append((float(de.mean()), float(dn.mean())))
        along_row, along_col = (offset @ axis for axis in _axes_of_frame(row, col, true))
        grids.append(
            {"frame": int(s["frame"]), "row": row, "col": col, "along_row_arcsec": along_row, "along_col_arcsec": along_col}
        )
    if not frame_rms:
        none = absent("no frame was solved, or the truth has no directions of frames")
        return {"frame_rms_arcsec": none, "frame_bias_arcsec": none}, []

    def bias(b: NDArray[np.float64]) -> float:
        return float(np.hypot(*b.mean(axis=0)))

    return {
        "frame_rms_arcsec": bootstrap(frame_rms, rms, "fewer than three solved frames"),
        "frame_bias_arcsec": bootstrap(biases, bias, "fewer than three solved frames"),
    }, grids


def sky_paths(truth_streaks: Table | NDArray[np.void], wanted: Sequence[int]) -> dict[int, SkyPath]:
    """Sky paths of truth streaks by row of the table, without those whose directions are not known."""
    return {
        i: SkyPath(
            np.asarray(truth_streaks["path_t_tai_ns"][i], np.int64),
            np.asarray(truth_streaks["path_ra_deg"][i], float),
            np.asarray(truth_streaks["path_dec_deg"][i], float),
        )
        for i in wanted
        if np.isfinite(truth_streaks["path_ra_deg"][i]).all()
    }
