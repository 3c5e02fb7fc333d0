"""How right the published files are, on seeds that nobody looked at: ``python -m tests.benchmarks.product_runs FOLDER``.

Parts, each with a number of cases and a first seed (see `PARTS`): whole runs of `nadir_rotation`, `sso_antisun` and of a camera
at rest and one that warms up; orbit states, light of tumblers and focal lengths as lists without pixels; the flux of the
population by pixels. One line of JSON for each case stands in FOLDER/cases.jsonl; cases that have one are left out, so that the
command goes on where it stopped. At the end it sums up what is there into bench/products.json, from which
``python -m sboc_e2e.bench.product_page docs/products.md`` writes the page.
"""

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from ground.astrometry.camera import Camera
from ground.orbit import RangeScan
from sboc_e2e.bench.product_page import STORED, summary
from sboc_e2e.bench.yardstick import yardstick_s
from sboc_e2e.score.evaluation import Evaluation, evaluate
from sboc_e2e.score.linking import linking
from sboc_e2e.score.published.axes import unit_vectors
from sboc_e2e.score.published.tdm_reader import read_tdm
from sboc_e2e.score.published.true_motion import ARCSEC_PER_RAD, true_motions
from tests.astrometry.test_camera_drift import N_FRAMES, PRIOR, SIDE_PX, TRUE, at_rest, run, warming
from tests.astrometry.test_tracklet_light import MAG, Curve, mean_light, samples, tumbler
from tests.benchmarks.light_curve_means import true_mean_magnitudes
from tests.benchmarks.population_runs import one_run as flux_run
from tests.orbit.encounters import draw_encounters, observed
from tests.orbit.test_states import nees

Case = dict[str, Any]

SCENARIOS: Final = Path(__file__).resolve().parents[2] / "scenarios"
FIGURES: Final = {
    "differs": "products.angles.differs_from_streaks",
    "along_rms": "products.angles.along_rms_arcsec",
    "streaks_along_rms": "products.angles.streaks_along_rms_arcsec",
    "velocity": "products.observer.implied_minus_quoted_rms_m_s",
    "linked": "linking.completeness",
    "fragments": "linking.fragments_per_object",
    "purity": "linking.purity",
    "completeness": "detection.ground.completeness_snr8",
    "false": "detection.ground.false_per_frame",
    "attainable": "astrometry.ends_attainable_ratio",
}
IDEAL: Final = ("--set", "psf.preset=ideal")
LIGHT_AT_ONCE, STATES_AT_ONCE, FOCAL_AT_ONCE = 250, 40, 25
"""Items of a case that needs no pixels."""
TUMBLING: Final = 0.3
WARM_PPM_S: Final = 20.0 / 150.0
"""Of the focal length, in the frames of 150 s."""


def chain(folder: Path, scenario: str, seed: int, *options: str) -> Path:
    """A finished run without its frames."""
    out = folder / "-".join([Path(scenario).stem, str(seed), *(option.removeprefix("--set ") for option in options[1::2])])
    if not (out / "score.json").is_file():
        command = [sys.executable, "-m", "sboc_e2e", "run", scenario, "--seed", str(seed), "--workers", "1", "--out", str(out)]
        command += ["--force", "--set", "output.keep_frames_every=0", *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{scenario}, seed {seed}: {done.stderr[-300:]}")
        shutil.rmtree(out / "frames", ignore_errors=True)
    return out


def figures_of(run_dir: Path) -> Case:
    """Value, n and interval of the figures of a run's score."""
    score = json.loads((run_dir / "score.json").read_text(encoding="utf-8"))
    found: Case = {}
    for name, path in FIGURES.items():
        node = score
        for key in path.split("."):
            node = node[key]
        found[name] = node
    return found


def angles_and_light(run_dir: Path, scenario: str, seed: int) -> Case:
    """Errors of each angle over its sigmas and its 68 % interval, of each tracklet's magnitude over its own; object of each."""
    e = evaluate(run_dir)
    _, owner = linking(e.streaks, e.pairs, e.n_frames)
    stated = Table.read(run_dir / "products/tdm_angles.ecsv", format="ascii.ecsv")
    snr = {int(s["streak_id"]): float(s["snr"]) for s in e.streaks}
    motions, rows = true_motions(e.truth_tables["streaks"]), []
    for segment in read_tdm(run_dir / "products/tracklets.tdm"):
        motion = motions.get(owner.get(segment.tracklet_id, -1))
        if motion is None:
            continue
        mine = stated[np.asarray(stated["tracklet_id"]) == segment.tracklet_id]
        off = motion.offset_arcsec(segment.direction, segment.angle_tai_ns)
        _, reached = motion.streak_at(segment.angle_tai_ns)
        late = np.abs(segment.angle_tai_ns[:, None] - np.asarray(mine["epoch_tai_ns"], np.int64))
        for k in np.flatnonzero(reached & (late.min(axis=1) <= 1000)):
            row = mine[int(np.argmin(late[k]))]
            sigmas = float(row["sigma_along_arcsec"]), float(row["sigma_cross_arcsec"])
            pulls = [round(float(v), 4) for v in off[k, :2] / sigmas]
            half68 = round(float(off[k, 0] / row["half68_along_arcsec"]), 4)
            found = [*pulls, round(snr[int(row["streak_id"])], 2), int(row["refitted"]), half68]
            rows.append([owner[segment.tracklet_id], *found])
    return {"angles": rows, "light": _light(e, owner, true_mean_magnitudes(run_dir, scenario, seed))}


def _light(e: Evaluation, owner: Mapping[int, int], true: Mapping[int, float]) -> list[float]:
    """Error of each tracklet's magnitude over the stated one; true : V of the mean light over the light curve, by object."""
    known = [t for t in e.tracklets if np.isfinite([float(t["mag"]), float(t["mag_err"])]).all()]
    off = [(float(t["mag"]) - true.get(owner.get(int(t["tracklet_id"]), -1), np.nan)) / float(t["mag_err"]) for t in known]
    return [round(pull, 4) for pull in off if np.isfinite(pull)]


def whole_run(name: str, *options: str) -> Callable[[Path, int], Case]:
    """Case of a shipped scenario; ground is run a second time between two yardsticks, for its CPU seconds."""

    def case(folder: Path, seed: int) -> Case:
        out = chain(folder, name, seed, *options)
        fast = yardstick_s()
        subprocess.run([sys.executable, "-m", "sboc_e2e", "ground", str(out)], capture_output=True, check=True)
        yardstick = 0.5 * (fast + yardstick_s())
        subprocess.run([sys.executable, "-m", "sboc_e2e", "score", str(out)], capture_output=True, check=True)
        stage = json.loads((out / "manifest.json").read_text(encoding="utf-8"))["stages"]["ground"]
        cost = {"ground_cpu_s": stage["cpu_s"] / stage["timed_frames"], "yardstick_s": yardstick}
        return figures_of(out) | angles_and_light(out, name, seed) | cost

    return case


def camera_run(*, warms: bool) -> Callable[[Path, int], Case]:
    """Case of 40 of 600 frames over 150 s: errors of the corners, of which the worst bound says what stars can give."""

    def case(folder: Path, seed: int) -> Case:
        text = (SCENARIOS / "sso_antisun.toml").read_text(encoding="utf-8")
        text = text.replace("frames = 24", "frames = 40").replace('frame_rate = "4 Hz"', 'frame_rate = "0.2666667 Hz"')
        preset = 'preset = "sboc_like"'
        text = text.replace(preset, f'{preset}\nas_built.focal_drift = "{WARM_PPM_S * warms:.6f} ppm/s"')
        text += '\n[population]\nclasses = [{from = "100 mm", to = "3000 mm", count = 1}]\n'
        file = folder / f"{'warm' if warms else 'rest'}.toml"
        file.write_text(text, encoding="utf-8")
        return corners(chain(folder, str(file), seed, *IDEAL))

    return case


def corners(run_dir: Path) -> Case:
    """Rms over frames and four corners of the solved minus the true direction, arcsec; stars of the median frame."""
    made, true = (Table.read(run_dir / f"{where}/frames.ecsv", format="ascii.ecsv") for where in ("products", "truth"))
    solved, wanted = (
        unit_vectors(np.asarray(t["grid_ra_app_deg"], float), np.asarray(t["grid_dec_app_deg"], float)) for t in (made, true)
    )
    row, col = (np.asarray(true[f"grid_{axis}"], float) for axis in ("row", "col"))
    outermost = ((row == row.min()) | (row == row.max())) & ((col == col.min()) | (col == col.max()))
    error2 = np.sum((solved - wanted) ** 2, axis=-1) * ARCSEC_PER_RAD**2
    by_frame = np.sum(error2 * outermost, axis=1) / np.sum(outermost, axis=1)
    stars = float(np.median(made["n_stars"]))
    return {
        "corner_arcsec": float(np.sqrt(np.mean(by_frame))),
        "corner_last_arcsec": float(np.sqrt(by_frame[-1])),
        "n_stars": stars,
        "bound_arcsec": corner_bound_arcsec(round(stars)),
    }


def corner_bound_arcsec(n: int, star_px: float = 0.0129) -> float:
    """Cramer-Rao bound of the rms over four corners, attitude, focal length and distortion unknown, from n stars at random whose
    errors (60 mas of 4.64", of the catalogue) are the same in every frame; mean of 50 fields."""
    rng = np.random.default_rng(0)
    edge = np.array([[0.0, 0.0], [0.0, SIDE_PX], [SIDE_PX, 0.0], [SIDE_PX, SIDE_PX]])
    scale = np.abs(_design(TRUE, rng.uniform(0.0, SIDE_PX, (2000, 2)))).max(axis=0)
    at, total = _design(TRUE, edge) / scale, 0.0
    for _ in range(50):
        design = _design(TRUE, rng.uniform(0.0, SIDE_PX, (n, 2))) / scale
        known = design.T @ design / star_px**2 + np.diag(np.r_[1.0 / (PRIOR * scale[:5]) ** 2, np.zeros(3)])
        total += float(np.trace(at @ np.linalg.solve(known, at.T))) / len(edge)
    return float(np.sqrt(total / 50.0)) * ARCSEC_PER_RAD / TRUE.focal_px


def _design(camera: Camera, place: np.ndarray) -> np.ndarray:
    """Derivatives (2 n, 8) of places in the frame (n, 2) by the shared parameters and the rotation."""
    _, rotation, shared = camera.derivatives(camera.unproject(*place.T))
    return np.asarray(np.concatenate([shared, rotation], axis=2).reshape(-1, 8))


def states(*, population: str, own: bool) -> Callable[[Path, int], Case]:
    """Case of orbit states of passing objects; own : with that population's share of breakup orbits, else the default ones."""

    def case(_: Path, seed: int) -> Case:
        step = RangeScan(breakup_share_small=1.0, breakup_share_large=1.0) if own else RangeScan()
        rng, found = np.random.default_rng(seed), []
        for one in draw_encounters(STATES_AT_ONCE, rng, population=population, pool=400_000, passes=True):
            tracklet, headers = observed(one, rng, steady=0.7)
            got = step.estimate(tracklet, headers)
            if got.state is not None and got.state.gaussian:
                found.append(round(nees(one, got), 4))
        return {"nees": found, "of": STATES_AT_ONCE}

    return case


def light_of_lists(_: Path, seed: int) -> Case:
    """Tracklets of 2 to 24 exposures, three in ten tumbling."""
    rng, pulls, inside = np.random.default_rng(seed), [], []
    for _k in range(LIGHT_AT_ONCE):
        curve = tumbler(rng) if rng.random() < TUMBLING else Curve()
        one = mean_light(samples(curve, int(rng.integers(2, 25)), float(rng.choice([0.01, 0.03, 0.1])), rng), 1.0)
        pulls.append(round((one.mag - MAG) / one.mag_err, 4))
        inside.append(int(one.mag_low <= MAG <= one.mag_high))
    return {"light": pulls, "inside": inside}


def focal_lengths(_: Path, seed: int) -> Case:
    """Pulls of the focal length after 40 frames of one field or of a slow scan, at rest and warming by 20 ppm."""
    out: Case = {}
    for name, drift in (("rest", at_rest), ("warm", warming)):
        for where, step in (("still", 0.0), ("scan", 0.04)):
            ended = [run(seed * FOCAL_AT_ONCE + k, drift, step=step) for k in range(FOCAL_AT_ONCE)]
            true = np.log(TRUE.focal_px) + drift((N_FRAMES - 1) / N_FRAMES)
            out[f"{name}_{where}"] = [round(float((k.values[0] - true) / np.sqrt(k.errors[0, 0])), 4) for k in ended]
    return out


def flux(folder: Path, seed: int) -> Case:
    """Which sizes of the published flux hold the truth."""
    return flux_run(folder, seed)


@dataclass(frozen=True, kw_only=True)
class Part:
    """A kind of case; `cases` of them, from `first` on, are a full measurement. Seeds before were looked at while mending."""

    measure: Callable[[Path, int], Case]
    cases: int
    first: int = 20001


PARTS: Final[dict[str, Part]] = {
    "nadir_rotation": Part(measure=whole_run("nadir_rotation"), cases=25, first=20041),
    "sso_antisun": Part(measure=whole_run("sso_antisun"), cases=4, first=20061),
    "sso_antisun_ideal": Part(measure=whole_run("sso_antisun", *IDEAL), cases=10, first=20041),
    "camera_at_rest": Part(measure=camera_run(warms=False), cases=2),
    "camera_that_warms": Part(measure=camera_run(warms=True), cases=2),
    "states_natural": Part(measure=states(population="natural", own=False), cases=12),
    "states_breakup_own_prior": Part(measure=states(population="breakup", own=True), cases=10),
    "light": Part(measure=light_of_lists, cases=6),
    "focal_length": Part(measure=focal_lengths, cases=16),
    "flux": Part(measure=flux, cases=40),
}


def measured(folder: Path, wanted: Sequence[str], cases: int | None) -> list[Case]:
    """All cases there are, after making those that are missing."""
    file = folder / "cases.jsonl"
    for name in wanted:
        part = PARTS[name]
        done = {row["seed"] for row in _stored(file) if row["part"] == name}
        for seed in sorted(set(range(part.first, part.first + (part.cases if cases is None else cases))) - done):
            began = time.monotonic()
            row = {"part": name, "seed": seed, **part.measure(folder, seed)}
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(row) + "\n")
            sys.stdout.write(f"{name}, seed {seed}: {time.monotonic() - began:.0f} s\n")
            sys.stdout.flush()
    return [row for row in _stored(file) if row["seed"] >= PARTS[row["part"]].first]


def _stored(file: Path) -> list[Case]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.is_file() else []


def main() -> None:
    """Make what is missing, then sum up."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to make; those that are there count")
    parser.add_argument("--cases", type=int, help="cases of each part, instead of its own number")
    wanted = parser.parse_args()
    wanted.folder.mkdir(parents=True, exist_ok=True)
    found = summary(measured(wanted.folder, wanted.only, wanted.cases))
    STORED.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
