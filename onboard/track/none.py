"""`onboard.tracker: none`: every frame is seen alone."""

from dataclasses import dataclass

from sboc_e2e.icd.signals import Track, TrackerView


@dataclass(frozen=True, kw_only=True)
class NoTracker:
    """Tracks nothing, and has the chain keep nothing for it."""

    @property
    def window_frames(self) -> int:
        """No frame is kept."""
        return 0

    @property
    def seed_sigma(self) -> float:
        """Not asked for."""
        return 0.0

    def initial_state(self) -> None:
        """There is none."""
        return

    def track(self, state: None, view: TrackerView) -> tuple[None, tuple[Track, ...]]:
        """No tracks."""
        return state, ()
