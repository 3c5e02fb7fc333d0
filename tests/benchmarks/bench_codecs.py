"""Codec figures: bits per pixel over the entropy bound, speed, damage of the near-lossless codec; peers in the same run.

Frames come from the simulator's default scenario (their truth has the entropy given the noise-free image) and, for blocks,
from noise of the same statistics. Times are process CPU seconds of one thread, best of three.
"""

import json
import math
import time
from collections.abc import Callable
from typing import Any

import imagecodecs
import numpy as np
import zstandard
from numpy.typing import NDArray
from scipy.stats import norm

from ground.ingest.codecs import PlanesDecoder, SqrtPlanesDecoder
from ground.ingest.rans import RansDecoder
from onboard.downlink.codec import Ccsds121Codec, PlanesCodec, RansCodec, SqrtPlanesCodec
from onboard.downlink.whole_frame import frame_payloads
from onboard.image.background import MeshBackground
from onboard.image.calibrate import IntegerCalibration, to_counts
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.frame import Calibration, Frame
from sboc_e2e.icd.layout import CRC, HEADER_BYTES, STRIP
from sboc_e2e.icd.steps import Decoder, Encoder
from simulator.chain import Simulator
from simulator.options import SimulatorOptions

SIGMA_ADU = 2.37
BLOCK_PX = 1 << 16
CONTEXTS = (-1.5, 1.5, 2.5, 4.0, 6.0, 10.0, 20.0, 50.0, 200.0)
"""Weighted mean of the neighbours above and to the left, ADU above the level, that part pixels into classes."""


def figure(values: list[float]) -> dict[str, Any]:
    """Mean with its standard error as a 90 % interval."""
    data = np.asarray(values, dtype=float)
    half = 1.645 * float(data.std(ddof=1)) / math.sqrt(len(data)) if len(data) > 1 else 0.0
    mean = float(data.mean())
    return {"value": mean, "n": len(data), "low": mean - half, "high": mean + half}


def best_cpu_s(call: Callable[[], object], repeats: int = 3) -> float:
    """Shortest process CPU time of some calls, after one that is not counted."""
    call()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def entropy_bits(sigma: float) -> float:
    """Entropy of a rounded Gaussian, averaged over where its mean falls."""
    edges = np.arange(-60, 62) - 0.5
    total = 0.0
    for phase in (np.arange(32) + 0.5) / 32:
        p = np.diff(norm.cdf(edges, phase, sigma))
        total -= float(np.sum(p[p > 0] * np.log2(p[p > 0]))) / 32
    return total


def noise(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.int32]:
    """Rounded Gaussian sky."""
    return rng.normal(100.0 + rng.random(), SIGMA_ADU, shape).round().astype(np.int32)


def order_zero_bits(values: NDArray[np.int32]) -> float:
    """Entropy per pixel of the values' own histogram: no code that treats all pixels alike needs less."""
    counts = np.bincount(values.ravel() - values.min())
    share = counts[counts > 0] / values.size
    return -float(np.sum(share * np.log2(share)))


def floors(values: NDArray[np.int32], level: int, entropy: float) -> dict[str, float]:
    """What coders that know no star could reach at best, over the bound that knows every star's light.

    All pixels alike; and each pixel by how bright its neighbours above and to the left are, in `CONTEXTS` classes with ideal
    codes that cost nothing to send (the entropy of a context model; Rissanen & Langdon 1981, IEEE Trans. Inf. Theory 27, 12).
    """
    above = (values - level).astype(np.float32)
    near = np.zeros_like(above)
    near[1:, 1:-1] = (2.0 * above[:-1, 1:-1] + 2.0 * above[1:, :-2] + above[:-1, :-2] + above[:-1, 2:]) / 6.0
    kind = np.digitize(near, CONTEXTS)
    parts = [values[kind == k] for k in range(len(CONTEXTS) + 1)]
    by_context = sum(order_zero_bits(part) * part.size for part in parts if part.size) / values.size
    return {
        "no_context": order_zero_bits(values) / entropy,
        "context": by_context / entropy,
        "star_share": float(np.mean(kind > 2)),
    }


def whole_frames(
    frames: list[tuple[Frame, float]], calibration: Calibration, encoder: Encoder, decoder: Decoder
) -> dict[str, Any]:
    """Lossless whole frames: the codec on blocks of 64 kpx, and in packets with every header; entropy from truth."""
    dark = IntegerCalibration.of(calibration)
    blocks, packets, speeds, decode_speeds, exact, over_zstd = [], [], [], [], [], []
    for frame, entropy in frames:
        counts = to_counts(frame, dark)
        values = frame.pixels.astype(np.int32) - dark.dark.whole_adu()
        level = int(np.median(values))
        rows = BLOCK_PX // values.shape[1]
        parts = [values[k : k + rows] for k in range(0, len(values), rows)]

        def encode(parts: list[NDArray[np.int32]] = parts, level: int = level) -> list[bytes]:
            return [encoder.encode(part, level_adu=level, sigma_adu=SIGMA_ADU) for part in parts]

        coded = encode()
        blocks.append(8.0 * sum(map(len, coded)) / values.size / entropy)
        encode_s = best_cpu_s(encode)
        speeds.append(frame.pixels.nbytes / encode_s / 1e6)
        zstd = zstandard.ZstdCompressor(level=1)
        raw = [frame.pixels[k : k + rows].tobytes() for k in range(0, len(values), rows)]
        over_zstd.append(best_cpu_s(lambda raw=raw, zstd=zstd: [zstd.compress(part) for part in raw]) / encode_s)  # type: ignore[misc]

        def decode(
            coded: list[bytes] = coded, parts: list[NDArray[np.int32]] = parts, level: int = level
        ) -> list[NDArray[np.int32]]:
            pairs = zip(coded, parts, strict=True)
            return [np.asarray(decoder.decode(c, p.shape, level_adu=level, sigma_adu=SIGMA_ADU)) for c, p in pairs]

        decode_speeds.append(frame.pixels.nbytes / best_cpu_s(decode) / 1e6)
        exact.append(all((a == b).all() for a, b in zip(decode(), parts, strict=True)))
        background = MeshBackground().estimate(counts.pixels, counts.dark.whole_adu(), counts.defects)
        payloads = frame_payloads(counts, background, encoder)
        size = sum(len(payload) + HEADER_BYTES + CRC.size for payload in payloads)
        packets.append(8.0 * size / values.size / entropy)
    frame, _ = frames[0]
    counts = to_counts(frame, dark)
    background = MeshBackground().estimate(counts.pixels, counts.dark.whole_adu(), counts.defects)
    packet_s = best_cpu_s(lambda: frame_payloads(counts, background, encoder))
    return {
        "bits_over_entropy_ratio": figure(blocks),
        "bits_in_packets_over_entropy_ratio": figure(packets),
        "encode_mb_s": figure(speeds),
        "encode_speedup_over_zstd1": figure(over_zstd),
        "decode_mb_s": figure(decode_speeds),
        "encode_into_packets_mb_s": figure([frame.pixels.nbytes / packet_s / 1e6]),
        "lossless_bit_exact": figure([float(e) for e in exact]),
    }


def bounds(frames: list[tuple[Frame, float]], calibration: Calibration) -> dict[str, Any]:
    """Entropy from truth, and what coders that know no star could reach."""
    dark = IntegerCalibration.of(calibration)
    least = []
    for frame, entropy in frames:
        values = frame.pixels.astype(np.int32) - dark.dark.whole_adu()
        least.append(floors(values, int(np.median(values)), entropy))
    return {
        "entropy_bits": figure([entropy for _, entropy in frames]),
        "best_without_context_over_entropy_ratio": figure([f["no_context"] for f in least]),
        "best_with_context_over_entropy_ratio": figure([f["context"] for f in least]),
        "pixels_beside_stars_fraction": figure([f["star_share"] for f in least]),
    }


def roi_blocks(n: int) -> dict[str, Any]:
    """64 x 64 px of sky, strip header counted; CCSDS 121, JPEG-LS and JPEG XL beside it."""
    rng = np.random.default_rng(1)
    entropy = entropy_bits(SIGMA_ADU)
    results: dict[str, list[float]] = {"planes": [], "rans": [], "ccsds121": [], "jpegls": [], "jpegxl": []}
    times: dict[str, list[float]] = {name: [] for name in results}
    for _ in range(n):
        values = noise(rng, (64, 64))
        level = int(np.median(values))
        coders: dict[str, Callable[[], bytes]] = {
            "planes": lambda v=values, m=level: PlanesCodec().encode(v, level_adu=m, sigma_adu=SIGMA_ADU),  # type: ignore[misc]
            "rans": lambda v=values, m=level: RansCodec().encode(v, level_adu=m, sigma_adu=SIGMA_ADU),  # type: ignore[misc]
            "ccsds121": lambda v=values, m=level: Ccsds121Codec().encode(v, level_adu=m, sigma_adu=SIGMA_ADU),  # type: ignore[misc]
            "jpegls": lambda v=values: imagecodecs.jpegls_encode(v.astype(np.uint16)),  # type: ignore[misc]
            "jpegxl": lambda v=values: imagecodecs.jpegxl_encode(v.astype(np.uint16), lossless=True),  # type: ignore[misc]
        }
        for name, coder in coders.items():
            start = time.process_time()
            size = len(coder())
            times[name].append(time.process_time() - start)
            results[name].append(8.0 * (size + STRIP.size) / values.size / entropy)
    out: dict[str, Any] = {f"{name}_bits_over_entropy_ratio": figure(ratios) for name, ratios in results.items()}
    out.update({f"{name}_cpu_ms": figure([1e3 * t for t in sorted(spent)[: n // 2]]) for name, spent in times.items()})
    return out


def near_lossless(n: int) -> dict[str, Any]:
    """Step of 2 ADU: bits, noise, bias, and what it does to photometry with the PSF."""
    rng = np.random.default_rng(2)
    encoder, decoder = SqrtPlanesCodec(), SqrtPlanesDecoder()
    offsets = np.arange(-4, 5)
    psf = np.exp(-0.5 * (offsets[:, None] ** 2 + offsets**2) / (0.849**2 + 1 / 12))
    bits, growth, bias, photometry = [], [], [], []
    for _ in range(n):
        values = noise(rng, (512, 128))
        level = int(np.median(values))
        block = encoder.encode(values, level_adu=level, sigma_adu=SIGMA_ADU)
        back = decoder.decode(block, values.shape, level_adu=level, sigma_adu=SIGMA_ADU)
        error = back - values
        bits.append(8.0 * len(block) / values.size)
        growth.append(100.0 * (math.sqrt(1.0 + float(error.var()) / SIGMA_ADU**2) - 1.0))
        bias.append(float(error.mean()) / SIGMA_ADU)
        sums = [
            np.einsum("abcd,bd->ac", a[:504, :126].reshape(56, 9, 14, 9), psf) for a in (values.astype(float), back.astype(float))
        ]
        photometry.append(100.0 * (float(sums[1].std() / sums[0].std()) - 1.0))
    return {
        "bits": figure(bits),
        "noise_growth_percent": figure(growth),
        "photometry_error_growth_percent": figure(photometry),
        "bias_sigma": figure(bias),
        "entropy_bits_of_codes": figure([entropy_bits(SIGMA_ADU / 2.0)]),
    }


def main(quick: bool = False) -> dict[str, Any]:
    """All codec figures."""
    simulator = Simulator(SimulatorOptions(), seed=11, catalogue=StarCatalogue.embedded())
    frames = []
    for number in range(1 if quick else 4):
        frame, truth = simulator.frame(number)
        frames.append((frame, float(truth.frame["entropy_bits"][0])))
    n = 50 if quick else 400
    return {
        "whole_frame": {
            **bounds(frames, simulator.calibration()),
            **whole_frames(frames, simulator.calibration(), PlanesCodec(), PlanesDecoder()),
        },
        "whole_frame_rans": whole_frames(frames, simulator.calibration(), RansCodec(), RansDecoder()),
        "roi_64x64": roi_blocks(n),
        "near_lossless": near_lossless(max(4, n // 20)),
    }


if __name__ == "__main__":
    print(json.dumps(main(), indent=2))  # noqa: T201 - the script's result
