"""Exam of the on-board chain under other skies: snr50, false detections per frame and CPU against the clean sky, row by row.

python -m tests.benchmarks.other_skies [--frames N] [--side PX] [--seed S] [--hostile] [ROW ...]
"""

import argparse
import json
import math
import sys
import time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain, OnboardResult, OnboardState, OnboardSteps
from onboard.detect import LineIntegralDetector
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.options import OnboardOptions
from onboard.stars.matched import MatchedStars
from onboard.work import nominal
from sboc_e2e.icd.frame import Frame, FrameHeader, NominalCamera
from tests.benchmarks import sky_frames
from tests.benchmarks.bench_detection import score
from tests.benchmarks.detection_frames import Streak

STREAKS: Final = tuple((length, snr) for snr in (6.0, 6.6, 7.2, 7.8, 8.6, 10.0, 13.0) for length in (100.0, 300.0))
SATURATION_ADU: Final = sky_frames.SATURATION


def camera(side: int) -> NominalCamera:
    """The nominal camera: FWHM 2 px, whatever the frames show."""
    return NominalCamera(
        name="exam",
        rows=side,
        cols=side,
        focal_px=40_000.0,
        center_row=0.5 * (side - 1),
        center_col=0.5 * (side - 1),
        psf_sigma_px=sky_frames.FWHM_PX / sky_frames.FWHM_PER_SIGMA,
        gain_e_adu=1.0,
        read_noise_e=sky_frames.READ_NOISE_E,
        saturation_adu=SATURATION_ADU,
        full_well_e=SATURATION_ADU,
        zero_point_e_s=1e8,
        aperture_m=0.2,
    )


def chain(side: int) -> OnboardChain:
    """The default chain without a calibration."""
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=LineIntegralDetector(), codec=PlanesCodec()
    )
    return OnboardChain(OnboardOptions(), steps, calibration=None, camera=camera(side), run_id=1)


def frame(number: int, pixels: NDArray[np.uint16]) -> Frame:
    """Pixels as a frame of a run at four frames per second."""
    header = FrameHeader(
        frame=number,
        t_start_tai_ns=2_000_000_000_000_000_000 + number * 250_000_000,
        exposure_ns=200_000_000,
        line_time_ns=10_000,
        rows=pixels.shape[0],
        cols=pixels.shape[1],
        gain_e_adu=1.0,
        read_noise_e=sky_frames.READ_NOISE_E,
        saturation_adu=SATURATION_ADU,
    )
    return Frame(header=header, pixels=pixels)


def second_of(earlier: NDArray[np.uint16], later: NDArray[np.uint16]) -> tuple[OnboardResult, float]:
    """Result and CPU seconds of the later one of two frames."""
    run = chain(later.shape[0])
    state: OnboardState = run.initial_state()
    state, _ = run.process(state, frame(0, earlier))
    start = time.process_time()
    _, result = run.process(state, frame(1, later))
    return result, time.process_time() - start


def exam(row: sky_frames.Row, side: int, n: int, seed: int = 0) -> dict[str, Any]:
    """Figures of one row of the exam from n pairs of frames with streaks."""
    wanted = [s for s in STREAKS if s[0] < 0.5 * side]
    snr, hit, cpu, operations, false, sent = [], [], [], [], 0, 0
    for k in range(n):
        drawn = sky_frames.scene(row, side, wanted, seed + k)
        result, seconds = second_of(drawn.earlier, drawn.later)
        cpu.append(seconds)
        operations.append(result.work.operations / nominal(side * side))
        paired, _, wrong = score(result.detections, drawn.streaks)
        false += wrong
        snr += [s.snr for s in drawn.streaks]
        hit += [d is not None for d in paired]
        sent += _sent(result, drawn.streaks)
    at = {s: round(float(np.mean([h for t, h in zip(snr, hit, strict=True) if t == s])), 2) for s in sorted(set(snr))}
    return {
        "row": row.name,
        "frames": n,
        "snr50": snr50(np.array(snr), np.array(hit, dtype=float)),
        "false_per_frame": round(false / n, 2),
        "cpu_s": round(float(np.median(cpu)), 2),
        "operations_over_nominal": round(float(np.median(operations)), 2),
        "found": at,
        "sent": f"{sent}/{sum(hit)}",
    }


def _sent(result: OnboardResult, streaks: list[Streak]) -> int:
    """How many of the streaks went down."""
    return sum(d is not None for d in score([group.detection for group in result.rois], streaks)[0])


def snr50(snr: NDArray[np.float64], hit: NDArray[np.float64]) -> float:
    """S/N of half completeness: maximum likelihood of a normal curve of unit-sigma to two-sigma width on a grid."""
    middle, width = np.meshgrid(np.arange(4.0, 16.0, 0.05), (0.6, 0.8, 1.0, 1.4, 2.0), indexing="ij")
    z = (snr[None, None] - middle[..., None]) / width[..., None]
    p = np.clip(0.5 * (1.0 + np.vectorize(math.erf)(z / math.sqrt(2.0))), 1e-3, 1.0 - 1e-3)
    likelihood = np.sum(hit * np.log(p) + (1.0 - hit) * np.log(1.0 - p), axis=-1)
    return round(float(middle.flat[int(np.argmax(likelihood))]), 2)


def hostile(name: str, side: int, seed: int = 0) -> dict[str, Any]:
    """CPU and detections of an input that nobody should send, twice in a row."""
    draw = sky_frames.HOSTILE[name]
    result, seconds = second_of(draw(side, np.random.default_rng((seed, 0))), draw(side, np.random.default_rng((seed, 1))))
    return {
        "row": name,
        "cpu_s": round(seconds, 2),
        "detections": len(result.detections),
        "flags": str(result.housekeeping.flags),
    }


def main() -> None:
    """Print one JSON line per row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--side", type=int, default=2048)
    parser.add_argument("--seed", type=int, default=0, help="of the first frame")
    parser.add_argument("--hostile", action="store_true")
    options = parser.parse_args()
    # kernels are compiled, or loaded, before anything is timed
    exam(sky_frames.ROWS[0], 512, 1)
    for row in sky_frames.ROWS:
        if not options.rows or row.name in options.rows:
            sys.stdout.write(json.dumps(exam(row, options.side, options.frames, options.seed)) + "\n")
    for name in sky_frames.HOSTILE:
        if options.hostile and (not options.rows or name in options.rows):
            sys.stdout.write(json.dumps(hostile(name, options.side)) + "\n")


if __name__ == "__main__":
    main()
