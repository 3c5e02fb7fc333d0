"""How well a streak fitter measures trails of stated S/N, and what it does with pixels that hold none."""

import copy
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.exams.trails import PSF_SIGMA_PX, Trail, trail
from sboc_e2e.exams.verdict import Failed, Verdict, asked, expect
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection
from sboc_e2e.report.words import number
from sboc_e2e.score.figures import pull_width
from sboc_e2e.score.matching import distance_to_path

SHAPE: Final = (200, 200)  # Rows and columns; holds the longest trail at any angle about the middle.
SNRS: Final = (12.0, 30.0, 100.0)  # Near the detection threshold, usual, and bright, where the model's own errors show.
LENGTHS_PX: Final = (3.0, 20.0, 60.0, 120.0)
"""From point-like to one that fills the frame; the shortest has no direction, so that its pull is left out."""
REPEATS: Final = 4  # Trails of each S/N and length: 48 in all, 36 of them with a pull, whose width is then known to some 20 %.
REGION_PX: Final = 7.0  # Pixels within this distance are given: eight PSF sigmas, and what the detection is off.
NEAR_PX: Final = 2.0
"""A midpoint nearer than this is measured: two pixels are an FWHM; noise alone would scatter over the region."""
NOISE_E: Final = 2.9  # Electrons rms of a sky pixel: `codec.NOISE_ADU` times the exam detector's gain.
SLOW_S: Final = 2.0
"""CPU seconds of one trail; a frame may have dozens."""

Fit = Callable[[StreakPixels, Detection], Any]


def questions(fit: Fit) -> Iterator[Verdict]:
    """Everything that is asked of a fitter."""
    plain = trail((100.0, 100.0), 60.0, 30.0, 30.0, SHAPE, NOISE_E)
    pixels, detection = seen(plain, 0)
    names = " ".join(f"{snr:g}" for snr in SNRS)
    yield asked(f"measures trails of S/N {names}", lambda: _measured(fit))
    for name, bad in _bad_pixels(pixels).items():
        yield asked(f"survives {name}", partial(_survived, fit, bad, detection))
    yield asked("leaves its input untouched", lambda: _untouched(fit, pixels, detection))
    yield asked("gives the same twice", lambda: _same_twice(fit, pixels, detection))
    yield asked(f"takes less than {SLOW_S:g} s for a trail of 60 px", lambda: _fast(fit, pixels, detection))


def _survived(fit: Fit, pixels: StreakPixels, detection: Detection) -> None:
    _is_fit(fit(pixels, detection))


def seen(each: Trail, seed: int) -> tuple[StreakPixels, Detection]:
    """The pixels around a trail in noise, and a detection whose ends are off by half a pixel."""
    rng = np.random.default_rng([17, seed])
    ends = (float(each.path.row[0]), float(each.path.col[0]), float(each.path.row[-1]), float(each.path.col[-1]))
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    image = rng.normal(0.0, NOISE_E, SHAPE)
    image[each.row, each.col] += rng.poisson(each.light_e)
    near = _distance(rows.ravel(), cols.ravel(), ends) <= REGION_PX
    pixels = StreakPixels(
        row=rows.ravel()[near].astype(np.int32), col=cols.ravel()[near].astype(np.int32),
        value_e=image.ravel()[near].astype(np.float32), variance_e2=np.full(int(near.sum()), NOISE_E**2, np.float32),
        psf_sigma_px=PSF_SIGMA_PX, frame_shape=SHAPE,
    )  # fmt: skip
    off = rng.normal(0.0, 0.5, 4)
    flags = StreakFlag.POINT_LIKE if each.path.length_px < 5 else StreakFlag(0)
    return pixels, Detection(
        row0=ends[0] + off[0], col0=ends[1] + off[1], row1=ends[2] + off[2], col1=ends[3] + off[3], snr=each.snr, flags=flags
    )


def _distance(row: NDArray[Any], col: NDArray[Any], ends: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """Distance (px) of pixels (n,) to the segment between (row0, col0) and (row1, col1)."""
    row0, col0, row1, col1 = ends
    down, right = row1 - row0, col1 - col0
    share = np.clip(((row - row0) * down + (col - col0) * right) / max(down**2 + right**2, 1e-12), 0.0, 1.0)
    return np.asarray(np.hypot(row - row0 - share * down, col - col0 - share * right))


def _measured(fit: Fit) -> str:
    """Trails that were measured within two pixels, and the pulls of the midpoint across; raises `Failed` when there is none."""
    rng = np.random.default_rng(23)
    asked_of = near = 0
    pulls: list[float] = []
    for snr in SNRS:
        for length_px in LENGTHS_PX:
            for _ in range(REPEATS):
                asked_of += 1
                middle = (100.0 + float(rng.uniform(-5, 5)), 100.0 + float(rng.uniform(-5, 5)))
                each = trail(middle, length_px, float(rng.uniform(0, 180)), snr, SHAPE, NOISE_E)
                found = _is_fit(fit(*seen(each, asked_of)))
                point = np.array([(found.row0 + found.row1) / 2, (found.col0 + found.col1) / 2])
                across = distance_to_path(point, each.path)[0]
                if found.flags & StreakFlag.FIT_FAILED or np.hypot(*(point - middle)) > NEAR_PX:
                    continue
                near += 1
                if found.sigma_cross_px > 0 and length_px > LENGTHS_PX[0]:
                    pulls.append(across / found.sigma_cross_px)
    if near == 0:
        raise Failed(f"measured none of {asked_of} trails within {NEAR_PX:g} px")
    width = number(pull_width(np.array(pulls))) if pulls else "-"
    return f"{near} of {asked_of} within {NEAR_PX:g} px; pulls across {width} (n = {len(pulls)}; 1 is calibrated)"


def _bad_pixels(pixels: StreakPixels) -> dict[str, StreakPixels]:
    """Pixels that hold no trail, or too little of one."""
    n = len(pixels.row)
    noise = np.random.default_rng(29).normal(0.0, NOISE_E, n).astype(np.float32)

    def like(count: int, value_e: Any, variance_e2: Any) -> StreakPixels:
        return StreakPixels(
            row=pixels.row[:count], col=pixels.col[:count], value_e=value_e[:count], variance_e2=variance_e2[:count],
            psf_sigma_px=pixels.psf_sigma_px, frame_shape=pixels.frame_shape,
        )  # fmt: skip

    nothing = np.full(n, np.inf, np.float32)
    return {
        "noise alone": like(n, noise, pixels.variance_e2),
        "zeros": like(n, np.zeros(n, np.float32), pixels.variance_e2),
        "three pixels": like(3, pixels.value_e, pixels.variance_e2),
        "no usable pixel": like(n, pixels.value_e, nothing),
    }


def _is_fit(found: Any) -> StreakFit:
    if not isinstance(found, StreakFit):
        raise Failed(f"returned a {type(found).__name__}, expected a StreakFit")
    expect(bool(np.isfinite([found.row0, found.col0, found.row1, found.col1]).all()), "ends are not finite")
    return found


def _untouched(fit: Fit, pixels: StreakPixels, detection: Detection) -> None:
    before = copy.deepcopy((pixels.value_e, pixels.variance_e2))
    fit(pixels, detection)
    same = np.array_equal(before[0], pixels.value_e) and np.array_equal(before[1], pixels.variance_e2)
    expect(same, "changed the arrays that it was given")


def _same_twice(fit: Fit, pixels: StreakPixels, detection: Detection) -> None:
    one, other = (checkpoint.to_bytes(fit(pixels, detection)) for _ in range(2))
    expect(one == other, "two calls gave different results")


def _fast(fit: Fit, pixels: StreakPixels, detection: Detection) -> str:
    fit(pixels, detection)
    start = time.process_time()
    fit(pixels, detection)
    taken_s = time.process_time() - start
    expect(taken_s < SLOW_S, f"took {taken_s:.1f} s")
    return f"{1000 * taken_s:.1f} ms"
