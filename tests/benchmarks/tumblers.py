"""Are trails of tumbling objects found as one, and whole: ``python -m tests.benchmarks.tumblers --frames 12``.

Trails of S/N 20 to 90 whose light varies with periods of 0.3 to 3 exposures, drawn here: a Gaussian swept along a line, each step
with its own light, over stars drawn as in `tests.onboard.star_fields`. Two light curves: a cosine that falls to a tenth, and
flashes over a floor. A trail counts as whole when one detection lies on its line, no other does, and it covers 90 % of it.
"""

import argparse
import json
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardSteps
from onboard.detect import LineIntegralDetector
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.latency import FrameSequence
from onboard.stars.matched import MatchedStars
from onboard.state import OnboardResult
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.signals import Detection
from sboc_e2e.score.figures import proportion
from tests.onboard.small_run import header, start_run
from tests.onboard.star_fields import GAIN_E_ADU, PEDESTAL_ADU, READ_NOISE_E, SKY_E, star_grid

SIDE: Final = 1024
PSF_PX: Final = 0.849
NOISE_E: Final = math.sqrt(SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12.0)
CELLS: Final = 3
"""Trails of a frame along each axis, each in its own part of the field."""

ON_LINE_PX: Final = 4.0
STEP_PX: Final = 0.25

END_SNR: Final = 4.0
"""Light of an end that stands out from noise at some ten places."""


@dataclass(frozen=True, kw_only=True)
class Tumbler:
    """A trail. ends : row0, col0, row1, col1. period : in exposures. curve : "cosine" or "flashes"."""

    ends: tuple[float, float, float, float]
    snr: float
    period: float
    phase: float
    depth: float
    curve: str

    @property
    def length_px(self) -> float:
        """Between its ends."""
        return math.hypot(self.ends[2] - self.ends[0], self.ends[3] - self.ends[1])

    def light(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Relative brightness at shares of the exposure."""
        cosine = np.cos(2.0 * math.pi * (time / self.period + self.phase))
        if self.curve == "cosine":
            return np.asarray(1.0 + self.depth * cosine)
        return np.asarray(1.0 - self.depth + np.exp(6.0 * (cosine - 1.0)))

    def drawn(self, shape: tuple[int, int]) -> NDArray[np.float64]:
        """Its light (rows, cols), e-, of the S/N that it is to have over the noise without it."""
        n = math.ceil(self.length_px / STEP_PX) + 1
        time = np.linspace(0.0, 1.0, n)
        row, col = (self.ends[k] + time * (self.ends[k + 2] - self.ends[k]) for k in (0, 1))
        image = np.zeros(shape)
        for r, c, light in zip(row, col, self.light(time), strict=True):
            i, j = round(r) - 5, round(c) - 5
            rows = np.exp(-0.5 * ((np.arange(i, i + 11) - r) / PSF_PX) ** 2)
            cols = np.exp(-0.5 * ((np.arange(j, j + 11) - c) / PSF_PX) ** 2)
            image[i : i + 11, j : j + 11] += light * np.outer(rows, cols)
        return image * (self.snr * NOISE_E / math.sqrt(float((image**2).sum())))

    def attainable(self) -> float:
        """Share of the length between the places up to which light outside has S/N `END_SNR`: no filter sees more of an end."""
        time = (np.arange(2000) + 0.5) / 2000
        light = self.light(time)
        step = self.snr / math.sqrt(2000.0 * float((light**2).mean()))
        lost = 0.0
        for outer in (light, light[::-1]):
            snr = step * np.cumsum(outer) / np.sqrt(np.arange(1, 2001))
            lost += float(np.argmax(snr >= END_SNR)) / 2000.0
        return 1.0 - lost


def draw(rng: np.random.Generator, depth: float) -> list[Tumbler]:
    """One trail in each cell of a frame."""
    cell, made = SIDE / CELLS, []
    for k in range(CELLS**2):
        length, angle = float(np.exp(rng.uniform(np.log(60.0), np.log(260.0)))), float(rng.uniform(0.0, 2.0 * math.pi))
        row, col = ((0.5 + i) * cell + rng.uniform(-15.0, 15.0) for i in (k // CELLS, k % CELLS))
        d_row, d_col = 0.5 * length * math.sin(angle), 0.5 * length * math.cos(angle)
        made.append(
            Tumbler(
                ends=(row - d_row, col - d_col, row + d_row, col + d_col), snr=float(rng.uniform(20.0, 90.0)),
                period=float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))), phase=float(rng.uniform()),
                depth=depth, curve=("cosine", "flashes")[k % 2] if depth else "cosine",
            )
        )  # fmt: skip
    return made


def pieces(trail: Tumbler, detections: tuple[Detection, ...]) -> list[float]:
    """Share of the length that each detection on a trail's line covers."""
    row0, col0, row1, col1 = trail.ends
    length = trail.length_px
    u_row, u_col = (row1 - row0) / length, (col1 - col0) / length
    shares = []
    for d in detections:
        ends = np.array([[d.row0 - row0, d.col0 - col0], [d.row1 - row0, d.col1 - col0]])
        along, across = ends @ (u_row, u_col), ends @ (u_col, -u_row)
        if np.abs(across).max() < ON_LINE_PX and along.max() > 0.0 and along.min() < length:
            shares.append(float(min(along.max(), length) - max(along.min(), 0.0)) / length)
    return shares


def measure(n_frames: int, seed: int, depth: float = 0.9) -> list[tuple[Tumbler, list[float]]]:
    """Trails of some frames over one field of stars, and the pieces that were found of each; depth 0 : even light."""
    stars = star_grid(np.random.default_rng(seed), side=SIDE, pitch=24, flux_e=(60.0, 20000.0), sigma_px=PSF_PX).electrons
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=LineIntegralDetector(), codec=PlanesCodec()
    )
    run = start_run(side=SIDE, steps=steps)
    sequence = FrameSequence(chain=run.chain, state=run.state)
    truth, results = [], list[OnboardResult]()
    for number in range(n_frames):
        rng = np.random.default_rng([seed, number])
        truth.append(draw(rng, depth))
        light = stars + sum(trail.drawn(stars.shape) for trail in truth[-1])
        noisy = (rng.poisson(light) + rng.normal(0.0, READ_NOISE_E, light.shape)) / GAIN_E_ADU + PEDESTAL_ADU
        pixels = np.clip(np.rint(noisy), 0, 65535).astype(np.uint16)
        results += sequence.take(Frame(header=header(number, SIDE), pixels=pixels))
    results += sequence.flush()
    return [(t, pieces(t, r.detections)) for trails, r in zip(truth, results, strict=True) for t in trails]


def whole(found: list[float]) -> bool:
    """Whether one detection holds a trail."""
    return len(found) == 1 and found[0] >= 0.9


def summary(measured: list[tuple[Tumbler, list[float]]]) -> dict[str, Any]:
    """Share found as one trail and whole, by light curve, and what became of the others; `lit`: 90 % shows."""
    out: dict[str, Any] = {}
    for name in ("cosine", "flashes"):
        mine = [(trail, found) for trail, found in measured if trail.curve == name]
        lit = [found for trail, found in mine if trail.attainable() >= 0.9]
        out[name] = {
            "whole": proportion(sum(whole(found) for _, found in mine), len(mine)),
            "whole, lit": proportion(sum(whole(found) for found in lit), len(lit)),
            "one trail": proportion(sum(len(found) == 1 for _, found in mine), len(mine)),
            "none": sum(not found for _, found in mine), "several": sum(len(found) > 1 for _, found in mine),
        }  # fmt: skip
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    every = measure(asked.frames, asked.seed)
    for trail, found in every:
        if not whole(found):
            about = (round(x, 2) for x in (trail.snr, trail.length_px, trail.period, trail.attainable()))
            print(trail.curve, *about, [round(share, 2) for share in found])  # noqa: T201 - the script's result
    print(json.dumps(summary(every)))  # noqa: T201 - the script's result
