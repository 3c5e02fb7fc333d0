"""A frame without a predecessor waits for the next one and is held against it: no frame is a first frame.

Stars are told from movers by another frame of the same sky. It is the one before and, at the start of a run and after a slew,
the one after. Only such frames wait. A break in the sky costs the memory of one frame as it came and two preparations more;
between breaks nothing is held. Packets leave in the order of frames.
"""

from dataclasses import replace
from typing import Final

from onboard.chain import OnboardChain
from onboard.image import registration
from onboard.image.frame_flags import checksum
from onboard.stars.memory import NOT_KEPT, brought_forward, part_of
from onboard.state import OnboardResult, OnboardState
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.signals import StarList

REACH_PX: Final = 300.0
"""Detectors find stars again that moved no farther since the frame before."""

Results = tuple[OnboardResult, ...]


def take(chain: OnboardChain, state: OnboardState, frame: Frame) -> tuple[OnboardState, Results]:
    """The state after a frame, and the results it gives: none if it waits, else its own after that of a frame that waited."""
    held = state.held
    if held is None:
        prepared = chain.prepare(state, frame)
        if prepared.usable and chain.looks_back and _lacks_neighbour(state, prepared.view.stars):
            return replace(state, held=frame), ()
        state, result = chain.judge(state, prepared)
        return state, (result,)
    # The same frame come twice tells nothing about the one that waits, so this one is looked at as its follower.
    prepared = chain.prepare(replace(state, previous=held.header, pixel_check=checksum(held.pixels)), frame)
    usable, stars = prepared.usable, prepared.view.stars
    neighbour = chain.remembered(prepared.view) if usable else None
    del prepared  # its memory is that of the frame that waited
    state, first = _judged(chain, state, held, neighbour)
    if usable and _lacks_neighbour(state, stars):
        return replace(state, held=frame), (first,)
    state, second = chain.process(state, frame)
    return state, (first, second)


def flush(chain: OnboardChain, state: OnboardState) -> tuple[OnboardState, Results]:
    """The state after the end of the frames, and the result of one that still waits: it is judged alone."""
    if state.held is None:
        return state, ()
    state, result = _judged(chain, state, state.held, None)
    return state, (result,)


def _judged(chain: OnboardChain, state: OnboardState, held: Frame, neighbour: object) -> tuple[OnboardState, OnboardResult]:
    """State and result after a frame that waited; the neighbour, what is remembered of the next frame, is its history."""
    prepared = chain.prepare(replace(state, held=None), held)
    if neighbour is not None:
        prepared = replace(prepared, view=replace(prepared.view, history=(neighbour,)))
    return chain.judge(replace(state, held=None), prepared)


def _lacks_neighbour(state: OnboardState, stars: StarList) -> bool:
    """Whether no star pattern of the frame before is found in a frame that has enough stars, none of them trailed."""
    if stars.motion is not None or len(stars) < registration.LEAST:
        return False
    if not state.history or not state.earlier_stars:
        return True
    if brought_forward(state.earlier_stars, stars):
        return False
    clean = part_of(stars, (((stars.flags & NOT_KEPT) == 0).nonzero())[0])
    return registration.register(state.earlier_stars[-1].stars, clean, reach_px=REACH_PX) is None
