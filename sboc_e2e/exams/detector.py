"""How many trails of stated S/N a detector finds within the on-board chain, and what it reports where there are none.

Frames of stars that stand still, trails at new places in each of them. The chain runs as on board with the detector in its
place; what counts are the regions that it sends, judged as the scores judge them (docs/scoring.md).
"""

import math
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain, OnboardSteps
from onboard.options import OnboardOptions
from sboc_e2e.exams.trails import PSF_SIGMA_PX, trail
from sboc_e2e.exams.verdict import Failed, Verdict, asked
from sboc_e2e.icd.frame import Calibration, Frame, FrameHeader, NominalCamera
from sboc_e2e.registry import SEAMS, Registry
from sboc_e2e.report.words import figure_words
from sboc_e2e.score.detection import FLUX_HELD, RoiFootprints
from sboc_e2e.score.figures import proportion, rate
from sboc_e2e.score.matching import TruthStreak
from sboc_e2e.score.trail import draw

SNRS: Final = (8.0, 12.0, 20.0, 60.0)
"""From the least S/N that the scores call detectable to bright trails; one in each quarter of a frame."""
LENGTHS_PX: Final = (6.0, 20.0, 50.0, 100.0)
"""From point-like to a third of the frame, so that a trail and its margin fit into a quarter."""
SHAPE: Final = (320, 320)
"""Rows and columns; a quarter of 160 px holds a trail of 100 px at any angle. Small, as it runs in seconds."""
FRAMES: Final = 12  # Four trails in each: 48 in all, three of each S/N and length. An interval of +- 0.1; more cost time.
LEAD: Final = 3
"""First frames, of stars alone: a detector that looks back has something to look at."""
STARS: Final = 60  # Of 200 to 20,000 e-. One trail in six has a star within 3 px (60 stars x 6 px x 44 px / 320**2).
GAIN_E_ADU: Final = 1.2  # Of the preset `sboc_like`, high gain.
READ_NOISE_E: Final = 2.3  # Of the preset `sboc_like`.
SKY_E: Final = 6.0  # Electrons of sky in a pixel: its noise of 2.4 e- is as large as the read noise.
PEDESTAL_ADU: Final = 100  # Level of the dark map: keeps noise above zero, where the converter clips.
NOISE_E: Final = math.sqrt(SKY_E + READ_NOISE_E**2 + GAIN_E_ADU**2 / 12)
QUARTERS: Final = 4  # One trail in each, so that no trail crosses another.


def finding(step: Any) -> Iterator[Verdict]:
    """The question whether it finds anything, answered with completeness by S/N and false detections per frame."""
    names = " ".join(f"{snr:g}" for snr in SNRS)
    yield asked(f"finds trails of S/N {names}, {LENGTHS_PX[0]:g} to {LENGTHS_PX[-1]:g} px, among stars", lambda: _score(step))


def _score(step: Any) -> str:
    """Completeness and false detections in words. Raises `Failed` when no trail is found."""
    chain = chain_with(detector=step)
    state = chain.initial_state()
    stars = star_light()
    footprints = RoiFootprints()
    truth: list[TruthStreak] = []
    for number in range(LEAD + FRAMES):
        rng = np.random.default_rng([31, number])
        mine = _trails(number - LEAD, rng, len(truth)) if number >= LEAD else []
        truth += mine
        state, result = chain.process(state, frame_of(number, stars, mine, rng))
        if number >= LEAD:
            footprints.add_frame(number, SHAPE, result.rois, mine)
    found = [t for t in truth if footprints.captured[t.index] >= FLUX_HELD]
    false = rate(len(footprints.false_groups), FRAMES, FRAMES)
    alarms = f"{figure_words(false)[0]} false per frame"
    if not found:
        raise Failed(f"found none of {len(truth)} trails, {alarms}")
    by_snr = (f"{sum(t.snr == snr for t in found)} of {sum(t.snr == snr for t in truth)} at {snr:g}" for snr in SNRS)
    share = figure_words(proportion(len(found), len(truth)))[0]
    return f"{', '.join(by_snr)}; completeness {share}; {alarms}"


def chain_with(**tried: Any) -> OnboardChain:
    """The on-board chain with default steps around those that are tried."""
    rows, cols = SHAPE
    camera = NominalCamera(
        name="exam", rows=rows, cols=cols, focal_px=44444.0, center_row=(rows - 1) / 2, center_col=(cols - 1) / 2,
        psf_sigma_px=PSF_SIGMA_PX, gain_e_adu=GAIN_E_ADU, read_noise_e=READ_NOISE_E, saturation_adu=32000.0,
        full_well_e=38000.0, zero_point_e_s=4.7e8, aperture_m=0.2,
    )  # fmt: skip
    dark, flat = np.full(SHAPE, PEDESTAL_ADU, np.float32), np.ones(SHAPE, np.float32)
    calibration = Calibration(camera=camera, dark_adu=dark, flat=flat, defects=np.zeros(SHAPE, np.uint8))
    registry = Registry()
    others = {
        name: registry.resolve(f"onboard.{name}", SEAMS[f"onboard.{name}"].default)()
        for name in ("background", "star_extractor", "detector", "codec")
        if name not in tried
    }
    steps = OnboardSteps(**tried, **others)
    return OnboardChain(OnboardOptions(), steps, calibration=calibration, camera=camera, run_id=1)


def star_light() -> NDArray[np.float64]:
    """Mean electrons of sky and stars, of fluxes from 200 to 20,000 e-, as many for each factor."""
    rng = np.random.default_rng(37)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    image = np.full(SHAPE, SKY_E)
    for flux_e in np.geomspace(200.0, 20000.0, STARS):
        row, col = rng.uniform(5, SHAPE[0] - 5), rng.uniform(5, SHAPE[1] - 5)
        near = np.exp(-0.5 * ((rows - row) ** 2 + (cols - col) ** 2) / PSF_SIGMA_PX**2)
        image += flux_e * near / near.sum()
    return image


def _trails(frame: int, rng: np.random.Generator, first: int) -> list[TruthStreak]:
    """Four trails, one in each quarter: every S/N with every length, at other angles and places in each frame."""
    made = []
    for quarter in range(QUARTERS):
        half = (SHAPE[0] * (0.25 + 0.5 * (quarter // 2)), SHAPE[1] * (0.25 + 0.5 * (quarter % 2)))
        middle = (half[0] + float(rng.uniform(-15, 15)), half[1] + float(rng.uniform(-15, 15)))
        snr, length_px = SNRS[quarter], LENGTHS_PX[(quarter + frame) % len(LENGTHS_PX)]
        each = trail(middle, length_px, float(rng.uniform(0, 180)), snr, SHAPE, NOISE_E)
        made.append(
            TruthStreak(
                index=first + quarter, frame=frame, object_id=first + quarter, path=each.path, snr=snr, length_px=length_px,
                rate_deg_s=1.0, attainable_end_px=0.0,
            )
        )  # fmt: skip
    return made


def frame_of(number: int, mean_e: NDArray[np.float64], trails: list[TruthStreak], rng: np.random.Generator) -> Frame:
    """A frame of stars and trails with photon and read noise."""
    light = mean_e.copy()
    for each in trails:
        row, col, electrons = draw(each.path).pixels(*SHAPE)
        light[row, col] += electrons
    electrons = rng.poisson(light) + rng.normal(0.0, READ_NOISE_E, SHAPE)
    pixels = np.clip(np.rint(electrons / GAIN_E_ADU + PEDESTAL_ADU), 0, 65535).astype(np.uint16)
    header = FrameHeader(
        frame=number, t_start_tai_ns=2_179_000_000 * 10**9 + number * 250_000_000, exposure_ns=200_000_000, line_time_ns=10_000,
        rows=SHAPE[0], cols=SHAPE[1], gain_e_adu=GAIN_E_ADU, read_noise_e=READ_NOISE_E, saturation_adu=32000.0,
    )  # fmt: skip
    return Frame(header=header, pixels=pixels)
