"""Golden vectors of the on-board stages: what goes into each, and what comes out, to the bit.

``python -m sboc_e2e.bench.flight_vectors tests/golden/flight`` writes them anew, one file for each stage: arrays ``in_*`` and
``out_*`` of NumPy's npz format, without pickled objects. A test holds the stages to the stored ones; who ports a stage does the
same. The inputs of a stage are stored with it, so that each can be ported and tried alone.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain, OnboardSteps
from onboard.detect import LineIntegralDetector, whiten
from onboard.detect.line_integral import dyadic
from onboard.detect.line_integral.kept_frame import encode
from onboard.downlink.codec import RansCodec
from onboard.image.background import MeshBackground
from onboard.image.calibrate import Counts, IntegerCalibration, fill_residual, to_counts
from onboard.latency import FrameSequence
from onboard.options import OnboardOptions
from onboard.stars.matched import MatchedStars
from sboc_e2e.icd.frame import Calibration, Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList

SIDE: Final = 80  # Side (px) of the frames: no multiple of the mesh's 64 px, so that cut tiles occur; all vectors are 240 kB.
PSF_PX: Final = 0.85  # PSF sigma (px): the 2 px FWHM of the preset `sboc_like`, 2 / 2.3548. Changing it changes every vector.
GAIN_E_ADU: Final = 1.2  # Of the preset `sboc_like`, high gain.
READ_NOISE_E: Final = 2.3  # Of the preset `sboc_like`.
SATURATION_ADU: Final = 4095  # Largest number of a 12-bit converter, as in `sboc_like`: 2**12 - 1.
CLIP_SIGMA: Final = 7.5  # As `POINT_CLIP_SIGMA` of `onboard.detect.line_integral.star_removal`.
COARSE_SIGMA: Final = 4.5  # Default of the option "S/N on the coarse lattice worth refining" of the line-integral detector.

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A stage. arithmetic : of its values, with their range where it is integer. run : its inputs to its outputs, by name."""

    name: str
    module: str
    arithmetic: str
    run: Callable[[Arrays], Arrays]


def header(number: int) -> FrameHeader:
    """Header of a frame, four a second."""
    return FrameHeader(
        frame=number, t_start_tai_ns=2_000_000_000_000_000_000 + number * 250_000_000, exposure_ns=200_000_000,
        line_time_ns=10_000, rows=SIDE, cols=SIDE, gain_e_adu=GAIN_E_ADU, read_noise_e=READ_NOISE_E,
        saturation_adu=float(SATURATION_ADU),
    )  # fmt: skip


def calibration(given: Arrays) -> Calibration:
    """Dark and defects as stored, a flat of one."""
    camera = NominalCamera(
        name="vectors", rows=SIDE, cols=SIDE, focal_px=44444.0, center_row=(SIDE - 1) / 2, center_col=(SIDE - 1) / 2,
        psf_sigma_px=PSF_PX, gain_e_adu=GAIN_E_ADU, read_noise_e=READ_NOISE_E, saturation_adu=float(SATURATION_ADU),
        full_well_e=4800.0, zero_point_e_s=4.7e8, aperture_m=0.2,
    )  # fmt: skip
    flat = np.ones((SIDE, SIDE), np.float32)
    return Calibration(camera=camera, dark_adu=given["dark_adu"], flat=flat, defects=given["defects"])


def counts_of(given: Arrays) -> Counts:
    """Counts of a frame over its dark; the mask is a copy."""
    frame = Frame(header=header(0), pixels=given["pixels"])
    return to_counts(frame, IntegerCalibration.of(calibration(given)).window(frame.header))


def _counts(given: Arrays) -> Arrays:
    counts = counts_of(given)
    dark = counts.dark.whole_adu(np.empty((SIDE, SIDE), np.int16))
    return {"dark_counts": dark, "mask": counts.defects, "saturation": np.array(counts.saturation)}


def _background(given: Arrays) -> Arrays:
    mesh = MeshBackground().estimate(given["pixels"], given["dark_counts"], given["mask"])
    return {"level": mesh.level_adu, "sigma": mesh.sigma_adu, "tile_px": np.array(mesh.tile_px)}


def _mesh(given: Arrays) -> BackgroundModel:
    return BackgroundModel(level_adu=given["level"], sigma_adu=given["sigma"], tile_px=int(given["tile_px"]))


def _residual(given: Arrays) -> Arrays:
    counts, residual = counts_of(given), np.empty((SIDE, SIDE), np.float32)
    sums, n_masked = fill_residual(counts, _mesh(given), residual)
    lines: Arrays = {"row_sums": sums.rows, "col_sums": sums.cols}
    return lines | {"residual_adu": residual, "mask": counts.defects, "n_masked": np.array(n_masked)}


def _stars(given: Arrays) -> Arrays:
    view = DetectorView(
        header=header(0), residual_adu=given["residual_adu"], background=_mesh(given), mask=given["mask"], stars=StarList.empty(),
        psf_sigma_px=PSF_PX,
    )  # fmt: skip
    stars = MatchedStars().extract(view)
    return {"row": stars.row, "col": stars.col, "flux_e": stars.flux_e, "snr": stars.snr, "flags": stars.flags}


def _codes(given: Arrays) -> Arrays:
    return {"codes": whiten.quantise(given["residual_adu"], given["mask"], given["sigma"], int(given["tile_px"]))}


def _kept(given: Arrays) -> Arrays:
    codes = np.empty((SIDE, SIDE), np.int8)
    first, column, value = encode(given["residual_adu"], given["mask"], given["sigma"], int(given["tile_px"]), codes)
    return {"codes": codes, "first": first, "column": column, "value": value}


def _smooth(given: Arrays) -> Arrays:
    return {"smooth": whiten.smooth(given["codes"], given["level"], SIDE, given["taps"], CLIP_SIGMA)}


def _binned(given: Arrays) -> Arrays:
    return {"binned": whiten.smooth_binned(given["codes"], given["level"], SIDE, given["taps"], CLIP_SIGMA)}


def _lines(given: Arrays) -> Arrays:
    found, _ = dyadic.coarse_segments(given["binned"].copy(), given["noise"], COARSE_SIGMA, 4, 1000)
    return {"candidates": found}


def _coded(given: Arrays) -> Arrays:
    data = RansCodec().encode(given["values"], level_adu=int(given["level"]), sigma_adu=float(given["sigma"]))
    return {"bytes": np.frombuffer(data, np.uint8)}


def _packets(given: Arrays) -> Arrays:
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=LineIntegralDetector(), codec=RansCodec()
    )
    maps = calibration(given)
    chain = OnboardChain(OnboardOptions(), steps, calibration=maps, camera=maps.camera, run_id=1)
    sequence = FrameSequence(chain=chain, state=chain.initial_state())
    results = [r for k, pixels in enumerate(given["pixels"]) for r in sequence.take(Frame(header=header(k), pixels=pixels))]
    results += sequence.flush()
    table = [(k, d.row0, d.col0, d.row1, d.col1, d.snr, d.flags) for k, r in enumerate(results) for d in r.detections]
    packets = np.frombuffer(b"".join(r.packets for r in results), np.uint8)
    return {"detections": np.array(table, np.float64).reshape(-1, 7), "packets": packets}


STAGES: Final = (
    Stage(name="counts", module="image/calibrate", run=_counts,
          arithmetic="integer: pixels 0 to 65,535 (uint16), dark rounded to counts (int16), mask bits (uint8)"),
    Stage(name="background", module="image/background", run=_background,
          arithmetic="integer histograms of counts (int32); moments in float64, mesh in float32"),
    Stage(name="residual", module="image/calibrate", run=_residual,
          arithmetic="counts less dark in integers, in 1/128 ADU; level interpolated and subtracted in float32"),
    Stage(name="stars", module="stars/matched", run=_stars, arithmetic="float32 sums, fits in float64"),
    Stage(name="codes", module="detect/whiten", run=_codes,
          arithmetic="one product in float32, rounded to int8: sigma/16, -127 to 127"),
    Stage(name="kept", module="detect/line_integral/kept_frame", run=_kept,
          arithmetic="int8 as before, -128 unknown; what lies beyond in a table of float32"),
    Stage(name="smooth", module="detect/whiten", run=_smooth,
          arithmetic="int8 x int16 taps: int16 along columns, int32 along rows; scaled in float32, rounded to int8"),
    Stage(name="binned", module="detect/whiten", run=_binned,
          arithmetic="as before, to int16"),
    Stage(name="lines", module="detect/line_integral/dyadic", run=_lines,
          arithmetic="integer sums in int16, halved after 64 and 512 rows; S/N of what is above the threshold in float32"),
    Stage(name="coded", module="downlink/codec/rans", run=_coded,
          arithmetic="integer: values int32, coder states below 2^32 in int64, 16-bit words; tables from float64"),
    Stage(name="packets", module="chain", run=_packets, arithmetic="all of these; fits of trails in float64; bytes"),
)  # fmt: skip


def exposures() -> tuple[NDArray[np.uint16], NDArray[np.float32], NDArray[np.uint8]]:
    """Two frames with stars and, in each, a trail at a place of its own; their dark and defects."""
    rng = np.random.default_rng(2026)
    rows, cols = np.mgrid[:SIDE, :SIDE].astype(np.float64)
    sky = np.full((SIDE, SIDE), 6.0)
    for flux_e in np.geomspace(150.0, 12000.0, 24):
        row, col = rng.uniform(4.0, SIDE - 4.0, 2)
        light = np.exp(-0.5 * ((rows - row) ** 2 + (cols - col) ** 2) / PSF_PX**2)
        sky += flux_e * light / light.sum()
    dark = (100.0 + rng.normal(0.0, 1.0, (SIDE, SIDE))).astype(np.float32)
    defects = np.zeros((SIDE, SIDE), np.uint8)
    defects[17, 40:44] = 1
    pixels = np.empty((2, SIDE, SIDE), np.uint16)
    for number in range(2):
        across = (rows - 30.0 - 30.0 * number) * np.cos(0.4) - (cols - 40.0) * np.sin(0.4)
        along = (rows - 30.0 - 30.0 * number) * np.sin(0.4) + (cols - 40.0) * np.cos(0.4)
        mean = sky + 12.0 * np.exp(-0.5 * (across / PSF_PX) ** 2) * (np.abs(along) < 24.0)
        noisy = (rng.poisson(mean) + rng.normal(0.0, READ_NOISE_E, sky.shape)) / GAIN_E_ADU + dark
        pixels[number] = np.clip(np.rint(noisy), 0, SATURATION_ADU)
    return pixels, dark, defects


def vectors() -> dict[str, tuple[Arrays, Arrays]]:
    """Inputs and outputs of each stage, each fed with what those before it gave."""
    pixels, dark, defects = exposures()
    raw: Arrays = {"pixels": pixels[0], "dark_adu": dark, "defects": defects}
    made: dict[str, tuple[Arrays, Arrays]] = {}
    stages = {stage.name: stage for stage in STAGES}

    def of(name: str, given: Arrays) -> Arrays:
        made[name] = (given, stages[name].run(given))
        return made[name][1]

    counts = of("counts", raw)
    mesh = of("background", {"pixels": pixels[0], "dark_counts": counts["dark_counts"], "mask": counts["mask"]})
    residual = of("residual", {**raw, **mesh})
    view = {"residual_adu": residual["residual_adu"], "mask": residual["mask"]}
    of("stars", {**view, **mesh})
    scaled = {**view, "sigma": mesh["sigma"], "tile_px": mesh["tile_px"]}
    codes = of("codes", scaled)["codes"]
    of("kept", scaled)
    flat = np.zeros((1, 1), np.float32)
    of("smooth", {"codes": codes, "level": flat, "taps": whiten.odd_taps(PSF_PX)})
    taps = whiten.even_taps(PSF_PX)
    binned = of("binned", {"codes": codes, "level": flat, "taps": taps})["binned"]
    of("lines", {"binned": binned, "noise": dyadic.half_resolution_noise(taps, 1.0)})
    values = (pixels[0, :32].astype(np.int32) - counts["dark_counts"][:32]).astype(np.int32)
    of("coded", {"values": values, "level": np.array(5), "sigma": np.array(2.8)})
    of("packets", {"pixels": pixels, "dark_adu": dark, "defects": defects})
    return made


def write(folder: Path) -> None:
    """A file for each stage."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (given, gives) in vectors().items():
        named = {f"in_{key}": value for key, value in given.items()} | {f"out_{key}": value for key, value in gives.items()}
        np.savez_compressed(folder / f"{name}.npz", allow_pickle=False, **named)


def read(path: Path) -> tuple[Arrays, Arrays]:
    """Inputs and outputs in a file."""
    with np.load(path, allow_pickle=False) as stored:
        given, gives = ({k[len(p) :]: stored[k] for k in stored.files if k.startswith(p)} for p in ("in_", "out_"))
    return given, gives


def table() -> str:
    """The stages, for the flight page."""
    lines = ["| file | `onboard/` | arithmetic |", "|---|---|---|"]
    lines += [f"| `{stage.name}.npz` | `{stage.module}` | {stage.arithmetic} |" for stage in STAGES]
    return "\n".join(lines)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.bench.flight_vectors", description="Write the golden vectors.")
    parser.add_argument("folder", type=Path, help="tests/golden/flight")
    write(parser.parse_args().folder)
