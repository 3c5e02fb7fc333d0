"""Streaks as rows of numbers. A row takes half a kilobyte, a record with its arrays five times as much."""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.on_demand import ByPlace
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakMeasurement, Tracklet

STREAKS_PER_FRAME: Final = 100_000
"""streak_id = frame * this + number of the streak in its frame."""

FIT_NUMBERS: Final = (
    "row0", "col0", "row1", "col1", "sigma_cross_px", "flux_e", "flux_err_e", "snr", "sagitta_px", "sagitta_err_px", "gradient",
    "width_px", "width_err_px", "chi2_nu", "flash_e", "track_frames",
)  # fmt: skip
NUMBERS: Final = (
    "row_mid", "col_mid", "sigma_along_arcsec", "sigma_cross_arcsec", "mag", "mag_err", "mag_at_1deg_s", "mag_at_1deg_s_err",
    "probability", "track_snr",
)  # fmt: skip
COUNTS: Final = ("frame", "streak_id", "roi_id", "tracklet_id", "track")

ROW: Final = np.dtype(
    [
        ("counts", "i8", len(COUNTS)),
        ("numbers", "f8", len(NUMBERS)),
        ("sky_deg", "f8", (2, 3)),
        ("turn_rad_s", "f8", 3),
        ("t_tai_ns", "i8", 3),
        ("flags", "i8", 2),
        ("n_pixels", "i8"),
        ("fit_numbers", "f8", len(FIT_NUMBERS)),
        ("covariance_px2", "f8", (4, 4)),
        ("end_interval_px", "f8", (2, 2)),
        ("light_interval_px", "f8", (2, 2)),
        ("period_fraction", "f8"),
        ("curve_end", "i8"),
    ]
)
"""`sky_deg` : right ascensions, declinations. `flags` : of the measurement, of its fit. `light_interval_px`, `period_fraction` :
NaN for none. `curve_end` : where the light curve ends among all curves; it begins where the one before ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StreakRows(ByPlace[StreakMeasurement]):
    """Streaks as rows. Indexing makes a record.

    rows : (n,) of `ROW`. curves_e_px : (2, m) light curves one after the other, and their errors.
    """

    rows: NDArray[np.void]
    curves_e_px: NDArray[np.float32]

    @classmethod
    def of(cls, streaks: Iterable[StreakMeasurement]) -> "StreakRows":
        """The rows of records."""
        made: list[tuple[Any, ...]] = []
        curves: list[NDArray[np.float32]] = [np.zeros((2, 0), dtype=np.float32)]
        end = 0
        for streak in streaks:
            fit = streak.fit
            curves.append(np.stack((fit.light_curve_e_px, fit.light_curve_err_e_px)))
            end += len(fit.light_curve_e_px)
            made.append(
                (
                    [getattr(streak, name) for name in COUNTS],
                    [getattr(streak, name) for name in NUMBERS],
                    (streak.ra_deg, streak.dec_deg),
                    streak.turn_rad_s,
                    streak.t_tai_ns,
                    (int(streak.flags), int(fit.flags)),
                    fit.n_pixels,
                    [getattr(fit, name) for name in FIT_NUMBERS],
                    fit.covariance_px2,
                    fit.end_interval_px,
                    fit.light_interval_px if len(fit.light_interval_px) else np.full((2, 2), np.nan),
                    np.nan if fit.period_fraction is None else fit.period_fraction,
                    end,
                )
            )
        rows, joined = np.array(made, dtype=ROW), np.concatenate(curves, axis=1)
        for array in (rows, joined):
            array.flags.writeable = False
        return cls(rows=rows, curves_e_px=joined)

    def turned(self, turn_rad_s: NDArray[np.float64]) -> "StreakRows":
        """The same streaks with the angular velocity (3,) of the camera."""
        rows = self.rows.copy()
        rows["turn_rad_s"] = turn_rad_s
        rows.flags.writeable = False
        return StreakRows(rows=rows, curves_e_px=self.curves_e_px)

    def __len__(self) -> int:
        return len(self.rows)

    def _item(self, place: int) -> StreakMeasurement:
        row = self.rows[place]
        flags, fit_flags = row["flags"].tolist()
        period = float(row["period_fraction"])
        curve, curve_err = self.curves_e_px[:, self.rows["curve_end"][place - 1] if place else 0 : row["curve_end"]]
        fit = StreakFit(
            covariance_px2=row["covariance_px2"],
            end_interval_px=row["end_interval_px"],
            light_interval_px=row["light_interval_px"][: 0 if np.isnan(row["light_interval_px"]).all() else 2],
            n_pixels=int(row["n_pixels"]),
            flags=StreakFlag(fit_flags),
            light_curve_e_px=curve,
            light_curve_err_e_px=curve_err,
            period_fraction=None if np.isnan(period) else period,
            **dict(zip(FIT_NUMBERS, row["fit_numbers"].tolist(), strict=True)),
        )
        return StreakMeasurement(
            fit=fit,
            ra_deg=row["sky_deg"][0],
            dec_deg=row["sky_deg"][1],
            turn_rad_s=row["turn_rad_s"],
            t_tai_ns=row["t_tai_ns"],
            flags=StreakFlag(flags),
            **dict(zip(COUNTS, row["counts"].tolist(), strict=True)),
            **dict(zip(NUMBERS, row["numbers"].tolist(), strict=True)),
        )


class RunStreaks(ByPlace[StreakMeasurement]):
    """Streaks of a run, frame by frame. counts : number of streaks of each frame; of_frame : function that gives those of the
    k-th frame."""

    def __init__(self, counts: Iterable[int], of_frame: Callable[[int], Sequence[StreakMeasurement]]) -> None:
        self._first = list(accumulate(counts, initial=0))
        self._of_frame = of_frame

    def __len__(self) -> int:
        return self._first[-1]

    def __iter__(self) -> Iterator[StreakMeasurement]:
        for k in range(len(self._first) - 1):
            yield from self._of_frame(k)

    def _item(self, place: int) -> StreakMeasurement:
        frame = bisect_right(self._first, place) - 1
        return self._of_frame(frame)[place - self._first[frame]]


class LinkedStreaks:
    """The members of all tracklets of a run, and where they belong.

    place : position in the run of each frame number. A streak that two tracklets claim belongs to the later one.
    """

    def __init__(self, place: Mapping[int, int], n_tracklets: int) -> None:
        self.place = place
        self._members = [StreakRows.of(())] * n_tracklets
        self._sorted: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None

    @property
    def members(self) -> tuple[StreakRows, ...]:
        """Of each tracklet, in frame order."""
        return tuple(self._members)

    def places_of(self, tracklet: Tracklet) -> list[tuple[int, int]]:
        """Position of the frame and number in it of each member, rising; streaks of unknown frames are left out."""
        keys = zip(tracklet.frames.tolist(), tracklet.streak_ids.tolist(), strict=True)
        return sorted((self.place[frame], i - frame * STREAKS_PER_FRAME) for frame, i in keys if frame in self.place)

    def of_tracklet(self, number: int) -> StreakRows:
        """Members of a tracklet that were stored last."""
        return self._members[number]

    def put(self, number: int, members: Iterable[StreakMeasurement]) -> None:
        """Keep the members of a tracklet."""
        self._members[number] = StreakRows.of(members)
        self._sorted = None

    def of_frame(self, k: int) -> dict[int, StreakMeasurement]:
        """The linked streaks of the k-th frame by their numbers."""
        keys, owners = self._index()
        low, high = np.searchsorted(keys, (k * STREAKS_PER_FRAME, (k + 1) * STREAKS_PER_FRAME))
        found = {}
        for key, (tracklet, row) in zip(keys[low:high].tolist(), owners[low:high].tolist(), strict=True):
            found[key - k * STREAKS_PER_FRAME] = self._members[tracklet][row]
        return found

    def _index(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Sorted places (n,) of all members as frame position * STREAKS_PER_FRAME + number; tracklet and row (n, 2) of each."""
        if self._sorted is None:
            counts = [rows.rows["counts"] for rows in self._members]
            frame, streak_id = np.concatenate([np.zeros((0, len(COUNTS)), dtype=np.int64), *counts])[:, :2].T
            position = np.array([self.place[f] for f in frame.tolist()], dtype=np.int64)
            keys = streak_id + (position - frame) * STREAKS_PER_FRAME
            tracklet = np.repeat(np.arange(len(counts)), [len(c) for c in counts])
            row = np.concatenate([np.zeros(0, dtype=np.int64), *(np.arange(len(c)) for c in counts)])
            order = np.argsort(keys, kind="stable")
            self._sorted = keys[order], np.column_stack((tracklet, row))[order]
        return self._sorted
