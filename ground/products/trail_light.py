"""Brightness along single trails, as a table: where a trail has the signal to tell."""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final

import numpy as np
from astropy.table import Column, Table
from numpy.typing import NDArray

from ground.photometry.zero_point import POGSON
from ground.records import GroundProducts
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakMeasurement
from sboc_e2e.icd.version import CONTRACT_VERSION

BIN_SNR: Final = 5.0
"""Neighbouring bins of a fit's light curve are joined until the median one has this S/N."""

FEWEST_BINS: Final = 4
"""Fewer bins say less than the streak's magnitude and slope; chosen, not measured."""
STREAKS_AT_ONCE: Final = 512
"""Streaks in memory at once, of up to 200 bins each; a limit of memory."""

COLUMNS: Final = (
    ("frame", "i8", None, "frame number, 0-based"),
    ("streak_id", "i8", None, "streak in streaks.ecsv"),
    ("tracklet_id", "i8", None, "-1 while unlinked"),
    ("t_tai_ns", "i8", "ns", "epoch of the bin's middle; 0 where the direction of motion is unknown"),
    ("along_px", "f8", "pix", "bin's middle from end 0, along the trail as fitted in its frame alone"),
    ("length_px", "f8", "pix", "of the bin"),
    ("density_e_px", "f8", "electron / pix", "flux density"),
    ("density_err_e_px", "f8", "electron / pix", "its error"),
    ("relative", "f8", None, "density over its mean along the trail"),
    ("relative_err", "f8", None, "its error, the mean's left out"),
    ("mag", "f8", "mag", "Johnson V for a solar colour; NaN where the streak has none or the density is not positive"),
    ("mag_err", "f8", "mag", "its error, that of the streak's mag left out"),
)
META: Final = (
    f"trails that are not vetoed, in at least {FEWEST_BINS} bins of S/N {BIN_SNR:g}; bins at an end miss light of the PSF's edge "
    "where the end is uncertain; mag = streak's mag - 2.5 log10(relative)"
)


def trail_light_tables(products: GroundProducts) -> Iterator[Table]:
    """Pieces of one table with a row for each bin of each trail that has enough signal, at least one piece."""
    left = iter(products.streaks)
    yield _table(list(islice(left, STREAKS_AT_ONCE)))
    while part := list(islice(left, STREAKS_AT_ONCE)):
        yield _table(part)


def joined_bins(fit: StreakFit) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Densities and errors (k,) of equal bins of S/N `BIN_SNR` or more from end 0 to end 1; None where there are too few.

    The bins of the fit are independent; as many as are left over when joining are shared out.
    """
    density, error = fit.light_curve_e_px.astype(np.float64), fit.light_curve_err_e_px.astype(np.float64)
    if len(density) < FEWEST_BINS or not np.isfinite(error).all():
        return None
    snr = float(density.mean() / np.median(error))
    if not snr > 0.0:
        return None
    n_bins = int(len(density) / max(1.0, (BIN_SNR / snr) ** 2))
    if n_bins < FEWEST_BINS:
        return None
    edges = np.linspace(0.0, len(density), n_bins + 1)
    # the part of each old bin in each new one, which has a mean of densities
    low, high = np.maximum(edges[:-1, None], np.arange(len(density))), np.minimum(edges[1:, None], np.arange(1, len(density) + 1))
    share = np.maximum(high - low, 0.0) / np.diff(edges)[:, None]
    return share @ density, np.sqrt(share**2 @ error**2)


def _table(streaks: Sequence[StreakMeasurement]) -> Table:
    parts = [_rows(s) for s in streaks if not s.flags & StreakFlag.VETOED]
    rows = np.concatenate([np.zeros(0, dtype=[(name, kind) for name, kind, _, _ in COLUMNS]), *parts])
    columns = [Column(rows[name], name=name, unit=unit, description=text) for name, _, unit, text in COLUMNS]
    return Table(columns, meta={"table": "light_curves", "contract_version": CONTRACT_VERSION, "selection": META})


def _rows(streak: StreakMeasurement) -> NDArray[np.void]:
    """The bins of one streak, none without the signal."""
    found = joined_bins(streak.fit)
    density, error = (np.zeros(0), np.zeros(0)) if found is None else found
    rows = np.zeros(len(density), dtype=[(name, kind) for name, kind, _, _ in COLUMNS])
    if found is None:
        return rows
    place = (np.arange(len(density)) + 0.5) / len(density)
    rows["frame"], rows["streak_id"], rows["tracklet_id"] = streak.frame, streak.streak_id, streak.tracklet_id
    if streak.flags & StreakFlag.DIRECTION_RESOLVED:
        first_ns, _, last_ns = streak.t_tai_ns.tolist()
        rows["t_tai_ns"] = first_ns + np.rint(place * (last_ns - first_ns)).astype(np.int64)
    rows["along_px"], rows["length_px"] = place * streak.fit.length_px, streak.fit.length_px / len(density)
    rows["density_e_px"], rows["density_err_e_px"] = density, error
    rows["relative"], rows["relative_err"] = density / density.mean(), error / density.mean()
    lit = np.where(density > 0.0, density, np.nan)
    rows["mag"] = streak.mag - 2.5 * np.log10(lit / density.mean())
    rows["mag_err"] = np.where(np.isfinite(rows["mag"]), POGSON * error / lit, np.nan)
    return rows
