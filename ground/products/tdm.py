"""CCSDS Tracking Data Message 2.0 (503.0-B-2), KVN: one segment for each tracklet.

Errors of single directions have no field there; they are in the table beside the message (`tdm_angles`).
"""

from collections.abc import Sequence, Set
from typing import Final

import numpy as np

from ground.options import ProductOptions
from ground.products.epochs import utc_text
from ground.products.kvn_comments import comment_lines
from ground.sky.eme2000 import eme2000_angles_deg
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

VALIDATED_FROM = 0.9
"""Probability of a tracklet from which its data count as validated; below they are marked degraded."""

EPOCHS: Final = (
    "photon reception times at the row of the measured point, by the on-board clock: an end of a trail is dated when the shutter "
    "of its own row opened or closed on the object, a point at mid-exposure of its row"
)
CORRECTIONS_KEPT: Final = "annual aberration NOT removed, light time NOT removed"


def tdm_text(
    tracklets: Sequence[Tracklet],
    members: Sequence[Sequence[StreakMeasurement]],
    headers: Sequence[FrameHeader],
    names: ProductOptions,
    *,
    oem_name: str | None,
) -> str:
    """The message. Tracklets without a dated sky position are left out, and named; an empty message has no segment.

    members : the streaks of each tracklet, which have its magnitudes. headers : at least one.
    oem_name : file with the observer's states, None when there are none. CREATION_DATE is the epoch of the last frame,
    so that the same data give the same bytes.
    """
    created = utc_text([max(h.t_start_tai_ns for h in headers)], 3)[0]
    lines = [
        "CCSDS_TDM_VERS = 2.0",
        "COMMENT Angles of space-based optical tracklets; what was corrected is stated in each segment",
        *_lacking(tracklets, headers, names),
        f"CREATION_DATE = {created}",
        f"ORIGINATOR = {names.originator}",
        "",
    ]
    unseen = lacking_observer(headers)
    for tracklet, streaks in zip(tracklets, members, strict=True):
        if has_directions(tracklet):
            lines += _segment(tracklet, streaks, names, oem_name, unseen)
    return "\n".join(lines) + "\n"


def has_directions(tracklet: Tracklet) -> bool:
    """Whether the message has a segment of it."""
    return not tracklet.flags & StreakFlag.NO_SKY and len(tracklet.t_tai_ns) > 0


def lacking_observer(headers: Sequence[FrameHeader]) -> frozenset[int]:
    """Frames without the observer's state."""
    return frozenset(header.frame for header in headers if header.observer is None)


def track_id(names: ProductOptions, tracklet_id: int) -> str:
    """Name of a tracklet in messages."""
    return f"{names.originator}-T{tracklet_id:06d}"


def _lacking(tracklets: Sequence[Tracklet], headers: Sequence[FrameHeader], names: ProductOptions) -> list[str]:
    """Comments on what the message does not hold, and why."""
    lines = []
    if not tracklets:
        frames = (
            "1 frame, in which nothing can be seen to move from one to the next"
            if len(headers) == 1
            else f"{len(headers)} frames"
        )
        lines += comment_lines(f"No segment: no tracklet in {frames}")
    for why, left_out in (
        ("attitude unknown, so that they have no sky positions", [t for t in tracklets if t.flags & StreakFlag.NO_SKY]),
        (
            "no end was dated by the shutter (all on the frame's edge, or pieces of trails)",
            [t for t in tracklets if not t.flags & StreakFlag.NO_SKY and not has_directions(t)],
        ),
    ):
        if left_out:
            lines += comment_lines(f"Left out, {why}: {' '.join(track_id(names, t.tracklet_id) for t in left_out)}")
    return lines


def _dated(streak: StreakMeasurement) -> bool:
    """Whether the middle of the trail has an epoch: what an edge cuts has one only once its other end is dated."""
    cut = bool(streak.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1))
    return not cut or bool(streak.flags & (StreakFlag.DIRECTION_RESOLVED | StreakFlag.POINT_LIKE))


def _segment(
    tracklet: Tracklet,
    members: Sequence[StreakMeasurement],
    names: ProductOptions,
    oem_name: str | None,
    unknown_in: Set[int],
) -> list[str]:
    """Metadata and data lines of one tracklet, without blank lines (readers differ on them).

    unknown_in : frames without the observer's state.
    """
    order = np.argsort(tracklet.t_tai_ns, kind="stable")
    t_ns = tracklet.t_tai_ns[order]
    ra, dec = eme2000_angles_deg(tracklet.ra_deg[order], tracklet.dec_deg[order])
    bright = sorted((int(s.t_tai_ns[1]), s.mag) for s in members if np.isfinite(s.mag) and _dated(s))
    epochs = utc_text(t_ns)
    mag_epochs = utc_text([t for t, _ in bright])
    frames = sorted({int(frame) for frame in tracklet.frames})
    unseen = [frame for frame in frames if frame in unknown_in]
    removed = "aberration of the observer's geocentric velocity removed"
    if unseen:
        where = "" if len(unseen) == len(frames) else f" in frames {' '.join(map(str, unseen))}"
        removed = (
            f"observer state unknown{where}: aberration of the observer's geocentric velocity NOT removed{where and ' there'}"
        )
    first, last = min([*epochs, *mag_epochs]), max([*epochs, *mag_epochs])
    along, cross = tracklet.sigma_along_arcsec[order], tracklet.sigma_cross_arcsec[order]
    lines = [
        "META_START",
        *comment_lines(
            f"Directions: EME2000 axes (GCRS turned by the IAU 2006 frame bias), observer-centred; {removed}, {CORRECTIONS_KEPT}"
        ),
        *comment_lines(f"Epochs are {EPOCHS}; of MAG, when the object passed the middle of its trail"),
        f"COMMENT One sigma along / across the motion, median: {np.median(along):.3f} / {np.median(cross):.3f} arcsec; "
        "of each direction, with correlations: tdm_angles.ecsv"
        if np.isfinite(along).any()
        else "COMMENT Errors along and across are unknown: too few directions show no motion",
        *([] if tracklet.direction_resolved else ["COMMENT Sense of motion unknown: directions are of middles, not of ends"]),
        *([] if oem_name and not unseen else ["COMMENT No ephemeris of the observer covers all of these frames"]),
        "COMMENT MAG is Johnson V for an object of solar colour, mean over the exposure",
        f"COMMENT Probability that the tracklet is one real object: {tracklet.probability:.6f}",
        f"TRACK_ID = {track_id(names, tracklet.tracklet_id)}",
        "DATA_TYPES = ANGLE_1,ANGLE_2" + (",MAG" if bright else ""),
        "TIME_SYSTEM = UTC",
        f"START_TIME = {first}",
        f"STOP_TIME = {last}",
        f"PARTICIPANT_1 = {names.observer_name}",
        f"PARTICIPANT_2 = UCT-{tracklet.tracklet_id:06d}",
        "MODE = SEQUENTIAL",
        "PATH = 2,1",
        *([f"EPHEMERIS_NAME_1 = {oem_name}"] if oem_name and not unseen else []),
        "TIMETAG_REF = RECEIVE",
        "ANGLE_TYPE = RADEC",
        "REFERENCE_FRAME = EME2000",
        f"DATA_QUALITY = {'VALIDATED' if tracklet.probability >= VALIDATED_FROM else 'DEGRADED'}",
        "META_STOP",
        "DATA_START",
    ]
    for epoch, ra_deg, dec_deg in zip(epochs, ra, dec, strict=True):
        lines += [f"ANGLE_1 = {epoch} {ra_deg:.10f}", f"ANGLE_2 = {epoch} {dec_deg:.10f}"]
    lines += [f"MAG = {epoch} {mag:.3f}" for epoch, (_, mag) in zip(mag_epochs, bright, strict=True)]
    return [*lines, "DATA_STOP"]
