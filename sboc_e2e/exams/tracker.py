"""What a tracker finds within the on-board chain of objects that single frames hardly show, and what it reports of nothing.

Frames of stars that stand still, with straight tracks through four of them. The chain runs as on board with the tracker in its
place; what counts are the members of the tracks that it reports.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain, OnboardState
from sboc_e2e.exams.detector import NOISE_E, SHAPE, chain_with, frame_of, star_light
from sboc_e2e.exams.trails import trail
from sboc_e2e.exams.verdict import Verdict, asked, expect
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.signals import Track
from sboc_e2e.score.matching import TruthStreak

SNRS: Final = (4.5, 5.5, 6.5)
"""In each of its frames; the default detector's threshold is 7.2."""

LENGTH_PX: Final = 24.0
"""Of a trail in one exposure. Chosen: four frames of its way (114 px in all) fit into the 320 px of the frame."""
STEP_PX: Final = 30.0
"""Way from frame to frame: 0.25 s of a motion whose exposure of 0.2 s leaves LENGTH_PX."""

MEMBERS: Final = 4  # Frames in which an object is seen: its joint S/N is twice that of one frame. Chosen.
LEAD: Final = 3
"""Frames of stars alone before the first track: trackers and backgrounds that look back have something to look at."""
CUBES: Final = 3  # Stacks of frames: three tracks of each S/N, which tells a working tracker from a broken one and no more.
NEAR_PX: Final = 4.0  # Chosen, not measured: with a quarter of the length added, a member is off by less than half its length.


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueTrack:
    """Middles (MEMBERS, 2) of an object's trails, the first in frame `first`; its angle (rad) and S/N in each frame."""

    first: int
    middles: NDArray[np.float64]
    angle: float
    snr: float


def questions(step: Any) -> Iterator[Verdict]:
    """The questions that a tracker is asked."""
    yield asked("says how many frames it looks at", lambda: expect(int(step.window_frames) >= 0, "expected 0 or more frames"))
    yield asked("its state can be kept between frames", lambda: checkpoint.to_bytes(step.initial_state()) and None)
    if step.window_frames == 0:
        yield asked("tracks nothing and says so", lambda: expect(not _run(step, _truth(0), 0)[0], "reported tracks"))
        return
    names = " ".join(f"{snr:g}" for snr in SNRS)
    yield asked(f"finds tracks of S/N {names} in each of {MEMBERS} frames", lambda: _score(step))
    yield asked("the same frames twice give the same tracks", lambda: _same_twice(step))
    yield asked("links nothing across a gap", lambda: _across_a_gap(step))


def _truth(cube: int) -> list[TrueTrack]:
    """A track of each S/N, in lanes of their own, at other angles in each cube."""
    rng = np.random.default_rng([53, cube])
    made = []
    for k, snr in enumerate(SNRS):
        angle = float(rng.uniform(-0.2, 0.2)) + (math.pi if rng.random() < 0.5 else 0.0)
        middle = np.array([SHAPE[0] * (k + 0.5) / len(SNRS), SHAPE[1] / 2.0]) + rng.uniform(-10.0, 10.0, 2)
        way = STEP_PX * np.array([math.sin(angle), math.cos(angle)])
        steps = np.arange(MEMBERS)[:, None] - 0.5 * (MEMBERS - 1)
        made.append(TrueTrack(first=LEAD + k, middles=middle + steps * way, angle=angle, snr=snr))
    return made


def _run(step: Any, truth: Sequence[TrueTrack], cube: int, gap: int | None = None) -> tuple[list[Track], OnboardState]:
    """Tracks of one cube. gap : frame from which on all are numbered, and dated, one later."""
    chain: OnboardChain = chain_with(tracker=step)
    state, stars = chain.initial_state(), star_light()
    found: list[Track] = []
    for number in range(LEAD + MEMBERS + len(SNRS) + int(step.window_frames) // 2 + 1):
        rng = np.random.default_rng([59, cube, number])
        mine = [t for t in truth if 0 <= number - t.first < MEMBERS]
        trails = [
            trail(tuple(t.middles[number - t.first]), LENGTH_PX, math.degrees(t.angle), t.snr, SHAPE, NOISE_E) for t in mine
        ]
        drawn = [
            TruthStreak(
                index=k, frame=number, object_id=k, path=each.path, snr=each.snr, length_px=LENGTH_PX, rate_deg_s=1.0,
                attainable_end_px=0.0,
            )
            for k, each in enumerate(trails)
        ]  # fmt: skip
        frame = frame_of(number, stars, drawn, rng)
        if gap is not None and number >= gap:
            late = replace(frame.header, frame=number + 1, t_start_tai_ns=frame.header.t_start_tai_ns + 250_000_000)
            frame = replace(frame, header=late)
        state, result = chain.process(state, frame)
        found += result.tracks
    return [*found, *chain.finish(state).tracks], state


def _hit(found: Track, truth: TrueTrack) -> bool:
    """Whether at least half of a track's members lie on a true one, run through in its sense."""
    good = 0
    for member in found.members:
        d, k = member.detection, member.frame - truth.first
        if 0 <= k < MEMBERS:
            off = np.array([d.row0 + d.row1, d.col0 + d.col1]) / 2.0 - truth.middles[k]
            forward = (d.row1 - d.row0) * math.sin(truth.angle) + (d.col1 - d.col0) * math.cos(truth.angle) > 0.0
            good += forward and float(np.hypot(*off)) < NEAR_PX + 0.25 * LENGTH_PX
    return 2 * good >= len(found.members)


def _score(step: Any) -> str:
    """How many of each S/N are found, and how many false tracks, in words. Raises `Failed` when none is found."""
    hits, false = dict.fromkeys(SNRS, 0), 0
    for cube in range(CUBES):
        truth = _truth(cube)
        found, state = _run(step, truth, cube)
        checkpoint.to_bytes(state)
        for t in truth:
            hits[t.snr] += any(_hit(each, t) for each in found)
        false += len({each.number for each in found if not any(_hit(each, t) for t in truth)})
    expect(sum(hits.values()) > 0, f"found none of {CUBES * len(SNRS)} tracks")
    return ", ".join(f"{n} of {CUBES} at {snr:g}" for snr, n in hits.items()) + f"; {false} false in {CUBES} cubes"


def _same_twice(step: Any) -> None:
    first, second = (checkpoint.to_bytes(_run(step, _truth(0), 0)[0]) for _ in range(2))
    expect(first == second, "two runs gave different tracks")


def _across_a_gap(step: Any) -> None:
    gap = LEAD + 2
    found, _ = _run(step, _truth(0), 0, gap=gap)
    both = [t.number for t in found if t.members[0].frame < gap < t.members[-1].frame]
    expect(not both, f"track {both[:1]} has members on both sides of a gap")
