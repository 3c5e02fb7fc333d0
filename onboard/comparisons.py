"""Which frames the on-board software holds against each other: each against those before it. Chains of other frames choose."""

from typing import Any

from onboard.state import OnboardState
from sboc_e2e.icd.frame import FrameHeader


class ComparesAll:
    """Frames of a camera in flight are of different times, so that each may show what moved in the others."""

    def history_for(self, state: OnboardState, _header: FrameHeader) -> tuple[Any, ...]:
        """What the detector holds a frame against: what is remembered of the frames before it."""
        return state.history

    def may_compare(self, _one: FrameHeader, _other: FrameHeader) -> bool:
        """Whether one of two frames can show what moved in the other."""
        return True
