"""One row for each streak, see `streaks_tables`."""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final

import numpy as np
from astropy.table import Table

from ground.products.epochs import utc_text
from ground.products.tables.columns import Spec, directions_of, or_nan, table_of, texts
from ground.records import GroundProducts
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement

STREAKS_AT_ONCE: Final = 4096
"""Rows in memory at once; a limit of memory."""

CROSSINGS: Final = (
    "SINGLE_FRAME with EDGE0 and EDGE1 is an object that crossed the field within one exposure; its speed is unknown: "
    "mag = mag_at_1deg_s - 2.5 log10(rate in deg/s)"
)


def streaks_tables(products: GroundProducts) -> Iterator[Table]:
    """One row for each measured streak; ends by growing col before linking, by time after it (DIRECTION_RESOLVED)."""
    left = iter(products.streaks)
    directions = directions_of(products.headers)
    part = list(islice(left, STREAKS_AT_ONCE))
    yield _streaks_table(part, directions)
    while part := list(islice(left, STREAKS_AT_ONCE)):
        yield _streaks_table(part, directions)


def _streaks_table(streaks: Sequence[StreakMeasurement], directions: str) -> Table:
    fits = [s.fit for s in streaks]
    covariance = np.array([f.covariance_px2 for f in fits]).reshape(-1, 4, 4)
    interval = np.array([f.end_interval_px for f in fits]).reshape(-1, 2, 2)
    light = np.array([f.light_ends_px for f in fits]).reshape(-1, 2, 2)
    ra, dec = (np.array([getattr(s, name) for s in streaks]).reshape(-1, 3) for name in ("ra_deg", "dec_deg"))
    t = [np.array([s.t_tai_ns[k] for s in streaks], dtype=np.int64) for k in range(3)]
    length = np.array([np.nan if f.flags & StreakFlag.POINT_LIKE or f.length_px == 0.0 else f.length_px for f in fits])
    density = np.array([(f.flux_e, f.flux_err_e) for f in fits]).reshape(-1, 2) / length[:, None]
    lists: list[Spec] = [
        ("frame", [s.frame for s in streaks], None, "frame number, 0-based"),
        ("streak_id", [s.streak_id for s in streaks], None, "unique in a run"),
        ("roi_id", [s.roi_id for s in streaks], None, "ROI group it was measured in"),
        ("row0", [f.row0 for f in fits], "pix", "PSF centre at end 0"),
        ("col0", [f.col0 for f in fits], "pix", "PSF centre at end 0"),
        ("row1", [f.row1 for f in fits], "pix", "PSF centre at end 1"),
        ("col1", [f.col1 for f in fits], "pix", "PSF centre at end 1"),
        ("row_mid", [s.row_mid for s in streaks], "pix", "middle of the trail"),
        ("col_mid", [s.col_mid for s in streaks], "pix", "middle of the trail"),
        ("length_px", [f.length_px for f in fits], "pix", "chord"),
        ("angle_deg", [f.angle_deg for f in fits], "deg", "atan2(drow, dcol) mod 180 of the chord"),
        ("flux_e", [f.flux_e for f in fits], "electron", "flux inside the frame"),
        ("flux_err_e", [f.flux_err_e for f in fits], "electron", "its error"),
        ("flash_e", [f.flash_e for f in fits], "electron", "part of the flux that came in short flashes, as of a glint"),
        (
            "density_e_px",
            density[:, 0],
            "electron / pix",
            "flux over length, NaN for points: brightness over speed, of any shutter",
        ),
        ("density_err_e_px", density[:, 1], "electron / pix", "flux_err_e over length"),
        ("snr", [f.snr for f in fits], None, "matched-filter S/N, noise without the object"),
        ("ra_mid_deg", ra[:, 1], "deg", "published right ascension of the middle"),
        ("dec_mid_deg", dec[:, 1], "deg", "published declination of the middle"),
        ("ra0_deg", ra[:, 0], "deg", "published right ascension of end 0"),
        ("dec0_deg", dec[:, 0], "deg", "published declination of end 0"),
        ("ra1_deg", ra[:, 2], "deg", "published right ascension of end 1"),
        ("dec1_deg", dec[:, 2], "deg", "published declination of end 1"),
        ("sigma_along_arcsec", [s.sigma_along_arcsec for s in streaks], "arcsec", "error of the middle along the trail"),
        ("sigma_cross_arcsec", [s.sigma_cross_arcsec for s in streaks], "arcsec", "error of the middle across the trail"),
        ("sigma_cross_px", [f.sigma_cross_px for f in fits], "pix", "error of the middle across the trail, fit alone"),
    ]
    names = ("row0", "col0", "row1", "col1")
    lists += [
        (f"cov_{names[i]}_{names[j]}", covariance[:, i, j], "pix2", "covariance of the ends")
        for i in range(4)
        for j in range(i, 4)
    ]
    lists += [
        ("end0_low_px", interval[:, 0, 0], "pix", "68 % interval of end 0 along the trail, outwards positive"),
        ("end0_high_px", interval[:, 0, 1], "pix", "68 % interval of end 0"),
        ("end1_low_px", interval[:, 1, 0], "pix", "68 % interval of end 1 along the trail, outwards positive"),
        ("end1_high_px", interval[:, 1, 1], "pix", "68 % interval of end 1"),
        ("light0_low_px", light[:, 0, 0], "pix", "68 % interval of the light's end at end 0, outwards positive"),
        ("light0_high_px", light[:, 0, 1], "pix", "68 % interval of the light's end at end 0"),
        ("light1_low_px", light[:, 1, 0], "pix", "68 % interval of the light's end at end 1, outwards positive"),
        ("light1_high_px", light[:, 1, 1], "pix", "68 % interval of the light's end at end 1"),
        ("t_mid_utc", texts(utc_text(t[1])), None, "epoch of the middle"),
        ("t0_tai_ns", t[0], "ns", "epoch of end 0 (mid-exposure of its row until the direction is known)"),
        ("t_mid_tai_ns", t[1], "ns", "epoch of the middle"),
        ("t1_tai_ns", t[2], "ns", "epoch of end 1 (mid-exposure of its row until the direction is known)"),
        ("mag", [s.mag for s in streaks], "mag", "Johnson V for a solar colour"),
        ("mag_err", [s.mag_err for s in streaks], "mag", "its error"),
        ("mag_at_1deg_s", [s.mag_at_1deg_s for s in streaks], "mag", "of trails cut by an edge: mag if they move by 1 deg/s"),
        ("mag_at_1deg_s_err", [s.mag_at_1deg_s_err for s in streaks], "mag", "its error"),
        ("sagitta_px", [f.sagitta_px for f in fits], "pix", "height of the arc over its chord, signed; 0 when straight"),
        ("gradient", [f.gradient for f in fits], None, "relative brightness change from end 0 to end 1"),
        ("width_px", [f.width_px for f in fits], "pix", "fitted PSF sigma"),
        ("width_err_px", [f.width_err_px for f in fits], "pix", "its error"),
        ("chi2_nu", [f.chi2_nu for f in fits], None, "chi-square of the fit by degrees of freedom"),
        ("period_fraction", [or_nan(f.period_fraction) for f in fits], None, "period of the light curve by the trail's length"),
        ("probability", [s.probability for s in streaks], None, "that it is a real object, from this frame alone"),
        ("tracklet_id", [s.tracklet_id for s in streaks], None, "-1 while unlinked"),
        ("flags", [int(s.flags) for s in streaks], None, "StreakFlag bits"),
    ]
    table = table_of(lists, "streaks")
    table.meta["directions"] = directions
    table.meta["crossings"] = CROSSINGS
    return table
