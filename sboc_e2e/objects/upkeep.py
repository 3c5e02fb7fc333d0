"""Published tracklets into the store, and the store brought up to a night."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.sensor_bias.correct import corrected, nearest, read_calibration, widened
from ground.sensor_bias.estimate import Place, SensorBias, Track
from ground.sky.sphere import ARCSEC_RAD
from ground.store import schema
from ground.store.store import ObjectStore, StoredTracklet
from ground.upkeep.night import update
from ground.upkeep.view import UpkeepOptions
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.conjunctions import epoch_of
from sboc_e2e.objects.direction_errors import ERRORS_NAME, errors_of
from sboc_e2e.objects.places import known_place
from sboc_e2e.objects.texts import text_of
from sboc_e2e.score.published.tdm_reader import TdmSegment, read_tdm

Array = NDArray[np.float64]


SIGMA_ARCSEC: Final = 1.0
"""Of directions that nothing is stated of."""


@dataclass(frozen=True, kw_only=True)
class Correction:
    """A calibration's sessions, and whether the sensor's own states carry the clock of its tags (a space telescope)."""

    sessions: tuple[SensorBias, ...]
    shares_clock: bool

    @classmethod
    def of(cls, path: Path, *, shares_clock: bool) -> "Correction":
        """Of the file that `sboc calibrate` wrote. UserError for another, and for one without sessions."""
        sessions = read_calibration(text_of(path), path.name)
        if not sessions:
            raise UserError(f"{path.name}: a calibration without sessions")
        return cls(sessions=sessions, shares_clock=shares_clock)


def observe(
    url: str,
    messages: Sequence[Path],
    place: Place,
    sensor: str,
    sigma_arcsec: float | None,
    correction: Correction | None = None,
) -> str:
    """Put the tracklets of messages into a store; one that is there already stays as it is, with another calibration too.

    sigma_arcsec : one sigma along each axis; None: of the table of errors beside a message, 1 arcsec where there is none.
    correction : takes the nearest session's time and pointing bias off each tracklet, and adds its own errors.
    """
    if sigma_arcsec is not None and not 0.0 < sigma_arcsec < 3600.0:
        raise UserError(f"--sigma: expected arcsec above 0 and below 3600, got {sigma_arcsec:g}")
    tracklets = []
    for path in messages:
        if not path.is_file():
            raise UserError(f"{path}: no such file")
        stated = errors_of(path.with_name(ERRORS_NAME)) if sigma_arcsec is None else {}
        for segment in read_tdm(path):
            n = len(segment.angle_tai_ns)
            if n:
                errors = stated.get(segment.tracklet_id)
                if errors is None or len(errors) != n:
                    errors = np.tile([sigma_arcsec or SIGMA_ARCSEC, sigma_arcsec or SIGMA_ARCSEC, 0.0], (n, 1))
                tracklets.append(_stored(segment, errors, place, sensor, path, correction))
    store = ObjectStore(url)
    before = store.counts()["tracklets"]
    with store.transaction() as writer:
        writer.add_tracklets(tracklets)
    after = store.counts()["tracklets"]
    store.close()
    return f"{len(tracklets)} tracklets read, {after - before} of them new, {after} in the store"


def _stored(
    segment: TdmSegment, errors: Array, place: Place, sensor: str, path: Path, correction: Correction | None
) -> StoredTracklet:
    """Directions in order of time. errors : (n, 3) sigma along, across (arcsec), angle of the motion (rad)."""
    order = np.argsort(segment.angle_tai_ns, kind="stable")
    seen = Track(t_tai_ns=segment.angle_tai_ns[order], direction=segment.direction[order])
    observer = known_place(place, seen.t_tai_ns, path)
    if correction is not None:
        bias = nearest(correction.sessions, int(seen.t_tai_ns[0]))
        errors = widened(errors, seen, bias)
        seen = corrected(seen, bias)
        if not correction.shares_clock:
            observer = known_place(place, seen.t_tai_ns, path)
    rows = np.hstack([seen.direction, errors[:, :2] * ARCSEC_RAD, errors[:, 2:], observer])
    return StoredTracklet(sensor=sensor, t_tai_ns=seen.t_tai_ns, rows=rows, uid=uid_of(segment, sensor))


def uid_of(segment: TdmSegment, sensor: str) -> str:
    """What tells a segment's tracklet from others: its sensor, epochs and directions as published, without any calibration."""
    order = np.argsort(segment.angle_tai_ns, kind="stable")
    return schema.uid_of(sensor, segment.angle_tai_ns[order], segment.direction[order])


def bring_up(url: str, at_utc: str, window_days: float, workers: int) -> str:
    """A night's update; what it did, in a line, and a line for each object whose orbit cannot be propagated to the night."""
    if "://" not in url and not Path(url).is_file():
        raise UserError(f"{url}: no such store")
    if not 0.0 < window_days <= 30.0:
        raise UserError(f"--window: expected more than 0 and at most 30 days, got {window_days:g}")
    store = ObjectStore(url)
    report = update(store, epoch_of(at_utc), UpkeepOptions(window_days=window_days, workers=workers))
    store.close()
    numbers = asdict(report)
    not_carried = numbers.pop("not_carried")
    first = ", ".join(f"{name} {number}" for name, number in numbers.items())
    return "\n".join([first, *(f"cannot be propagated: {line}" for line in not_carried)])
