"""Frames of several cameras in one folder on board: each camera's frames are a sequence of their own.

Frames of another camera are no earlier frames of the same sky, and its gain, noise and PSF are not theirs. Of each camera only
the state between its frames is kept, so that chips of a mosaic, which come in turn, have their own frames before them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from onboard.chain import OnboardChain, OnboardResult, OnboardState, RunEnd
from onboard.latency import FrameSequence
from sboc_e2e.icd.frame import Frame

MOST_WAITING_PX: Final = 100_000_000
"""Pixels of frames that wait for the next one of their camera, 400 MB. Beyond it the one that waited longest is judged alone.
Chosen."""


@dataclass(kw_only=True)
class CamerasApart:
    """As `FrameSequence`, for frames of several cameras. Packets are counted through all of them.

    chain_of : the chain of a camera, by its number. camera_of : the number of the camera of each frame that is taken.
    """

    chain_of: Callable[[int], OnboardChain]
    camera_of: Mapping[int, int]
    _states: dict[int, OnboardState] = field(default_factory=dict, init=False)
    _now: tuple[int, FrameSequence] | None = field(default=None, init=False)

    def take(self, frame: Frame) -> tuple[OnboardResult, ...]:
        """What a frame makes known, see `FrameSequence.take`."""
        camera = self.camera_of[frame.header.frame]
        results = self._sequence(camera).take(frame)
        waiting = {k: s.held for k, s in self._all_states().items() if s.held is not None}
        for k in sorted(waiting, key=lambda k: waiting[k].header.frame):
            if k != camera and sum(held.pixels.size for held in waiting.values()) > MOST_WAITING_PX:
                results = (*results, *self._sequence(k).flush())
                del waiting[k]
        return results

    @property
    def is_open(self) -> bool:
        """Whether something is left to be sent after the last frame."""
        return any(state.held is not None or state.tracking is not None for state in self._all_states().values())

    def end(self) -> tuple[OnboardResult | RunEnd, ...]:
        """After the last frame: results of those that wait, and the last tracks of each camera."""
        return tuple(result for camera in sorted(self._all_states()) for result in self._sequence(camera).end())

    @property
    def state(self) -> OnboardState | None:
        """State of the camera whose frame came last."""
        return None if self._now is None else self._now[1].state

    def _all_states(self) -> dict[int, OnboardState]:
        if self._now is not None:
            camera, sequence = self._now
            self._states[camera] = sequence.state
        return self._states

    def _sequence(self, camera: int) -> FrameSequence:
        """The sequence of a camera, which goes on from its last frame. Chains are made anew: each holds a frame's memory."""
        if self._now is not None and self._now[0] == camera:
            return self._now[1]
        states, before = self._all_states(), self.state
        self._now = None  # its memory goes first
        chain = self.chain_of(camera)
        state = states.get(camera) or chain.initial_state()
        if before is not None:
            state = replace(state, writer=before.writer)
        self._now = camera, FrameSequence(chain=chain, state=state)
        return self._now[1]
