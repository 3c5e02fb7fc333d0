"""Light curves of an object of the store over its passes, from published messages and tables of trails, and what they say."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from ground.characterise.judge import Character, characterise
from ground.characterise.reduced import Pass
from ground.determination.propagation import propagate
from ground.orbit.size import sun_direction
from ground.sensor_bias.estimate import Place
from ground.sky.sphere import ARCSEC_RAD
from ground.store.forces import forces_of
from ground.store.store import ObjectStore, StoredOrbit, StoredTracklet
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.upkeep import uid_of
from sboc_e2e.score.published.tdm_reader import TdmSegment, read_tdm

Array = NDArray[np.float64]

_SAME_ARCSEC: Final = 0.1
"""Chosen, not measured: far above the rounding of messages (0.4 uas), far below the pixel of a camera."""
_TRAIL_COLUMNS: Final = ("tracklet_id", "t_tai_ns", "mag", "mag_err")


def light_of(
    url: str, name: str, messages: Sequence[Path], trails: Sequence[Path], place: Place, mag_err: float
) -> tuple[Character, list[Pass]]:
    """Character of an object and its passes.

    messages : Tracking Data Messages with MAG; those segments count that the store has accepted as the object's. trails : tables
    `light_curves.ecsv`, one for each message or none; where one has bins of a segment's tracklet, they take the place of its MAG.
    mag_err : one sigma of a MAG, which messages do not carry.
    """
    if not 0.0 < mag_err < 5.0:
        raise UserError(f"--mag-err: expected mag above 0 and below 5, got {mag_err:g}")
    if trails and len(trails) != len(messages):
        raise UserError(f"--trails: one table for each message; there are {len(trails)} for {len(messages)}")
    if "://" not in url and not Path(url).is_file():
        raise UserError(f"{url}: no such store")
    store = ObjectStore(url)
    numbers = {row["name"]: row["object_id"] for row in store.objects()}
    if name not in numbers:
        store.close()
        raise UserError(f"{url}: no object {name[:40]}; `sboc objects list` names them")
    own = list(store.tracklets_of(numbers[name]).values())
    orbits = store.orbits(numbers[name])
    store.close()
    if not orbits:
        raise UserError(f"{url}: {name} has no orbit, which range and phase need")
    passes = []
    for k, path in enumerate(messages):
        if not path.is_file():
            raise UserError(f"{path}: no such file")
        bins = _trail_bins(trails[k]) if trails else {}
        for segment in read_tdm(path):
            if any(_is_same(segment, tracklet) for tracklet in own):
                published = segment.mag_tai_ns, segment.mag, np.full(len(segment.mag), mag_err)
                t, mag, error = bins.get(segment.tracklet_id, published)
                if len(t):
                    passes.append(_pass(t, mag, error, orbits[0], place, path))
    if not passes:
        raise UserError(f"{name}: no magnitudes in the messages that belong to tracklets which the store has accepted as its own")
    return characterise(passes), passes


def _is_same(segment: TdmSegment, tracklet: StoredTracklet) -> bool:
    """Whether a segment is a stored tracklet: the same uid, or the same first epoch and direction.

    The uid holds for tracklets that a calibration has moved, the second rule for messages that give their numbers with other
    digits.
    """
    if not len(segment.angle_tai_ns):
        return False
    if uid_of(segment, tracklet.sensor) == tracklet.uid:
        return True
    first = int(np.argmin(segment.angle_tai_ns))
    same = int(segment.angle_tai_ns[first]) == int(tracklet.t_tai_ns[0])
    return same and float(np.linalg.norm(segment.direction[first] - tracklet.rows[0, :3])) < _SAME_ARCSEC * ARCSEC_RAD


def _trail_bins(path: Path) -> Mapping[int, tuple[NDArray[np.int64], Array, Array]]:
    """Epochs, magnitudes and errors of bins along trails, by tracklet."""
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    try:
        table = Table.read(path, format="ascii.ecsv")
        t, mag, error = (np.asarray(table[c]) for c in _TRAIL_COLUMNS[1:])
        owner = np.asarray(table[_TRAIL_COLUMNS[0]], dtype=np.int64)
    except (KeyError, ValueError, OSError) as problem:
        why = str(problem).splitlines()[0][:100]
        raise UserError(f"{path}: expected a table with {', '.join(_TRAIL_COLUMNS)}: {why}") from problem
    good = np.isfinite(mag) & (error > 0.0) & (t > 0) & (owner >= 0)
    chosen = {int(k): good & (owner == k) for k in np.unique(owner[good])}
    return {k: (t[which], mag[which], error[which]) for k, which in chosen.items()}


def _pass(t_tai_ns: NDArray[np.int64], mag: Array, error: Array, orbit: StoredOrbit, place: Place, path: Path) -> Pass:
    """Magnitudes with the range and phase angle that the orbit gives."""
    order = np.argsort(t_tai_ns, kind="stable")
    t = t_tai_ns[order].astype(np.int64)
    observer = place(t)
    if not np.isfinite(observer).all():
        raise UserError(f"{path}: magnitudes at epochs for which the observer's place is not given")
    unique, back = np.unique(t, return_inverse=True)
    states = propagate(orbit.state, orbit.epoch_tai_ns, unique, forces_of(orbit)).states[back]
    line = observer - states[:, :3]
    away = np.linalg.norm(line, axis=1)
    # the Sun's direction is the same from the Earth and from the object to 0.02 deg
    sun = np.array([sun_direction(int(k)) for k in t])
    phase = np.degrees(np.arccos(np.clip((line * sun).sum(axis=1) / away, -1.0, 1.0)))
    mag, error = mag[order].astype(float), error[order].astype(float)
    return Pass(t_s=(t - t[0]) * 1e-9, mag=mag, mag_err=error, range_km=away, phase_deg=phase)


def character_lines(name: str, found: Character) -> list[str]:
    """What the light says, for the screen."""
    p = found.period
    text = f"period {p.period_s:.5g} +- {p.period_err_s:.2g} s" if np.isfinite(p.period_s) else "no period"
    share = f"mirror-like share {found.phase.mirror_share:.2f}" + ("" if found.phase.fitted else " (assumed)")
    return [
        f"{name}: {found.kind}, {found.passes} passes, {found.samples} samples, {found.flashes} flashes",
        f"  {text}; false alarm {p.false_alarm:.2g} (Lomb-Scargle), {p.string_alarm:.2g} (string length)",
        f"  amplitude {p.amplitude_mag:.2f} mag peak to peak, scatter {found.scatter_mag:.2f} mag",
        f"  {found.phase.absolute_mag:.2f} mag at 1000 km and full phase, {share}",
    ]


def character_json(name: str, found: Character) -> str:
    """The same as JSON; numbers that are not known are null."""
    return json.dumps(_known({"object": name, **asdict(found)}), sort_keys=True, indent=1, allow_nan=False) + "\n"


def _known(value: Any) -> Any:
    """A tree of values with None for numbers that are not known."""
    if isinstance(value, dict):
        return {key: _known(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_known(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def draw(name: str, found: Character, passes: Sequence[Pass], out: Path) -> None:
    """Reduced magnitudes against time, and folded where there is a period."""
    from matplotlib.figure import Figure

    period = found.period.period_s
    folded = bool(np.isfinite(period))
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    axes = figure.subplots(1, 2 if folded else 1, squeeze=False)[0]
    for k, one in enumerate(passes):
        mag = one.at_standard - found.phase.at(one.phase_deg)
        for axis, x in zip(axes, (one.t_s, np.mod(one.t_s / period, 1.0)) if folded else (one.t_s,), strict=True):
            axis.errorbar(x, mag, one.mag_err, fmt=".", ms=3, lw=0.5, label=f"pass {k + 1}")
    for axis, label in zip(axes, ("time in the pass [s]", f"turn (period {period:.4g} s)"), strict=False):
        axis.set_xlabel(label)
        axis.set_ylabel("V at 1000 km and full phase [mag]")
        axis.invert_yaxis()
    axes[0].legend(fontsize=7)
    figure.suptitle(f"{name}: {found.kind}")
    figure.savefig(out, dpi=120, metadata={"Software": None})
