"""CCSDS Tracking Data Message 2.0 (503.0-B-2), KVN: one segment for each tracklet."""

from collections.abc import Sequence

import numpy as np

from ground.options import ProductOptions
from ground.products.epochs import utc_text
from ground.sky.eme2000 import eme2000_angles_deg
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet

VALIDATED_FROM = 0.9
"""Probability of a tracklet from which its data count as validated; below they are marked degraded."""


def tdm_text(
    tracklets: Sequence[Tracklet],
    members: Sequence[Sequence[StreakMeasurement]],
    headers: Sequence[FrameHeader],
    names: ProductOptions,
    *,
    oem_name: str | None,
) -> str:
    """The message. Tracklets without sky positions are left out; an empty message has no segment.

    members : the streaks of each tracklet, which have its magnitudes. headers : at least one.
    oem_name : file with the observer's states, None when there are none. CREATION_DATE is the epoch of the last frame,
    so that the same data give the same bytes.
    """
    created = utc_text([max(h.t_start_tai_ns for h in headers)], 3)[0]
    lines = [
        "CCSDS_TDM_VERS = 2.0",
        "COMMENT Angles of space-based optical tracklets; what was corrected is stated in each segment",
        f"CREATION_DATE = {created}",
        f"ORIGINATOR = {names.originator}",
        "",
    ]
    observed = {header.frame: header.observer is not None for header in headers}
    for tracklet, streaks in zip(tracklets, members, strict=True):
        if tracklet.flags & StreakFlag.NO_SKY or len(tracklet.t_tai_ns) == 0:
            continue
        observer_known = all(observed.get(int(frame), False) for frame in tracklet.frames)
        lines += _segment(tracklet, streaks, names, oem_name if observer_known else None, observer_known)
    return "\n".join(lines) + "\n"


def _segment(
    tracklet: Tracklet, members: Sequence[StreakMeasurement], names: ProductOptions, oem_name: str | None, observer_known: bool
) -> list[str]:
    """Metadata and data lines of one tracklet, without blank lines (readers differ on them)."""
    order = np.argsort(tracklet.t_tai_ns, kind="stable")
    t_ns = tracklet.t_tai_ns[order]
    ra, dec = eme2000_angles_deg(tracklet.ra_deg[order], tracklet.dec_deg[order])
    bright = sorted((int(s.t_tai_ns[1]), s.mag) for s in members if np.isfinite(s.mag))
    epochs = utc_text(t_ns)
    mag_epochs = utc_text([t for t, _ in bright])
    removed = (
        "aberration of the observer's geocentric velocity removed"
        if observer_known
        else "observer state unknown: aberration of the observer's geocentric velocity NOT removed"
    )
    first, last = min([*epochs, *mag_epochs]), max([*epochs, *mag_epochs])
    along, cross = tracklet.sigma_along_arcsec[order], tracklet.sigma_cross_arcsec[order]
    lines = [
        "META_START",
        f"COMMENT Directions: EME2000 axes (GCRS turned by the IAU 2006 frame bias), observer-centred; {removed}, "
        "annual aberration NOT removed, light time NOT removed",
        "COMMENT Epochs are photon reception times at the row of the measured point (rolling shutter corrected)",
        f"COMMENT One sigma along / across the motion, median: {np.median(along):.3f} / {np.median(cross):.3f} arcsec",
        "COMMENT MAG is Johnson V for an object of solar colour, mean over the exposure",
        f"COMMENT Probability that the tracklet is one real object: {tracklet.probability:.6f}",
        f"TRACK_ID = {names.originator}-T{tracklet.tracklet_id:06d}",
        "DATA_TYPES = ANGLE_1,ANGLE_2" + (",MAG" if bright else ""),
        "TIME_SYSTEM = UTC",
        f"START_TIME = {first}",
        f"STOP_TIME = {last}",
        f"PARTICIPANT_1 = {names.observer_name}",
        f"PARTICIPANT_2 = UCT-{tracklet.tracklet_id:06d}",
        "MODE = SEQUENTIAL",
        "PATH = 2,1",
        *([f"EPHEMERIS_NAME_1 = {oem_name}"] if oem_name else []),
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
