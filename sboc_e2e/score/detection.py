"""Completeness and false alarms, of the on-board ROIs and of the measured streaks."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.signals import RoiGroup
from sboc_e2e.score.figures import Figure, absent, exact, half_point, proportion, rate
from sboc_e2e.score.ideal import ideal_snr50, ideal_threshold
from sboc_e2e.score.matching import SNR_IGNORED, TruthStreak
from sboc_e2e.score.trail import draw

LEAST_DETECTABLE_SNR: Final = 8.0
"""The default detector finds half at S/N 7.26 [7.10, 7.38] (docs/survey.md); below, noise decides."""
FLUX_HELD: Final = 0.90  # Definition of `n_detected` on board (docs/scoring.md): share of the electrons inside regions. Chosen.
FLUX_OF_FALSE: Final = 0.10
"""Definition of `false_per_frame` (docs/scoring.md): less of every trail makes a region false. Chosen."""
MAX_AREA_FRACTION: Final = 0.05
"""A score fails above it (docs/scoring.md), or a detector that sends everything would win. Chosen."""
IMPOSTOR: Final = StreakFlag.COSMIC_LIKE | StreakFlag.SPIKE_LIKE
"""Flags by which the on-board software itself says that a region holds no object."""
SNR_EDGES: Final = (3.0, 5.0, 6.0, 7.0, 8.0, 10.0, 15.0, 30.0, 100.0, np.inf)
LENGTH_EDGES: Final = (0.0, 10.0, 20.0, 50.0, 100.0, 200.0, 400.0, 1000.0, 2000.0, np.inf)
RATE_EDGES: Final = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, np.inf)


class RoiFootprints:
    """Which truth streaks the ROIs of each frame hold, gathered frame by frame."""

    def __init__(self) -> None:
        self._held = np.zeros((0, 0), dtype=np.bool_)
        self.captured: dict[int, float] = {}
        self.false_groups: list[tuple[int, int]] = []
        self.n_false_unflagged = 0
        self.area_fraction: list[float] = []
        self.n_groups = 0

    def add_frame(self, frame: int, shape: tuple[int, int], groups: Sequence[RoiGroup], truth: Sequence[TruthStreak]) -> None:
        """Measure the ROIs of one frame of `shape` against its truth streaks."""
        if self._held.shape != shape:
            self._held = np.zeros(shape, dtype=np.bool_)
        rows, cols = shape
        footprints: list[tuple[NDArray[np.int32], NDArray[np.int32]]] = []
        for group in groups:
            parts = [strip.pixel_coordinates(rows, cols) for strip in group.strips]
            row = np.concatenate([r[inside] for r, _, inside in parts] or [np.zeros(0, np.int32)])
            col = np.concatenate([c[inside] for _, c, inside in parts] or [np.zeros(0, np.int32)])
            footprints.append((row, col))
        trails = [(streak, *draw(streak.path).pixels(rows, cols)) for streak in truth]
        best = np.zeros(len(groups))
        for g, (row, col) in enumerate(footprints):
            self._held[row, col] = True
            for _, t_row, t_col, electrons in trails:
                total = electrons.sum()
                if total > 0:
                    best[g] = max(best[g], electrons[self._held[t_row, t_col]].sum() / total)
            self._held[row, col] = False
        for row, col in footprints:
            self._held[row, col] = True
        self.area_fraction.append(float(np.count_nonzero(self._held)) / self._held.size if groups else 0.0)
        for streak, t_row, t_col, electrons in trails:
            total = electrons.sum()
            self.captured[streak.index] = float(electrons[self._held[t_row, t_col]].sum() / total) if total > 0 else 0.0
        for row, col in footprints:
            self._held[row, col] = False
        self.n_groups += len(groups)
        false = [group for group, share in zip(groups, best, strict=True) if share < FLUX_OF_FALSE]
        self.false_groups += [(frame, group.roi_id) for group in false]
        self.n_false_unflagged += sum(not group.detection.flags & IMPOSTOR for group in false)


def lost_to_budget(truth: Sequence[TruthStreak], detected_index: set[int], records: Mapping[int, Housekeeping]) -> Figure:
    """Upper limit of the share of the truth with S/N >= 8 that the limits of the downlink cost.

    records : housekeeping by frame. The packets give the number of detections held back in a frame, but not their identity. Each
    counts as one missed streak of the frame, up to the number of missed streaks. Detections held back as particle hits are left
    out if the frame is within its budget and not in a storm.
    """
    wanted = [t for t in truth if t.counted and t.snr >= LEAST_DETECTABLE_SNR and t.frame in records]
    missed = Counter(t.frame for t in wanted if t.index not in detected_index)
    limited = FrameFlag.BUDGET_CUT | FrameFlag.STORM
    dropped = {frame: record.n_rois_dropped for frame, record in records.items() if record.flags & limited}
    lost = sum(min(missed[frame], number) for frame, number in dropped.items())
    return proportion(lost, len(wanted), "no truth streak with S/N >= 8 in a frame with housekeeping")


def _ideal(value: float | None) -> Figure:
    return absent("the frame is too small for the formula") if value is None else exact(value, 0)


def _bins(truth: Sequence[TruthStreak], detected: NDArray[np.bool_]) -> list[dict[str, Any]]:
    quantities = {
        "snr": (SNR_EDGES, np.array([t.snr for t in truth])),
        "length_px": (LENGTH_EDGES, np.array([t.length_px for t in truth])),
        "rate_deg_s": (RATE_EDGES, np.array([t.rate_deg_s for t in truth])),
    }
    snr = quantities["snr"][1]
    out = []
    for name, (edges, value) in quantities.items():
        for low, high in pairwise(edges):
            chosen = (value >= low) & (value < high) & ~(snr < (SNR_IGNORED if name == "snr" else LEAST_DETECTABLE_SNR))
            if chosen.any():
                share = proportion(int(detected[chosen].sum()), int(chosen.sum()))
                out.append({"quantity": name, "from": low, "to": None if np.isinf(high) else high, "detected": share})
    return out


def detection_figures(
    truth: Sequence[TruthStreak],
    detected_index: set[int],
    n_false: int,
    n_frames: int,
    shape: tuple[int, int],
    sigma_px: float,
) -> dict[str, Any]:
    """Figures shared by the on-board and the ground half."""
    counted = [t for t in truth if t.counted]
    found = np.array([t.index in detected_index for t in counted], dtype=bool)
    snr = np.array([t.snr for t in counted])
    length = np.array([t.length_px for t in counted])
    measured = np.isfinite(snr)
    unknown = "the truth gives neither S/N nor flux" if counted and not measured.any() else ""

    def complete(limit: float) -> Figure:
        above = snr >= limit
        return proportion(int(found[above].sum()), int(above.sum()), unknown or f"no truth streak with S/N >= {limit:g}")

    by_length = {}
    for low, high in pairwise(LENGTH_EDGES):
        chosen = (length >= low) & (length < high) & measured
        if chosen.any():
            label = f"{low:g}-{high:g} px" if np.isfinite(high) else f">= {low:g} px"
            by_length[label] = half_point(snr[chosen], found[chosen])
    false = rate(n_false, n_frames, n_frames)
    return {
        "n_truth": exact(len(counted), len(counted)),
        "n_detected": exact(int(found.sum()), len(counted)),
        "completeness": proportion(int(found.sum()), len(counted), "no truth streak"),
        "completeness_snr8": complete(LEAST_DETECTABLE_SNR),
        "completeness_snr10": complete(10.0),
        "snr50": half_point(snr[measured], found[measured]) if measured.any() else absent(unknown or "no truth streak"),
        "snr50_by_length": by_length,
        "ideal_snr50": _ideal(ideal_snr50(0.1, *shape, sigma_px)),
        "ideal_threshold": _ideal(ideal_threshold(0.1, *shape, sigma_px)),
        "false_per_frame": false,
        "bins": _bins(counted, found),
    }
