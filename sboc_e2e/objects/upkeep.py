"""Published tracklets into the store, and the store brought up to a night."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ground.sensor_bias.estimate import Place
from ground.sky.sphere import ARCSEC_RAD
from ground.store.store import ObjectStore, StoredTracklet
from ground.upkeep.night import UpkeepOptions, update
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.conjunctions import epoch_of
from sboc_e2e.score.published.tdm_reader import read_tdm

Array = NDArray[np.float64]


def observe(url: str, messages: Sequence[Path], place: Place, sensor: str, sigma_arcsec: float) -> str:
    """Put the tracklets of messages into a store; one that is there already is not put in twice."""
    if not 0.0 < sigma_arcsec < 3600.0:
        raise UserError(f"--sigma: expected arcsec above 0 and below 3600, got {sigma_arcsec:g}")
    tracklets = []
    for path in messages:
        if not path.is_file():
            raise UserError(f"{path}: no such file")
        for segment in read_tdm(path):
            if len(segment.angle_tai_ns):
                tracklets.append(_stored(segment.angle_tai_ns, segment.direction, place, sensor, sigma_arcsec, path))
    store = ObjectStore(url)
    before = store.counts()["tracklets"]
    with store.transaction() as writer:
        writer.add_tracklets(tracklets)
    after = store.counts()["tracklets"]
    store.close()
    return f"{len(tracklets)} tracklets read, {after - before} of them new, {after} in the store"


def _stored(t: NDArray[np.int64], direction: Array, place: Place, sensor: str, sigma_arcsec: float, path: Path) -> StoredTracklet:
    """Directions with one sigma along both axes."""
    order = np.argsort(t, kind="stable")
    observer = place(t[order])
    if not np.isfinite(observer).all():
        raise UserError(f"{path}: directions at epochs for which the observer's place is not given")
    sigma = np.full((len(t), 1), sigma_arcsec * ARCSEC_RAD)
    rows = np.hstack([direction[order], sigma, sigma, np.zeros((len(t), 1)), observer])
    return StoredTracklet(sensor=sensor, t_tai_ns=t[order], rows=rows)


def bring_up(url: str, at_utc: str, window_days: float, workers: int) -> str:
    """A night's update; what it did, in a line."""
    if "://" not in url and not Path(url).is_file():
        raise UserError(f"{url}: no such store")
    if not 0.0 < window_days <= 30.0:
        raise UserError(f"--window: expected more than 0 and at most 30 days, got {window_days:g}")
    store = ObjectStore(url)
    report = update(store, epoch_of(at_utc), UpkeepOptions(window_days=window_days, workers=workers))
    store.close()
    return ", ".join(f"{name} {number}" for name, number in asdict(report).items())
