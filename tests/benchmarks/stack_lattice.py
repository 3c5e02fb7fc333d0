"""What the lattice of the stack search costs: points near the threshold that it does not find, and CPU-s of its sums.

Each point lies in noise, either at the velocity that is farthest from the lattice's (half way along both axes) or at any. It
counts where a climb from its true place ends above the threshold. From the repository's root:

    python -m tests.benchmarks.stack_lattice
"""

import math
import sys
import time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.track import stack_search
from onboard.track.stack import FIRST_MARGIN

PSF_PX: Final = 0.849
THRESHOLD, OVER = 6.5, 0.3  # S/N that is asked, and by which the points are brighter in truth
SIZE, NOISE_UNIT = 96, 18.0  # px; noise of a sum of frames in its own units
BOXES: Final = ((4, 3.0, (0.4, 0.88), 200), (16, 3.75, (1.5, 1.5), 200), (32, 3.9, (4.0, 4.0), 80))
"""Groups, last epoch (s), half sides of the box (px/s), points."""

TIMED: Final = ((4, 3.0, (0.4, 0.88)), (32, 3.9, (3.0, 4.0)))
"""Groups, last epoch and half sides of the narrow and of the wide box whose time is measured."""


def groups_of(
    epochs: NDArray[np.float64], size: int, rng: np.random.Generator, point: tuple[NDArray[np.float64], ...] | None = None
) -> tuple[NDArray[np.uint64], ...]:
    """Group images of noise. point : place, rate, and S/N of all together."""
    row, col = np.indices((size, size))
    out = []
    for t in epochs:
        image = rng.standard_normal((size, size))
        if point is not None:
            place, rate, snr = point
            here = place + rate * t
            star = np.exp(-0.5 * ((row - here[0]) ** 2 + (col - here[1]) ** 2) / (PSF_PX**2 + 1.0 / 6.0))
            image += star * float(snr) / math.sqrt(len(epochs)) / np.sqrt((star**2).sum())
        codes = np.clip(np.rint(NOISE_UNIT * image), -127, 127).astype(np.int8)
        out.append(stack_search.group_image(codes, PSF_PX))
    return tuple(out)


def found(n: int, reach_s: float, box: tuple[float, float], worst: bool, rng: np.random.Generator) -> tuple[bool, bool]:
    """Whether a climb from the truth, and one from the lattice's sums, end above the threshold."""
    epochs = np.linspace(-reach_s, reach_s, n)
    rates = stack_search.lattice(*box, epochs)
    rate = rng.uniform(-1.0, 1.0, 2) * np.array(box)
    if worst:
        axes = [np.unique(rates[:, k]) for k in (0, 1)]
        rate = np.array([0.5 * (a[len(a) // 2 - 1] + a[len(a) // 2]) for a in axes])
    place = 0.5 * SIZE + rng.uniform(-0.5, 0.5, 2)
    groups = groups_of(epochs, SIZE, rng, (place, rate, np.array(THRESHOLD + OVER)))
    window = stack_search.GroupWindow(groups, SIZE, epochs, math.exp(-0.25 / (PSF_PX**2 + 1.0 / 3.0)))
    parts = np.zeros(n)
    ideal = stack_search.climb(window, np.array([*place, *rate]), parts)
    shifts = np.rint(rates[:, None, :] * epochs[None, :, None]).astype(np.int64)
    first = math.ceil((THRESHOLD - FIRST_MARGIN) * stack_search.CODED_UNIT * math.sqrt(n))
    places, sums = stack_search.candidates(groups, SIZE, shifts, first)
    best = 0.0
    for at, (_, which) in zip(places, sums, strict=True):
        if np.hypot(*(at - place)) < 4.0:
            best = max(best, stack_search.climb(window, np.array([*at, *rates[which]], dtype=np.float64), parts))
    return ideal >= THRESHOLD, best >= THRESHOLD


def main() -> dict[str, Any]:
    """Lost points at the worst velocity and at any, and CPU-s of a search of 4096 x 4096 px (from 1024 x 1024)."""
    out: dict[str, Any] = {}
    for worst in (True, False):
        lost = total = 0
        for n, reach_s, box, points in BOXES:
            rng = np.random.default_rng(1)
            seen = np.array([found(n, reach_s, box, worst, rng) for _ in range(points)])
            lost, total = lost + int((seen[:, 0] & ~seen[:, 1]).sum()), total + int(seen[:, 0].sum())
        out["worst" if worst else "any"] = [lost, total]
    for n, reach_s, box in TIMED:
        epochs = np.linspace(-reach_s, reach_s, n)
        groups = groups_of(epochs, 1024, np.random.default_rng(1))
        rates = stack_search.lattice(*box, epochs)
        shifts = np.rint(rates[:, None, :] * epochs[None, :, None]).astype(np.int64)
        took = []
        for _ in range(4):
            begin = time.process_time()
            stack_search.candidates(groups, 1024, shifts, math.ceil(5.2 * stack_search.CODED_UNIT * math.sqrt(n)))
            took.append(time.process_time() - begin)
        out[f"{len(rates)} velocities of {n} groups, CPU-s"] = round(16.0 * min(took), 2)
    return out


if __name__ == "__main__":
    standard = stack_search.OUTER_PX
    for outer_px in (standard, 0.5 * standard):
        stack_search.OUTER_PX = outer_px  # type: ignore[misc]  # the finer lattice of the comparison
        sys.stdout.write(f"{outer_px:g} px: {main()}\n")
