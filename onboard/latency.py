"""A frame without a predecessor waits for the next one and is held against it: no frame is a first frame.

Stars are told from movers by another frame of the same sky. It is the one before and, at the start of a run and after a slew,
the one after. Only such frames wait. A break in the sky costs the memory of one frame as it came and one or two preparations
more; between breaks nothing is held. Packets leave in the order of frames.
"""

from dataclasses import dataclass, replace
from typing import Final

from onboard.chain import OnboardChain
from onboard.image import registration
from onboard.image.frame_flags import checksum
from onboard.stars.memory import NOT_KEPT, EarlierStars, brought_forward, part_of
from onboard.state import OnboardResult, OnboardState, RunEnd
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.signals import StarList

REACH_PX: Final = 300.0
"""Detectors find stars again that moved no farther since the frame before."""

Results = tuple[OnboardResult, ...]


@dataclass(kw_only=True)
class FrameSequence:
    """The chain over frames as they come. state : after the newest one; a frame that waits is part of it."""

    chain: OnboardChain
    state: OnboardState

    def take(self, frame: Frame) -> Results:
        """What a frame makes known: nothing if it waits, else its result after that of a frame that waited for it."""
        held = self.state.held
        if held is None:
            return self._taken(frame)
        # Of the same frame come twice nothing is learned, so this one is looked at as the follower of the one that waits.
        before = replace(self.state, previous=held.header, pixel_check=checksum(held.pixels))
        prepared = self.chain.prepare(before, frame)
        usable, stars = prepared.usable, prepared.view.stars
        compared = usable and self.chain.may_compare(held.header, frame.header)
        neighbour = self.chain.remembered(prepared.view) if compared else None
        first = self._judged(held, neighbour)
        del before, prepared, held, neighbour  # their memory is wanted for this frame
        only_itself = bool(self.state.history) and not self.chain.history_for(self.state, frame.header)
        if usable and (only_itself or _lacks_neighbour(self.state, stars, brought_forward(self.state.earlier_stars, stars))):
            self.state = replace(self.state, held=frame)
            return (first,)
        self.state, second = self.chain.process(self.state, frame)
        return first, second

    def flush(self) -> Results:
        """At the end of the frames: the result of one that still waits, judged alone."""
        return () if self.state.held is None else (self._judged(self.state.held, None),)

    def finish(self) -> RunEnd:
        """What is sent after the results of all frames, those of `flush` included."""
        return self.chain.finish(self.state)

    @property
    def is_open(self) -> bool:
        """Whether something is left to be sent after the last frame."""
        return self.state.held is not None or self.state.tracking is not None

    def end(self) -> tuple[OnboardResult | RunEnd, ...]:
        """After the last frame: `flush` and `finish`."""
        return (*self.flush(), self.finish())

    def _taken(self, frame: Frame) -> Results:
        """What a frame makes known when none waits."""
        waits = self.chain.looks_back and not self.chain.history_for(self.state, frame.header)
        if not waits:
            prepared = self.chain.prepare(self.state, frame)
            waits = (
                prepared.usable and self.chain.looks_back and _lacks_neighbour(self.state, prepared.view.stars, prepared.earlier)
            )
        if waits:
            self.state = replace(self.state, held=frame)
            return ()
        self.state, result = self.chain.judge(self.state, prepared)
        return (result,)

    def _judged(self, held: Frame, neighbour: object) -> OnboardResult:
        """Result of the frame that waits. neighbour : what is remembered of the next frame, None without one."""
        state = replace(self.state, held=None)
        prepared = self.chain.prepare(state, held)
        if neighbour is not None:
            prepared = replace(prepared, view=replace(prepared.view, history=(neighbour,)))
        self.state, result = self.chain.judge(state, prepared)
        return result


def _lacks_neighbour(state: OnboardState, stars: StarList, earlier: tuple[EarlierStars, ...]) -> bool:
    """Whether a frame has stars enough, not trailed, and none of the frame before are found; earlier : those brought forward."""
    if earlier or stars.motion is not None or len(stars) < registration.LEAST:
        return False
    if not state.history or not state.earlier_stars:
        return True
    clean = part_of(stars, ((stars.flags & NOT_KEPT) == 0).nonzero()[0])
    return registration.register(state.earlier_stars[-1].stars, clean, reach_px=REACH_PX) is None
