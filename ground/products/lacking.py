"""What the products of a run lack and why, in sentences for `ingest.json`."""

from collections.abc import Sequence
from typing import Final

from ground.records import GroundProducts
from sboc_e2e.icd.flags import StreakFlag

_NAMED: Final = 20
"""Tracklets that a sentence names; the tables have all of them."""


def lacking(products: GroundProducts, *, orbits_wanted: bool) -> list[str]:
    """One sentence for each thing that is missing or partial; none when everything is there."""
    headers, tracklets = products.headers, products.tracklets
    n = len(headers)
    if n == 0:
        return ["no frame could be built: tables have no rows, no message is written"]
    sentences = []
    unplaced = sum(h.observer is None for h in headers)
    if unplaced == n:
        sentences.append(
            "no frame has a state of the observer (GPS): observer.oem is not written, no orbit is determined, and "
            "the aberration of the observer's velocity is not removed from directions"
        )
    elif unplaced:
        sentences.append(
            f"{unplaced} of {n} frames have no state of the observer (NO_OBSERVER): the aberration of its velocity is not "
            "removed from directions in them"
        )
    unpointed = sum(h.attitude is None for h in headers)
    if unpointed:
        sentences.append(
            f"{unpointed} of {n} frames have no telemetered attitude (NO_ATTITUDE): their pointing is from stars alone"
        )
    if n == 1:
        sentences.append("one frame only: streaks cannot be linked over frames")
    if not tracklets:
        sentences.append("no tracklet: tracklets.tdm has no segment, orbits.ecsv and orbit_samples.ecsv have no rows")
    dark = [t.tracklet_id for t in tracklets if t.flags & StreakFlag.NO_SKY]
    if dark:
        sentences.append(
            f"no segment in tracklets.tdm and no orbit, since a frame was not solved (NO_SKY): tracklets {_few(dark)}"
        )
    turned = [t.tracklet_id for t in tracklets if not t.flags & StreakFlag.NO_SKY and not t.direction_resolved]
    if turned and orbits_wanted:
        sentences.append(f"no orbit, since the sense of motion is unknown: tracklets {_few(turned)}")
    alone = [t.tracklet_id for t in tracklets if len(set(t.frames.tolist())) == 1]
    if alone:
        sentences.append(f"seen in one frame only: tracklets {_few(alone)}")
    if not orbits_wanted:
        sentences.append("orbits were not asked for (ground.orbits = false)")
    reasons: dict[str, list[int]] = {}
    for orbit in products.orbits:
        if orbit.state is None:
            reasons.setdefault(orbit.lacks or "the orbit step gives none", []).append(orbit.tracklet_id)
    sentences += [f"no orbit state, {reason}: tracklets {_few(ids)}" for reason, ids in sorted(reasons.items())]
    shapeless = [o.tracklet_id for o in products.orbits if o.state is not None and not o.state.gaussian]
    if shapeless:
        sentences.append(f"no covariance in the OPM, the posterior is not Gaussian, samples only: tracklets {_few(shapeless)}")
    return sentences


def _few(numbers: Sequence[int]) -> str:
    """The first numbers, and how many there are in all where that is not all."""
    listed = ", ".join(str(number) for number in numbers[:_NAMED])
    return listed if len(numbers) <= _NAMED else f"{listed}, ... ({len(numbers)} in all)"
