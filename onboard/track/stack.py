"""Slow objects that no frame shows: groups of a few frames, then the sum of all groups along every velocity of a box."""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.track import stack_search
from onboard.track.false_alarms import independent_stacks, threshold_sigma
from onboard.track.static_model import add_moving, codes_of, update_model
from sboc_e2e.icd.signals import DetectorView

WARM_UP: Final = 8
"""Frames that the model of the sky needs before anything is held against it."""

MODEL_FRAMES: Final = 32
"""Frames in the model's running mean."""

SMEAR_PX: Final = 0.8
"""Within a group an object of the box moves by no more than this against the box's middle, to either side of the group's. At the
box's edge that takes 5 % of the S/N, 2 % on average: half as many groups hold half of the memory."""

LEAST_GROUPS: Final = 4
"""Groups of a window, or their places would not tell an object's rate."""

FIRST_MARGIN: Final = 1.3
"""S/N by which the lattice's sums may fall short of the threshold: a fifth of it. Where whole pixels and the lattice together
take more, one object in thirty at the worst velocity and one in a hundred of any are not climbed to."""

MOST_CANDIDATES: Final = 2000
"""Places that are climbed from in a window."""

DRIFT_PX: Final = 40.0
"""The model begins anew where the pointing has drifted this far from its grid."""

UNEVEN: Final = 4.0  # in sigmas of chi-square; of eight groups `UNEVEN_SHARE` allows as much at S/N 20. Chosen, not measured
UNEVEN_SHARE: Final = 0.2
"""Chi-square of the groups against even brightness may exceed their number by `UNEVEN` of its own standard deviations and by the
square of `UNEVEN_SHARE` of the S/N: objects tumble."""

SAME_PX: Final = 4.0
"""Two tracks are one object where they lie this close at the first and at the last epoch of the window."""


@dataclass(frozen=True, kw_only=True)
class Box:
    """Velocities in the model's grid, px/s: middle and half widths."""

    row_px_s: float
    col_px_s: float
    half_row_px_s: float
    half_col_px_s: float

    @property
    def area_px2_s2(self) -> float:
        """Its area."""
        return 4.0 * self.half_row_px_s * self.half_col_px_s

    def group_frames(self, period_s: float, frames: int) -> int:
        """Frames of a window of `frames` that may be summed at the velocity of the middle: 1, 2, 4 or 8."""
        fastest = max(self.half_row_px_s, self.half_col_px_s) * period_s
        return next((n for n in (8, 4, 2) if n * LEAST_GROUPS <= frames and fastest * 0.5 * (n - 1) <= SMEAR_PX), 1)


@dataclass(frozen=True, kw_only=True)
class SlowObject:
    """A found object. place : row, col (px of the model's grid at the window's middle) and rates (px/s). middle_s : its epoch.

    groups : S/N in each group.
    """

    place: tuple[float, float, float, float]
    middle_s: float
    snr: float
    groups: tuple[float, ...]

    def at(self, epoch_s: float) -> NDArray[np.float64]:
        """Row and column at an epoch."""
        after = epoch_s - self.middle_s
        return np.array([self.place[0] + after * self.place[2], self.place[1] + after * self.place[3]])


@dataclass(frozen=True, kw_only=True, eq=False)
class StackState:
    """The model and the window so far. Its arrays are written again with every frame.

    begin_ns : epoch 0. transform : (2, 3) of the model's grid into the newest frame. seen : frames in the model. total, epochs :
    sum of the group under way and the epochs of its frames (s). groups, middles : finished groups and their epochs.
    """

    model: NDArray[np.int8]
    total: NDArray[np.int8]
    transform: NDArray[np.float64]
    begin_ns: int = 0
    seen: int = 0
    epochs: tuple[float, ...] = ()
    groups: tuple[NDArray[np.uint64], ...] = ()
    middles: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Stack:
    """Search of windows of `frames` frames within a box of velocities."""

    frames: int
    box: Box
    false_per_window: float

    def initial_state(self) -> StackState:
        """Nothing seen."""
        return StackState(model=np.zeros((0, 0), np.int8), total=np.zeros((0, 0), np.int8), transform=np.eye(2, 3))

    def step(
        self, state: StackState, view: DetectorView, transform: NDArray[np.float64] | None
    ) -> tuple[StackState, tuple[SlowObject, ...]]:
        """The state with one frame more, and what the window held if it is full."""
        shape = view.mask.shape
        if transform is None or state.model.shape != shape:
            zeros = np.zeros(shape, np.int8), np.zeros(shape, np.int8)
            state = replace(self.initial_state(), model=zeros[0], total=zeros[1], begin_ns=middle_ns(view))
        else:
            shift_px = transform[:, :2] @ state.transform[:, 2] + transform[:, 2]
            state = replace(state, transform=np.column_stack([transform[:, :2] @ state.transform[:, :2], shift_px]))
            if np.abs(shift_px).max() > DRIFT_PX:
                return self.step(state, view, None)
        codes = np.empty(shape, np.int8)
        codes_of(view.residual_adu, view.mask, view.background.sigma_adu, view.background.tile_px, codes)
        epoch = (middle_ns(view) - state.begin_ns) * 1e-9
        seen = state.seen + 1
        update_model(codes, state.transform, min(seen, MODEL_FRAMES), state.model)
        state = replace(state, seen=seen)
        if seen <= WARM_UP:
            return state, ()
        add_moving(codes, state.transform, state.model, self.box.row_px_s * epoch, self.box.col_px_s * epoch, state.total)
        del codes
        state = replace(state, epochs=(*state.epochs, epoch))
        period = max(epoch / max(seen - 1, 1), 1e-3)
        size = self.box.group_frames(period, self.frames)
        if len(state.epochs) < size:
            return state, ()
        image = stack_search.group_image(state.total, view.psf_sigma_px)
        state.total[:] = 0
        state = replace(state, epochs=(), groups=(*state.groups, image), middles=(*state.middles, float(np.mean(state.epochs))))
        if len(state.groups) * size < self.frames:
            return state, ()
        found = self.found(state, period, view.psf_sigma_px)
        return replace(state, groups=(), middles=()), found

    def threshold(self, shape: tuple[int, int], period_s: float, psf_sigma_px: float) -> float:
        """S/N that noise exceeds `false_per_window` times."""
        volume = independent_stacks(
            period_s * np.arange(self.frames, dtype=np.float64),
            area_px=float(shape[0] * shape[1]),
            box_px2_s2=self.box.area_px2_s2,
            psf_sigma_px=psf_sigma_px,
        )
        return threshold_sigma(volume, self.false_per_window)

    def found(self, state: StackState, period_s: float, psf_sigma_px: float) -> tuple[SlowObject, ...]:
        """What a full window holds, best first."""
        groups, n = state.groups, len(state.groups)
        middle = float(np.mean(state.middles))
        epochs = np.array(state.middles) - middle
        rates = stack_search.lattice(self.box.half_row_px_s, self.box.half_col_px_s, epochs)
        shifts = np.rint(rates[:, None, :] * epochs[None, :, None]).astype(np.int64)
        rows, cols = state.model.shape
        asked = self.threshold((rows, cols), period_s, psf_sigma_px)
        unit = stack_search.CODED_UNIT * math.sqrt(n)
        first = asked - FIRST_MARGIN
        places, sums = stack_search.candidates(groups, cols, shifts, math.ceil(first * unit))
        while len(places) >= MOST_CANDIDATES:  # a deterministic limit: the best are followed
            first += 0.25
            bright = sums[:, 0] >= first * unit
            places, sums = places[bright], sums[bright]
        # neighbouring pixels of a group image share what its filter and the reading between pixels spread
        window = stack_search.GroupWindow(groups, cols, epochs, math.exp(-0.25 / (psf_sigma_px**2 + 1.0 / 3.0)))
        box, objects = self.box, []
        for (row, col), (_, which) in zip(places, sums, strict=True):
            rate = rates[which]
            place, parts = np.array([row, col, rate[0], rate[1]], dtype=np.float64), np.zeros(n)
            snr = stack_search.climb(window, place, parts)
            excess = float(((parts - snr / math.sqrt(n)) ** 2).sum()) - n
            if snr < asked or excess > UNEVEN * math.sqrt(2.0 * n) + (UNEVEN_SHARE * snr) ** 2:
                continue
            # groups follow the box's middle: a place of theirs lies that far along in the model's grid
            objects.append(
                SlowObject(
                    place=(
                        float(place[0] + box.row_px_s * middle),
                        float(place[1] + box.col_px_s * middle),
                        float(place[2] + box.row_px_s),
                        float(place[3] + box.col_px_s),
                    ),
                    middle_s=middle,
                    snr=snr,
                    groups=tuple(float(p) for p in parts),
                )
            )
        reach = float(np.abs(epochs).max())
        return tuple(_each_once(sorted(objects, key=lambda o: -o.snr), reach))


def middle_ns(view: DetectorView) -> int:
    """Middle of a frame's exposure in its first row."""
    return view.header.t_start_tai_ns + view.header.exposure_ns // 2


def _each_once(objects: list[SlowObject], reach_s: float) -> list[SlowObject]:
    """The best of those that lie on each other at either end of the window."""
    kept: list[SlowObject] = []
    for o in objects:
        ends = [(o.middle_s - reach_s), (o.middle_s + reach_s)]
        if all(min(float(np.hypot(*(o.at(t) - k.at(t)))) for t in (*ends, o.middle_s)) > SAME_PX for k in kept):
            kept.append(o)
    return kept
