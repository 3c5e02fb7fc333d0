"""On-board figures: CPU per frame and per step beside sep and photutils, star list against truth, downlink and its losses,
memory, ingest; in quiet and in stormy radiation. Frames are the simulator's default scenario (4096 x 4096, some 30,000 stars).

Times are process CPU seconds of one thread; compilation is excluded and given apart.
"""

import json
import math
import os
import pickle
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import sep
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder
from onboard.chain import OnboardChain, OnboardResult, OnboardSteps
from onboard.detect import LineIntegralDetector, ThresholdDetector
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.options import OnboardOptions
from onboard.stars.matched import MatchedStars
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import StarFlag
from sboc_e2e.icd.frame import Calibration, Frame
from sboc_e2e.icd.signals import Detection, RoiGroup, StarList
from sboc_e2e.icd.steps import Detector
from sboc_e2e.truth import FrameTruth
from simulator.chain import Simulator
from simulator.options import SimulatorOptions
from tests.benchmarks import onboard_process
from tests.benchmarks.bench_codecs import best_cpu_s, figure
from tests.benchmarks.onboard_process import NoDetector
from tests.onboard.star_fields import axis_weights

RAW_BITS = 12
SAA_PEAK_HITS = 5100.0
"""Hits per frame of the default sensor and exposure at the default peak of the South Atlantic Anomaly."""

STORM_HITS = (1000, 3000, 5000)


def chain_of(detector: Detector, calibration: Calibration) -> OnboardChain:
    """The default chain with a detector."""
    steps = OnboardSteps(background=MeshBackground(), star_extractor=MatchedStars(), detector=detector, codec=PlanesCodec())
    return OnboardChain(OnboardOptions(), steps, calibration=calibration, camera=calibration.camera, run_id=1)


WARM_PASSES = 3


def timed_run(
    chain: OnboardChain, frames: list[tuple[Frame, FrameTruth]]
) -> tuple[list[OnboardResult], NDArray[np.float64], float]:
    """Results, CPU seconds (passes, frames after the first), and those of the very first frame with what it compiles or loads.

    The frames go through once before it counts: kernels that a later frame is the first to need are there by then.
    """

    def passed() -> tuple[list[OnboardResult], list[float]]:
        state, results, times = chain.initial_state(), [], []
        for frame, _ in frames:
            start = time.process_time()
            state, result = chain.process(state, frame)
            times.append(time.process_time() - start)
            results.append(result)
        return results, times

    _, cold = passed()
    warm = [passed() for _ in range(WARM_PASSES)]
    return warm[-1][0], np.array([times[1:] for _, times in warm]), cold[0]


def spread(times: NDArray[np.float64]) -> dict[str, Any]:
    """Mean over frames, the latencies of all passes for the report's histogram, and their quantiles, s."""
    return {
        "cpu_s_per_frame": figure(list(times.mean(axis=0))),
        "latencies_cpu_s": times.ravel().tolist(),
        "quantiles_cpu_s": {str(q): float(np.quantile(times, q)) for q in (0.0, 0.5, 0.9, 0.99, 1.0)},
    }


def peers(frame: Frame, calibration: Calibration) -> dict[str, Any]:
    """The same frame through sep and photutils."""
    image = (frame.pixels - calibration.dark_adu).astype(np.float32)

    def with_sep() -> int:
        sky = sep.Background(image, bw=64, bh=64)
        return len(sep.extract(image - sky.back(), 1.5, err=sky.globalrms))

    sep.set_extract_pixstack(3_000_000)
    n_sep = with_sep()
    out: dict[str, Any] = {
        "sep_background_and_extract_cpu_s": figure([best_cpu_s(with_sep, 2)]),
        "sep_sources": figure([float(n_sep)]),
    }
    from photutils.background import Background2D
    from photutils.detection import DAOStarFinder

    start = time.process_time()
    sky = Background2D(image, 64)
    found = DAOStarFinder(threshold=5.0 * float(np.median(sky.background_rms)) * 0.6, fwhm=2.1)(image - sky.background)
    out["photutils_background_and_daofind_cpu_s"] = figure([time.process_time() - start])
    out["photutils_sources"] = figure([float(len(found))])
    return out


def star_figures(stars: StarList, truth: FrameTruth, noise_e: float) -> dict[str, Any]:
    """Completeness and centroids of truth stars without a neighbour of a hundredth of their light within 8 px."""
    t = truth.stars
    listed = cKDTree(np.column_stack((stars.row, stars.col)))
    distance, index = listed.query(np.column_stack((t["row"], t["col"])))
    near = cKDTree(np.column_stack((t["row"], t["col"]))).query_pairs(8.0, output_type="ndarray")
    alone = np.ones(len(t), dtype=bool)
    for a, b in ((near[:, 0], near[:, 1]), (near[:, 1], near[:, 0])):
        alone[a[t["flux_e"][b] > 0.01 * t["flux_e"][a]]] = False
    profile = axis_weights(0.0, -8, 17, 0.9)
    snr = t["flux_e"] * np.sum(profile**2) / noise_e
    clean = alone & (distance < 1.5) & (snr > 10) & (stars.flags[index] == 0)
    sharp = (stars.flags & StarFlag.COSMIC_LIKE) != 0
    out: dict[str, Any] = {
        "n_listed": figure([float(len(stars))]),
        "sharp_flagged": figure([float(sharp.sum())]),
        "isolated_completeness_snr8": {
            "value": float((distance < 1.5)[alone & (snr > 8)].mean()),
            "n": int((alone & (snr > 8)).sum()),
        },
        "completeness_snr8": {"value": float((distance < 1.5)[snr > 8].mean()), "n": int((snr > 8).sum())},
    }
    for axis in ("row", "col"):
        residual = (getattr(stars, axis)[index] - t[axis])[clean]
        ratio = residual / centroid_bounds(t["flux_e"][clean], noise_e)
        out[f"{axis}_robust_crlb_ratio"] = {"value": float(np.sqrt(np.median(ratio**2) / 0.4549)), "n": int(clean.sum())}
        out[f"{axis}_bias_px"] = {"value": float(np.median(residual)), "n": int(clean.sum())}
    return out


def centroid_bounds(flux_e: NDArray[np.float64], noise_e: float) -> NDArray[np.float64]:
    """Cramer-Rao bound of one coordinate by flux, interpolated; PSF of mid-field width, star in the middle of a pixel."""
    fluxes, step, sigma = np.geomspace(10.0, 1e6, 60), 1e-3, 0.9
    profile = axis_weights(0.0, -8, 17, sigma)
    slope = (axis_weights(step, -8, 17, sigma) - axis_weights(-step, -8, 17, sigma)) / (2 * step)
    bounds = [
        1.0 / math.sqrt(float(np.sum((f * np.outer(slope, profile)) ** 2 / (f * np.outer(profile, profile) + noise_e**2))))
        for f in fluxes
    ]
    return np.exp(np.interp(np.log(flux_e), np.log(fluxes), np.log(bounds)))


def captured_flux(rois: tuple[RoiGroup, ...], streak: NDArray[np.void], shape: tuple[int, int]) -> float:
    """Share of a truth streak's in-frame light inside the ROIs: light drawn as points around its path."""
    rng = np.random.default_rng(0)
    n = 20000
    at = rng.random(n) * (len(streak["path_row"]) - 1)
    nodes = np.arange(len(streak["path_row"]))
    sigma = math.hypot(float(streak["psf_sigma_px"]), 0.29)
    row = np.interp(at, nodes, streak["path_row"]) + rng.normal(0, sigma, n) + streak["defocus_px"] / 4 * rng.normal(0, 1, n)
    col = np.interp(at, nodes, streak["path_col"]) + rng.normal(0, sigma, n) + streak["defocus_px"] / 4 * rng.normal(0, 1, n)
    i, j = np.rint(row).astype(int), np.rint(col).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < shape[0]) & (j < shape[1])
    held = np.zeros(n, dtype=bool)
    for group in rois:
        for strip in group.strips:
            lines, width = strip.values_adu.shape
            major, minor = (i, j) if strip.axis == 0 else (j, i)
            line = major - strip.major0
            first = (strip.minor0_fp + line * strip.slope_fp) >> 16
            held |= (line >= 0) & (line < lines) & (minor >= first) & (minor < first + width)
    return float((held & inside).sum() / max(inside.sum(), 1))


def downlink_figures(results: list[OnboardResult], frames: list[tuple[Frame, FrameTruth]]) -> dict[str, Any]:
    """Reduction, bits by kind, captured flux of streaks that were found, what the budget dropped."""
    raw = frames[0][0].pixels.size * RAW_BITS / 8
    shape = frames[0][0].pixels.shape
    captured, n_found, n_snr8, n_detected, n_lost = [], 0, 0, 0, 0
    for result, (_, truth) in zip(results, frames, strict=True):
        for streak in truth.streaks[truth.streaks["snr"] >= 8]:
            share = captured_flux(result.rois, streak, shape)
            n_snr8 += 1
            if share >= 0.5 or detected(result.detections, streak):
                n_detected += 1
                n_lost += int(share < 0.5)
            if share >= 0.5:
                n_found += 1
                captured.append(share)
    kinds = {"header": 0x100, "stars": 0x101, "roi": 0x102, "background": 0x103, "thumbnail": 0x104}
    return {
        "reduction": figure([raw / len(r.packets) for r in results]),
        "total_reduction": {"value": raw * len(results) / sum(len(r.packets) for r in results), "n": len(results)},
        "bytes_per_frame": {name: figure([float(r.bytes_by_apid.get(a, 0)) for r in results]) for name, a in kinds.items()},
        "bits_per_star": figure([8.0 * r.bytes_by_apid[0x101] / max(r.housekeeping.n_stars_sent, 1) for r in results]),
        "bits_per_streak": figure([8.0 * r.bytes_by_apid.get(0x102, 0) / len(r.rois) for r in results if r.rois] or [0.0]),
        "captured_flux_fraction": figure(captured or [0.0]),
        "captured_flux_fraction_least": {"value": min(captured, default=0.0), "n": len(captured)},
        "completeness_snr8": {"value": n_found / max(n_snr8, 1), "n": n_snr8},
        "rois_per_frame": figure([float(len(r.rois)) for r in results]),
        "detected_but_lost_fraction": {"value": n_lost / max(n_detected, 1), "n": n_detected},
        "rois_dropped": figure([float(r.housekeeping.n_rois_dropped) for r in results]),
    }


def allocation_growth_mb(chain: OnboardChain, frame: Frame, n_frames: int) -> dict[str, Any]:
    """Growth of Python's and NumPy's allocations from the tenth to the last of many small frames."""
    state = chain.initial_state()
    tracemalloc.start()
    early = 0
    for number in range(n_frames):
        pixels = frame.pixels.copy()
        pixels[0, 0] += number % 7
        header = replace(frame.header, frame=number, t_start_tai_ns=frame.header.t_start_tai_ns + number * 250_000_000)
        state, _ = chain.process(state, Frame(header=header, pixels=pixels))
        if number == min(10, n_frames // 2):
            early = tracemalloc.get_traced_memory()[0]
    late = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return {"value": (late - early) / 1e6, "n": n_frames}


def sizing(detector: Callable[[], Detector], frames: list[tuple[Frame, FrameTruth]], calibration: Calibration) -> dict[str, Any]:
    """Memory that the chain with its calibration allocates, per frame and per Mpx, beside the frame itself."""
    tracemalloc.start()
    chain = chain_of(detector(), calibration)
    state = chain.initial_state()
    for frame, _ in frames[:3]:
        state, _ = chain.process(state, frame)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    mpx = frames[0][0].pixels.size / 1e6
    return {"peak_allocated_mb": {"value": peak / 1e6, "n": 3}, "peak_allocated_mb_per_mpx": {"value": peak / 1e6 / mpx, "n": 3}}


def clock_hz() -> float | None:
    """Clock of the first processor, for sizing others by cycles (Linux on x86); None where it is not told."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return 1e6 * float(next(line for line in lines if line.startswith("cpu MHz")).split(":")[1])
    except (OSError, StopIteration, ValueError):
        return None


def detected(detections: tuple[Detection, ...], streak: NDArray[np.void]) -> bool:
    """Whether some detection lies on a truth streak: both ends within 12 px of its path and half of its length covered."""
    path = np.column_stack((streak["path_row"], streak["path_col"]))
    length = float(np.hypot(*np.diff(path, axis=0).T).sum())
    share = np.linspace(0.0, 1.0, 200) * (len(path) - 1)
    fine = np.column_stack([np.interp(share, np.arange(len(path)), path[:, k]) for k in (0, 1)])
    for d in detections:
        ends = np.array([[d.row0, d.col0], [d.row1, d.col1]])
        if np.hypot(*(fine[:, None] - ends).transpose(2, 0, 1)).min(axis=0).max() < 12.0 and d.length_px > 0.5 * length - 12.0:
            return True
    return False


def storm(hits: int, n_frames: int) -> dict[str, Any]:
    """The default chain in a particle storm of about so many hits per frame: what is sent, found, and lost to the budget."""
    options = SimulatorOptions()
    peak = options.radiation.saa_peak_omni_cm2_s * hits / SAA_PEAK_HITS
    radiation = replace(options.radiation, environment="saa", saa_peak_omni_cm2_s=peak)
    simulator = Simulator(replace(options, radiation=radiation), seed=5, catalogue=StarCatalogue.embedded())
    frames = [simulator.frame(number) for number in range(n_frames)]
    results, times, _ = timed_run(chain_of(LineIntegralDetector(), simulator.calibration()), frames)
    sent = downlink_figures(results, frames)
    names = ("total_reduction", "completeness_snr8", "detected_but_lost_fraction", "rois_per_frame", "rois_dropped")
    return {
        "hits": figure([float(len(truth.cosmics)) for _, truth in frames]),
        "detections": figure([float(len(r.detections)) for r in results]),
        "cpu_s_per_frame": figure(list(times.mean(axis=0))),
        **{name: sent[name] for name in names},
    }


def process_memory(frames: list[tuple[Frame, FrameTruth]], calibration: Calibration) -> dict[str, Any]:
    """Resident memory of the on-board software alone in a process, by stage, with each detector.

    The floor is the interpreter with its compiler and libraries; a flight build without them has the rest.
    """
    out: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "calibration.pickle").write_bytes(pickle.dumps(calibration))
        (folder / "camera.pickle").write_bytes(pickle.dumps(calibration.camera))
        for number, (frame, _) in enumerate(frames[:4]):
            (folder / f"{number}.pickle").write_bytes(pickle.dumps(frame))
        for detector in ("none", "threshold", "line_integral"):
            command = [sys.executable, "-m", onboard_process.__name__, name, detector]
            environment = {**os.environ, **onboard_process.ENVIRONMENT}
            done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
            stages = json.loads(done.stdout)
            del stages["cpu_s_per_frame"], stages["peaks"]
            mpx = frames[0][0].pixels.size / 1e6
            stages["peak_above_libraries_and_kernels"] = stages["peak"] - stages["libraries_and_kernels"]
            out[detector] = {f"{stage}_rss_mb": {"value": value, "n": len(frames[:4])} for stage, value in stages.items()}
            own = stages["peak_above_libraries_and_kernels"] / mpx
            out[detector]["peak_above_libraries_and_kernels_rss_mb_per_mpx"] = {"value": own, "n": len(frames[:4])}
    return out


def cropped(frame: Frame, calibration: Calibration, side: int) -> tuple[OnboardChain, Frame]:
    """A chain and a frame of the first `side` rows and cols."""
    header = replace(frame.header, rows=side, cols=side)
    return chain_of(NoDetector(), calibration), Frame(header=header, pixels=frame.pixels[:side, :side].copy())


def main(quick: bool = False) -> dict[str, Any]:
    """All on-board figures."""
    n_frames = 3 if quick else 8
    simulator = Simulator(SimulatorOptions(), seed=5, catalogue=StarCatalogue.embedded())
    calibration = simulator.calibration()
    frames = [simulator.frame(number) for number in range(n_frames)]
    out: dict[str, Any] = {}
    bare, bare_times, cold = timed_run(chain_of(NoDetector(), calibration), frames)
    out["chain_without_detector"] = {**spread(bare_times), "first_frame_cpu_s": figure([cold])}
    detectors: dict[str, Callable[[], Detector]] = {"threshold": ThresholdDetector, "line_integral": LineIntegralDetector}
    for name, detector in detectors.items():
        results, times, cold = timed_run(chain_of(detector(), calibration), frames)
        out[f"chain_{name}"] = {**spread(times), "first_frame_cpu_s": figure([cold])}
        if name == "line_integral":
            out["downlink"] = downlink_figures(results, frames)
            stream = b"".join(result.packets for result in results)
            out["ingest_cpu_s_per_frame"] = figure(
                [best_cpu_s(lambda: decode_downlink(stream, [PlanesDecoder()])) / n_frames]  # noqa: B023 - called at once
            )
    out["peers"] = peers(frames[0][0], calibration)
    own, his = (
        out["chain_without_detector"]["cpu_s_per_frame"]["value"],
        out["peers"]["sep_background_and_extract_cpu_s"]["value"],
    )
    out["speedup_over_sep"] = {"value": his / own, "n": n_frames - 1}
    out["stars"] = star_figures(bare[0].stars, frames[0][1], float(frames[0][1].frame["noise_e"][0]))
    out["process"] = process_memory(frames, calibration)
    out["memory_without_detector"] = sizing(NoDetector, frames, calibration)
    out["memory_line_integral"] = sizing(LineIntegralDetector, frames, calibration)
    for name in ("chain_without_detector", *(f"chain_{detector}" for detector in detectors)):
        per_mpx_ms = 1e3 * out[name]["cpu_s_per_frame"]["value"] / (frames[0][0].pixels.size / 1e6)
        out[name]["cpu_ms_per_mpx"] = {"value": per_mpx_ms, "n": n_frames - 1}
        if clock_hz() is not None:
            out[name]["cycles_per_px"] = {"value": 1e-9 * per_mpx_ms * clock_hz(), "n": n_frames - 1}
    if not quick:
        out["storm"] = {f"{hits}_hits": storm(hits, 3) for hits in STORM_HITS}
    corner = cropped(frames[0][0], calibration, 512)
    out["allocation_growth_mb"] = allocation_growth_mb(*corner, 100 if quick else 1000)
    return out


if __name__ == "__main__":
    print(json.dumps(main(), indent=2))  # noqa: T201 - the script's result
