"""`onboard.tracker: joint_and_stack`: trails over a few frames as `joint` finds them, and slow objects in sums of many frames."""

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.image import registration
from onboard.track.boxes import KINDS, blind_box, named_box
from onboard.track.joint import JointState, JointTracker
from onboard.track.kept_search import KeptSearch
from onboard.track.records import clipped
from onboard.track.same import same_object
from onboard.track.stack import Box, SlowObject, Stack, StackState, middle_ns
from onboard.track.static_model import static_snr
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import Detection, Track, TrackerView, TrackMember

PERIOD_S: Final = 0.25
"""Four frames a second: the work that a box means is reckoned for them."""

MOST_VELOCITIES: Final = 4000
"""Velocities that a box may be divided into: the work of a window grows with them."""

POINT_LIKE_PX: Final = 4.0
"""A trail that is shorter has no ends that a frame could tell: about two widths of the PSF."""

AGAIN_PX: Final = 6.0
"""An object is one of the window before where that one foretells it so near: its rate was known to 0.2 px/s."""


STAR_SNR: Final = 0.8
"""Static light of this S/N in one frame under a member makes its own light unknown. The mean of some 32 frames has an error
of 0.16; of the object's own light a twentieth is in it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenFrame:
    """A frame that members may lie in. transform : (2, 3) of the stack's grid into it. epoch_s : in the stack's time."""

    header: FrameHeader
    transform: NDArray[np.float64]
    epoch_s: float


@dataclass(frozen=True, kw_only=True, eq=False)
class JointAndStackState:
    """States of both searches; the newest frames; objects of the last full window with their numbers; the window's velocities."""

    joint: JointState
    stack: StackState
    seen: tuple[SeenFrame, ...] = ()
    slow: tuple[tuple[int, SlowObject], ...] = ()
    box: Box | None = None


@dataclass(frozen=True, kw_only=True)
class JointAndStackTracker(JointTracker):
    """`joint`, and points that move straight within a box of velocities among the stars, `stack_frames` frames at a time."""

    window: int = field(
        default=6, metadata={"doc": "frames that are searched together; 18 MB each of 4096 x 4096 px", "min": 3, "max": 15}
    )
    box: str = field(
        default="given",
        metadata={
            "doc": "velocities that are searched: those given below, of a kind of orbit, or blindly all slow ones",
            "choices": ("given", *KINDS, "blind"),
        },
    )
    stack_frames: int = field(default=32, metadata={"doc": "frames that are summed", "min": 8, "max": 128})
    rate_row_px_s: float = field(
        default=0.0, metadata={"doc": "middle of the box of velocities, down the rows", "min": -200.0, "max": 200.0}
    )
    rate_col_px_s: float = field(
        default=9.0, metadata={"doc": "middle of the box of velocities, along the columns", "min": -200.0, "max": 200.0}
    )
    half_row_px_s: float = field(default=0.4, metadata={"doc": "half height of the box of velocities", "min": 0.0, "max": 50.0})
    half_col_px_s: float = field(default=0.88, metadata={"doc": "half width of the box of velocities", "min": 0.0, "max": 50.0})
    false_stacks: float = field(
        default=0.1, metadata={"doc": "false slow objects per window that noise may make", "min": 1e-9, "max": 10.0}
    )

    def __post_init__(self) -> None:
        if self.box not in ("given", "blind", *KINDS):
            raise UserError(f"onboard.tracker: box = {self.box!r}; allowed are given, {', '.join(KINDS)}, blind")
        if self.box == "given" and self.half_row_px_s * self.half_col_px_s == 0.0:
            raise UserError("onboard.tracker: half_row and half_col of the box of velocities must be above 0 px/s")
        if self.box in KINDS:
            return
        n = self.sums(self._given())
        if n > MOST_VELOCITIES:
            less = "stack_frames" if self.box == "blind" else "half_row, half_col or stack_frames"
            raise UserError(
                f"onboard.tracker: the box of velocities needs some {n} sums, {MOST_VELOCITIES} are allowed: make {less} smaller"
            )

    def sums(self, box: Box) -> int:
        """Tracks of a box that lie 1 px apart at the window's ends, at four frames a second.

        The lattice's lie up to `stack_search.OUTER_PX` apart: a wide box has a sixth as many sums.
        """
        reach = 0.5 * self.stack_frames * PERIOD_S
        return math.prod(max(1, math.ceil(2.0 * half * reach)) for half in (box.half_row_px_s, box.half_col_px_s))

    def box_of(self, header: FrameHeader, focal_px: float | None) -> Box | None:
        """Velocities to be searched in a window that begins with a frame; None where the frame does not tell those of its orbits.

        A box of orbits that needs too many sums is cut about its middle.
        """
        if self.box not in KINDS:
            return self._given()
        found = None if focal_px is None else named_box(self.box, header, focal_px)
        if found is None or self.sums(found) <= MOST_VELOCITIES:
            return found
        share = math.sqrt(MOST_VELOCITIES / self.sums(found))
        return replace(found, half_row_px_s=share * found.half_row_px_s, half_col_px_s=share * found.half_col_px_s)

    def initial_state(self) -> JointAndStackState:  # type: ignore[override]
        """Nothing seen."""
        return JointAndStackState(joint=super().initial_state(), stack=self._stack(self._given()).initial_state())

    def track(  # type: ignore[override]
        self, state: JointAndStackState, view: TrackerView
    ) -> tuple[JointAndStackState, tuple[Track, ...]]:
        """Tracks of both kinds; a slow object is reported once a window, with its places in the newest frames."""
        joint, tracks = super().track(state.joint, view)
        begun, box = state.stack.begin_ns, state.box
        if view.transform is None or not (state.stack.groups or state.stack.epochs):
            box = self.box_of(view.view.header, view.focal_px) or box
        if box is None:
            return replace(self.initial_state(), joint=joint), tracks
        stack, objects = self._stack(box).step(state.stack, view.view, view.transform)
        broken = stack.begin_ns != begun
        header = view.view.header
        new = SeenFrame(header=header, transform=stack.transform, epoch_s=(middle_ns(view.view) - stack.begin_ns) * 1e-9)
        seen = (*(() if broken else state.seen), new)[-self.window_frames :]
        slow = () if broken else state.slow
        number, found = joint.next_number, []
        for each in objects:
            known = next((k for k, before in slow if _goes_on(before, each)), None)
            track = self._track_of(each, number if known is None else known, seen, stack.model, view.view.psf_sigma_px)
            if track is None or any(same_object(t, track) for t in joint.tracks):
                continue
            number += known is None
            found.append((track, each))
        if objects or broken:
            slow = tuple((track.number, each) for track, each in found)
        joint = replace(joint, next_number=number)
        after = JointAndStackState(joint=joint, stack=stack, seen=seen, slow=slow, box=box)
        return after, (*tracks, *(track for track, _ in found))

    def finish(self, state: JointAndStackState) -> tuple[Track, ...]:  # type: ignore[override]
        """Trails that wait for later frames; slow objects are looked for in full windows alone."""
        return super().finish(state.joint)

    def _put_by(self, window: tuple[KeptSearch, ...], followed: int) -> tuple[KeptSearch, ...]:
        """Without halves, which are made again: 17 MB for 20 ms a frame. Memory is what both searches together lack."""
        return tuple(replace(frame, halves=None) for frame in window)

    def _given(self) -> Box:
        """The box that the options give."""
        if self.box == "blind":
            return blind_box(PERIOD_S)
        return Box(
            row_px_s=self.rate_row_px_s,
            col_px_s=self.rate_col_px_s,
            half_row_px_s=self.half_row_px_s,
            half_col_px_s=self.half_col_px_s,
        )

    def _stack(self, box: Box) -> Stack:
        return Stack(frames=self.stack_frames, box=box, false_per_window=self.false_stacks)

    def _track_of(
        self, found: SlowObject, number: int, seen: tuple[SeenFrame, ...], model: NDArray[np.int8], psf_sigma_px: float
    ) -> Track | None:
        """The contract's record of a slow object, its members on stars flagged; None where fewer than two frames hold it."""
        members = []
        for frame in seen:
            half = 0.5e-9 * frame.header.exposure_ns
            ends = np.array([found.at(frame.epoch_s - half), found.at(frame.epoch_s + half)])
            inside = clipped(registration.apply(frame.transform, ends), (frame.header.rows, frame.header.cols))
            if inside is not None:
                (row0, col0, row1, col1), flags = inside
                if math.hypot(row1 - row0, col1 - col0) < POINT_LIKE_PX:
                    flags |= StreakFlag.POINT_LIKE
                if static_snr(model, found.at(frame.epoch_s), psf_sigma_px) > STAR_SNR:
                    flags |= StreakFlag.CROSSES_STAR
                detection = Detection(
                    row0=row0, col0=col0, row1=row1, col1=col1, snr=found.snr / math.sqrt(self.stack_frames), flags=flags
                )
                members.append(TrackMember(frame=frame.header.frame, detection=detection))
        return Track(number=number, snr=found.snr, members=tuple(members)) if len(members) >= 2 else None


def _goes_on(before: SlowObject, now: SlowObject) -> bool:
    """Whether an object of the window before foretells one of this."""
    return float(np.hypot(*(before.at(now.middle_s) - now.at(now.middle_s)))) < AGAIN_PX
