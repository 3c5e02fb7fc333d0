"""Companion table of a tracking message: errors and origin of each direction, for which the message has no fields.

The rows are the angles of the message, in its order, with its epochs. Errors of two rows i and j of one tracklet:
along the motion ``shared[i] @ shared[j]`` where both are of one `shared_group`, of middles also across;
across ``shared_cross[i] @ shared_cross[j]``, whatever their group; along as well as across ``pointing[i] pointing[j]`` where
both are of one frame, across also ``turning[i] turning[j]``; all else is each row's own.

Sigmas are standard deviations; 1.96 of them hold 95 %. Errors of faint ends have heavy tails: their 68 % interval is narrower.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from astropy.table import Column, Table
from numpy.typing import NDArray

from ground.options import ProductOptions
from ground.products.epochs import utc_text
from ground.products.tdm import CORRECTIONS_KEPT, EPOCHS, has_directions, lacking_observer, track_id
from ground.sky.eme2000 import eme2000_angles_deg
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet
from sboc_e2e.icd.version import CONTRACT_VERSION

TDM_ANGLES_NAME: Final = "tdm_angles.ecsv"
POINTS: Final = ("end 0", "middle", "end 1")
EPOCHS_OF: Final = ("shutter open", "mid-exposure", "shutter close")


def tdm_angles_table(
    tracklets: Sequence[Tracklet],
    members: Sequence[Sequence[StreakMeasurement]],
    headers: Sequence[FrameHeader],
    names: ProductOptions,
    *,
    oem_name: str | None,
) -> Table:
    """One row for each direction of the tracking message. members : the streaks of each tracklet; the rest as for the message."""
    unseen = lacking_observer(headers)
    told = [(t, s) for t, s in zip(tracklets, members, strict=True) if has_directions(t)]
    streaks = [_by_row(tracklet, own) for tracklet, own in told]
    rows = [streak for part in streaks for streak in part]
    t_ns = np.concatenate([np.zeros(0, dtype=np.int64), *(t.t_tai_ns for t, _ in told)])
    number = np.concatenate([np.zeros(0, dtype=np.int64), *(np.full(len(t.t_tai_ns), t.tracklet_id) for t, _ in told)])
    column = {
        name: np.concatenate([np.zeros(0), *(_of_rows(t, name) for t, _ in told)])
        for name in ("ra_deg", "dec_deg", "sigma_along_arcsec", "sigma_cross_arcsec", "correlation", "motion_angle_deg")
    }
    half68 = np.concatenate([np.zeros(0), *(_half68(t) for t, _ in told)])
    ra, dec = eme2000_angles_deg(column["ra_deg"], column["dec_deg"])
    along, cross, correlation = column["sigma_along_arcsec"], column["sigma_cross_arcsec"], column["correlation"]
    sigma_ra, sigma_dec, ra_dec = east_north_errors(along, cross, correlation, column["motion_angle_deg"])
    shared = np.concatenate([np.zeros((0, 3)), *(_of_rows(t, "shared_arcsec") for t, _ in told)])
    line = np.concatenate([np.zeros((0, 3)), *(_of_rows(t, "shared_cross_arcsec") for t, _ in told)])
    point = np.concatenate([np.zeros(0, dtype=np.int64), *(_of_rows(t, "row_points") for t, _ in told)]).astype(np.int64)
    group = np.concatenate([np.zeros(0, dtype=np.int64), *(_of_rows(t, "shared_group") for t, _ in told)]).astype(np.int64)
    pointing = np.concatenate([np.zeros(0), *(_of_rows(t, "pointing_arcsec") for t, _ in told)])
    turning = np.concatenate([np.zeros(0), *(_of_rows(t, "turning_arcsec") for t, _ in told)])
    frame = np.array([s.frame for s in rows], dtype=np.int64)
    flags = np.array([int(s.flags | s.fit.flags) for s in rows], dtype=np.int64)
    columns = [
        ("tracklet_id", number, None, "number of the tracklet"),
        ("track_id", _text([track_id(names, int(k)) for k in number]), None, "TRACK_ID of the segment"),
        ("epoch_utc", _text(utc_text(t_ns)), None, "epoch of the row, as in the message"),
        ("epoch_tai_ns", t_ns, "ns", "the same, not rounded"),
        ("ra_deg", ra, "deg", "ANGLE_1"),
        ("dec_deg", dec, "deg", "ANGLE_2"),
        ("sigma_ra_arcsec", sigma_ra, "arcsec", "one sigma of the right ascension times cos(declination)"),
        ("sigma_dec_arcsec", sigma_dec, "arcsec", "one sigma of the declination"),
        ("correlation", ra_dec, None, "of right ascension and declination"),
        ("sigma_along_arcsec", along, "arcsec", "one sigma along the motion"),
        ("half68_along_arcsec", half68, "arcsec", "half of the 68 % interval along; heavy tails: below one sigma"),
        ("sigma_cross_arcsec", cross, "arcsec", "one sigma across the motion"),
        ("correlation_along_cross", correlation, None, "of both; across is 90 deg further in position angle"),
        ("motion_angle_deg", column["motion_angle_deg"], "deg", "position angle of the motion, from north by east"),
        ("shared_group", group, None, "rows of a tracklet fitted together; -1: none"),
        *((f"shared_{k + 1}_arcsec", shared[:, k], "arcsec", "part of the error along that the group shares") for k in range(3)),
        *((f"shared_cross_{k + 1}_arcsec", line[:, k], "arcsec", "part of the error across of one line") for k in range(3)),
        ("pointing_arcsec", pointing, "arcsec", "part of both errors that the rows of one frame share"),
        ("turning_arcsec", turning, "arcsec", "part of the error across that the frame's turning gives, with its sign"),
        ("frame", frame, None, "frame number"),
        ("streak_id", np.array([s.streak_id for s in rows], dtype=np.int64), None, "row of streaks.ecsv"),
        ("end", _text([POINTS[k] for k in point]), None, "point of the streak"),
        ("epoch_of", _text([EPOCHS_OF[k] for k in point]), None, "what dates the row: the shutter of its row"),
        ("refitted", (flags & StreakFlag.REFIT) != 0, None, "fitted together with the tracklet's other frames"),
        ("not_gaussian", (flags & StreakFlag.ENDS_NOT_GAUSSIAN) != 0, None, "a change point: tails are exponential"),
        ("observer_known", ~np.isin(frame, sorted(unseen)), None, "aberration of the observer's velocity was removed"),
    ]  # fmt: skip
    made = [Column(values, name=name, unit=unit, description=text) for name, values, unit, text in columns]
    meta = {
        "table": "tdm_angles",
        "contract_version": CONTRACT_VERSION,
        "reference_frame": "EME2000",
        "timetag_ref": "RECEIVE",
        "epochs": EPOCHS,
        "directions": f"observer-centred; {CORRECTIONS_KEPT}",
        "observer": oem_name or "unknown: no observer state came down",
        "covariance": " ".join((__doc__ or "").split("\n\n")[1].split()),
    }
    return Table(made, meta=meta)


def east_north_errors(
    along: NDArray[np.float64], cross: NDArray[np.float64], correlation: NDArray[np.float64], angle_deg: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Errors east and north and their correlation, from those along and across a motion of the given position angle."""
    s, c = np.sin(np.radians(angle_deg)), np.cos(np.radians(angle_deg))
    both = correlation * along * cross
    # along = (s, c) and across = (c, -s) east and north
    east = (s * along) ** 2 + (c * cross) ** 2 + 2.0 * s * c * both
    north = (c * along) ** 2 + (s * cross) ** 2 - 2.0 * s * c * both
    mixed = s * c * (along**2 - cross**2) + (c**2 - s**2) * both
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(east), np.sqrt(north), mixed / np.sqrt(east * north)


def _by_row(tracklet: Tracklet, members: Sequence[StreakMeasurement]) -> list[StreakMeasurement]:
    """The streak of each direction."""
    by_id = {s.streak_id: s for s in members}
    return [by_id[int(k)] for k in tracklet.row_streak_ids]


def _of_rows(tracklet: Tracklet, name: str) -> NDArray[np.float64]:
    return np.asarray(getattr(tracklet, name))


def _half68(tracklet: Tracklet) -> NDArray[np.float64]:
    """Half of each row's 68 % interval along the motion; sigma where the tracklet does not say."""
    along = _of_rows(tracklet, "sigma_along_arcsec")
    stated = tracklet.half68_along_arcsec
    return stated if len(stated) == len(along) else along


def _text(values: Sequence[str]) -> NDArray[np.str_]:
    """A text column, also when empty."""
    return np.array(list(values), dtype=str) if values else np.zeros(0, dtype="U1")
