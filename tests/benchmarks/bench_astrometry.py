"""Astrometry and photometry of the ground segment, measured on star lists that it did not make.

`main(quick)` measures: catalogue speed, camera solution (bias, rms, cost) for good and for bad telemetry, zero
point, and the rest of the published direction against brute force. Run it alone to print them as JSON.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

if __package__ in (None, ""):  # run as a script: the project's root holds the packages
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from ground.astrometry.astrometer import CameraFit
from ground.astrometry.lost_in_space import installed
from ground.photometry.zero_point import ZeroPoint
from ground.sky.pixel_sky import SolvedSky, row_mid_exposure_tai_ns
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.score.figures import bootstrap
from tests.astrometry.star_fields import ARCSEC, Field, FieldOptions, grid, make_field

CASES = {
    "250_stars": FieldOptions(n_stars=250),
    "100_stars": FieldOptions(n_stars=100),
    "30_stars": FieldOptions(n_stars=30),
    "pointing_off_900_arcsec": FieldOptions(n_stars=250, pointing_error_arcsec=900.0),
    "40_percent_false": FieldOptions(n_stars=250, false=0.4),
    "perfect_catalogue": FieldOptions(n_stars=250, displaced=False),
    "512_pixels": FieldOptions(n_stars=200, size=512, focal_px=5555.5),
}


def main(quick: bool = False) -> dict[str, object]:
    """All measurements; `quick` takes fewer frames."""
    catalogue = StarCatalogue.embedded()
    n_frames = 8 if quick else 40
    result: dict[str, object] = {"cone_search_4_deg_ms": _cone_ms(catalogue, 50 if quick else 500)}
    result["camera"] = {name: _solutions(catalogue, options, n_frames) for name, options in CASES.items()}
    result["shared_over_a_run"] = _run(catalogue, n_frames)
    if installed():
        result["lost_in_space"] = _lost(catalogue, 5 if quick else 30)
    return result


def _cone_ms(catalogue: StarCatalogue, n: int) -> float:
    """CPU time of a cone search of 4 deg radius, anywhere on the sky."""
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0.0, 360.0, n), np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, n)))
    start = time.process_time()
    for a, d in zip(ra, dec, strict=True):
        catalogue.cone(float(a), float(d), 4.0, epoch_jyear=2027.08)
    return 1e3 * (time.process_time() - start) / n


def mean(values: np.ndarray) -> float:
    """Mean of all."""
    return float(values.mean())


def root_mean(squares: np.ndarray) -> float:
    """Root of the mean of squares."""
    return float(np.sqrt(squares.mean()))


def _errors_arcsec(field: Field, solution) -> np.ndarray:
    """Solved minus true apparent directions on the 9 x 9 grid, (81, 2): along camera X and Y."""
    row, col = grid(field.frame.header.rows)
    got = SolvedSky(header=field.frame.header, solution=solution).apparent(
        row, col, row_mid_exposure_tai_ns(field.frame.header, row)
    )
    return ((got - field.true_directions(row, col)) @ field.matrix.T)[:, :2] / ARCSEC


def _solutions(catalogue: StarCatalogue, options: FieldOptions, n_frames: int) -> dict[str, Any]:
    """Each frame solved alone, from the nominal camera; the catalogue's errors are drawn anew each time."""
    fit, photometer = CameraFit(lost_in_space="never"), ZeroPoint()
    errors, cpu, zero, solved = [], [], [], 0
    for seed in range(n_frames):
        field = make_field(catalogue, seed, replace(options, catalogue_seed=1000 + seed))
        state = fit.initial_state(field.calibration, catalogue)
        start = time.process_time()
        _, solution = fit.solve(state, field.frame)
        cpu.append(time.process_time() - start)
        if solution.flags & FrameFlag.NO_SOLUTION:
            continue
        solved += 1
        errors.append(_errors_arcsec(field, solution))
        zero.append(photometer.calibrate(field.frame, solution, field.calibration).zero_point_mag - options.zero_point_mag)
    error = np.array(errors)
    distance2 = np.sum(error**2, axis=2)
    return {
        "n_frames": n_frames,
        "solved": solved,
        # Frames are independent, points of one frame are not: intervals resample frames.
        "grid_rms_arcsec": bootstrap(distance2, root_mean),
        "corner_rms_arcsec": bootstrap(distance2[:, [0, 8, 72, 80]], root_mean),
        "centre_rms_arcsec": bootstrap(distance2[:, 40], root_mean),
        "bias_x_arcsec": bootstrap(error[:, :, 0], mean),
        "bias_y_arcsec": bootstrap(error[:, :, 1], mean),
        "zero_point_bias_mag": bootstrap(zero, mean),
        "zero_point_rms_mag": bootstrap(np.square(zero), root_mean),
        "cpu_ms": 1e3 * float(np.median(cpu)),
    }


def _run(catalogue: StarCatalogue, n_frames: int) -> dict[str, Any]:
    """Forty poor stars a frame, one camera: what learning the distortion over the run gains."""
    fit = CameraFit(lost_in_space="never")
    options = FieldOptions(n_stars=40, centroid_scale=3.0)
    state, alone, together = None, [], []
    for seed in range(n_frames):
        field = make_field(catalogue, seed, options)
        fresh = fit.initial_state(field.calibration, catalogue)
        state = fresh if state is None else state
        alone.append(_errors_arcsec(field, fit.solve(fresh, field.frame)[1]))
        state, solution = fit.solve(state, field.frame)
        together.append(_errors_arcsec(field, solution))
    late = slice(n_frames // 2, None)
    return {
        "alone_grid_rms_arcsec": bootstrap(np.sum(np.array(alone)[late] ** 2, axis=2), root_mean),
        "together_grid_rms_arcsec": bootstrap(np.sum(np.array(together)[late] ** 2, axis=2), root_mean),
    }


def _lost(catalogue: StarCatalogue, n: int) -> dict[str, Any]:
    """Pointings anywhere without attitude, 20 % of the list false."""
    fit = CameraFit(lost_in_space="required")
    rng = np.random.default_rng(3)
    solved, cpu, errors = 0, [], []
    for seed in range(n):
        ra, dec = float(rng.uniform(0.0, 360.0)), float(np.degrees(np.arcsin(rng.uniform(-1.0, 1.0))))
        field = make_field(catalogue, seed, FieldOptions(n_stars=250, attitude=False, false=0.2, ra_deg=ra, dec_deg=dec))
        state = fit.initial_state(field.calibration, catalogue)
        start = time.process_time()
        _, solution = fit.solve(state, field.frame)
        cpu.append(time.process_time() - start)
        if not solution.flags & FrameFlag.NO_SOLUTION:
            solved += 1
            errors.append(np.linalg.norm(_errors_arcsec(field, solution)[40]))
    return {
        "n": n,
        "solved": solved,
        "centre_rms_arcsec": bootstrap(np.square(errors), root_mean),
        "first_cpu_s": cpu[0],
        "later_cpu_ms": 1e3 * float(np.median(cpu[1:])),
    }


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(quick="--quick" in sys.argv), indent=2) + "\n")
