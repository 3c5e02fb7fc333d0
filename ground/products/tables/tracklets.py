"""One row for each tracklet, see `tracklets_table`."""

import numpy as np
from astropy.table import Table

from ground.products.epochs import utc_text
from ground.products.light_curve import light_curve
from ground.products.tables.columns import directions_of, table_of, texts
from ground.records import GroundProducts


def tracklets_table(products: GroundProducts) -> Table:
    """One row for each tracklet: motion at its reference epoch."""
    tracklets = products.tracklets
    curves = [light_curve(members) for members in products.members]
    table = table_of(
        [
            ("tracklet_id", [t.tracklet_id for t in tracklets], None, "number of the tracklet"),
            ("n_frames", [len(np.unique(t.frames)) for t in tracklets], None, "frames it was seen in"),
            ("first_frame", [int(t.frames.min()) for t in tracklets], None, "first frame"),
            ("last_frame", [int(t.frames.max()) for t in tracklets], None, "last frame"),
            (
                "streak_ids",
                texts([" ".join(str(i) for i in t.streak_ids) for t in tracklets]),
                None,
                "streaks used, in time order",
            ),
            ("t_ref_utc", texts(utc_text([t.t_ref_tai_ns for t in tracklets])), None, "reference epoch"),
            ("t_ref_tai_ns", [t.t_ref_tai_ns for t in tracklets], "ns", "reference epoch"),
            ("ra_ref_deg", [t.ra_ref_deg for t in tracklets], "deg", "published right ascension at the reference epoch"),
            ("dec_ref_deg", [t.dec_ref_deg for t in tracklets], "deg", "published declination at the reference epoch"),
            ("rate_deg_s", [t.rate_deg_s for t in tracklets], "deg / s", "rate of the published direction"),
            ("rate_err_deg_s", [t.rate_err_deg_s for t in tracklets], "deg / s", "its error"),
            ("position_angle_deg", [t.position_angle_deg for t in tracklets], "deg", "of the motion, from north by east"),
            ("mag", [t.mag for t in tracklets], "mag", "Johnson V of the object's mean light over its light curve, solar colour"),
            ("mag_err", [t.mag_err for t in tracklets], "mag", "half of its 68 % interval: noise and what the light curve hides"),
            ("mag_low", [t.mag_low for t in tracklets], "mag", "5 % point, the bright one"),
            ("mag_high", [t.mag_high for t in tracklets], "mag", "95 % point"),
            (
                "mag_scatter",
                [t.mag_scatter for t in tracklets],
                "mag",
                "rms of the object's light about its mean, 1.0857 x relative light; of a sinusoid, amplitude / 1.414",
            ),
            ("mag_scatter_err", [t.mag_scatter_err for t in tracklets], "mag", "its error"),
            ("mag_chi2_nu", [t.mag_chi2_nu for t in tracklets], None, "of constant light, NaN with one magnitude"),
            ("period_s", [c.period_s for c in curves], "s", "period of the brightness from frame to frame, NaN without one"),
            (
                "period_false_alarm",
                [c.false_alarm for c in curves],
                None,
                "probability of as high a peak of the periodogram without a period, NaN when not tried",
            ),
            ("chi2_nu", [t.chi2_nu for t in tracklets], None, "of the motion model"),
            ("probability", [t.probability for t in tracklets], None, "that all of it is one real object"),
            (
                "direction_resolved",
                np.array([t.direction_resolved for t in tracklets], dtype=bool),
                None,
                "sense of motion known",
            ),
            ("flags", [int(t.flags) for t in tracklets], None, "StreakFlag bits"),
        ],
        "tracklets",
    )
    table.meta["directions"] = directions_of(products.headers)
    return table
