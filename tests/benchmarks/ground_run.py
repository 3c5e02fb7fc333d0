"""The end of a long ground run in a process of its own: ``ground_run make|finish FOLDER FRAMES STREAKS``.

`make` writes the results of each frame as the ground stage leaves them in its work folder: chance streaks and two objects in
every ten seconds, 300 identified stars, a mesh of the sky. `finish` is the ground stage that finds all frames done: linking,
joint refits of the tracklets on pixels of 4096 x 4096 px frames, tables and messages; orbits, which take CPU seconds for each
tracklet and no memory, are left out. Frames are made when they are asked for. Figures are JSON; peak memory is of the whole
process, in MB of 10^6 bytes: interpreter, libraries, calibration maps, catalogue and compiled kernels included.
"""

import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ground.astrometry.camera import Camera as PinHole
from ground.ingest import IngestReport
from ground.on_demand import OnDemand
from ground.records import FrameProducts
from ground.streak_rows import STREAKS_PER_FRAME, StreakRows
from ground.streaks.psf_field import PsfField
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Calibration, NominalCamera
from sboc_e2e.icd.products import FrameSolution, PhotometricSolution, StreakMeasurement
from sboc_e2e.icd.signals import BackgroundModel, Detection, RoiGroup, StarList, Strip
from sboc_e2e.registry import Registry
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.ground_stage import STAGE, GroundStage, ground_chain, star_catalogue
from sboc_e2e.run.measure import peak_rss_mb
from sboc_e2e.run.progress import Silent
from sboc_e2e.scenario import load
from tests.downlink import bare_frame
from tests.link.sky_scene import Camera, observe, pixel_mover

CAMERA = Camera()
PSF_PX, SKY_E, LIGHT_E_PX = 0.85, 2.8, 10.0
BLOCK_FRAMES, MOVERS = 40, 2
N_STARS = 300


def streaks_of_run(n_frames: int, per_frame: int) -> Iterator[list[StreakMeasurement]]:
    """Streaks of each frame; objects of 300 to 2,000 px/s stay for up to ten seconds."""
    for first in range(0, n_frames, BLOCK_FRAMES):
        rng = np.random.default_rng([4, first])
        movers = []
        for _ in range(MOVERS):
            speed, angle = 10 ** rng.uniform(2.5, 3.3), rng.random() * 2.0 * np.pi
            row, col = rng.uniform(500.0, 3500.0, 2)
            velocity = speed * np.array([np.sin(angle), np.cos(angle)])
            movers.append(pixel_mover(CAMERA, row, col, *velocity, t_s=5.0))
        n = min(BLOCK_FRAMES, n_frames - first)
        _, found, _ = observe(CAMERA, movers, n, rng, p_seen=0.9, false_per_frame=float(per_frame))
        by_frame: list[list[StreakMeasurement]] = [[] for _ in range(n)]
        for s in found:
            number, frame = len(by_frame[s.frame]), first + s.frame
            epochs = np.full(3, CAMERA.header(frame).t_start_tai_ns)
            streak_id = frame * STREAKS_PER_FRAME + number
            by_frame[s.frame].append(dataclasses.replace(s, frame=frame, streak_id=streak_id, roi_id=number, t_tai_ns=epochs))
        yield from by_frame


def products_of(frame: int, streaks: list[StreakMeasurement]) -> FrameProducts:
    """Results of a frame."""
    some = np.zeros(N_STARS, dtype=np.float32)
    solution = FrameSolution(
        frame=frame, flags=FrameFlag(0), quaternion=Rotation.from_matrix(CAMERA.axes()).as_quat(), rate_rad_s=np.zeros(3),
        covariance_rad2=np.eye(3) * 1e-12,
        camera=PinHole(focal_px=CAMERA.focal_px, center_row=2047.5, center_col=2047.5, k1=0.0, k2=0.0, p1=0.0, p2=0.0),
        n_stars=N_STARS, rms_px=0.1, star_index=np.arange(N_STARS, dtype=np.int32), star_v_mag=some + 10.0, star_b_v=some,
        star_residual_px=np.zeros((N_STARS, 2), dtype=np.float32),
    )  # fmt: skip
    photometry = PhotometricSolution(
        frame=frame, zero_point_mag=21.68, zero_point_err_mag=0.003, colour_term=0.0, n_stars=N_STARS, rms_mag=0.02
    )
    return FrameProducts(
        header=CAMERA.header(frame), solution=solution, photometry=photometry, streaks=StreakRows.of(streaks),
        mean_flat=(1.0,) * len(streaks), psf=PsfField.nominal(PSF_PX, (CAMERA.rows, CAMERA.cols)), background=sky(),
    )  # fmt: skip


def sky() -> BackgroundModel:
    """A mesh as a header packet and its background packets give it."""
    return BackgroundModel(tile_px=128, level_adu=np.zeros((32, 32)), sigma_adu=np.full((32, 32), SKY_E))


def group_of(streak: StreakMeasurement) -> RoiGroup:
    """A uniform trail in noise, in one strip."""
    fit = streak.fit
    ends = np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]])
    axis = int(np.argmax(np.abs(ends[1] - ends[0])))
    ends = ends[np.argsort(ends[:, axis], kind="stable")]
    low, high = int(ends[0, axis]) - 12, int(ends[1, axis]) + 13
    slope = (ends[1, 1 - axis] - ends[0, 1 - axis]) / max(ends[1, axis] - ends[0, axis], 1.0)
    strip = Strip(
        axis=axis, major0=low, minor0_fp=int((ends[0, 1 - axis] + slope * (low - ends[0, axis]) - 9.0) * 65536),
        slope_fp=int(slope * 65536), level_adu=0, values_adu=np.zeros((high - low, 19), dtype=np.int32),
    )  # fmt: skip
    row, col, _ = strip.pixel_coordinates(CAMERA.rows, CAMERA.cols)
    along = (ends[1] - ends[0]) / max(fit.length_px, 1e-6)
    place = np.stack([row - ends[0, 0], col - ends[0, 1]], axis=-1)
    beyond = np.abs(place @ along - 0.5 * fit.length_px) > 0.5 * fit.length_px
    light = np.where(beyond, 0.0, LIGHT_E_PX * np.exp(-0.5 * (place @ np.array([-along[1], along[0]]) / PSF_PX) ** 2))
    noise = np.random.default_rng(streak.streak_id).normal(0.0, SKY_E, light.shape)
    detection = Detection(row0=fit.row0, col0=fit.col0, row1=fit.row1, col1=fit.col1, snr=fit.snr)
    values = np.rint(light + noise).astype(np.int32)
    strips = (dataclasses.replace(strip, values_adu=values),)
    return RoiGroup(roi_id=streak.roi_id, detection=detection, strips=strips, n_strips=1)


def frame_of(work: RunDirectory, k: int) -> DownlinkFrame:
    """The frame of which the work folder has the results; its regions are made one by one."""
    products: FrameProducts = checkpoint.load(work.work_file(STAGE, k, "result"))
    place = np.random.default_rng([5, k]).uniform(0.0, 4095.0, (2, N_STARS))
    flux = np.full(N_STARS, 1e4, dtype=np.float32)
    stars = StarList(row=place[0], col=place[1], flux_e=flux, snr=flux / 100.0, flags=np.zeros(N_STARS, dtype=np.uint8))
    header = dataclasses.replace(products.header, gain_e_adu=1.0, read_noise_e=2.3)
    rois = OnDemand(len(products.streaks), lambda i: group_of(products.streaks[i]))
    return bare_frame(header, stars=stars, rois=rois, background=products.background)


def make(folder: Path, n_frames: int, per_frame: int) -> None:
    """The work folder of a ground stage that has processed all frames."""
    run = RunDirectory(path=folder)
    for k, streaks in enumerate(streaks_of_run(n_frames, per_frame)):
        checkpoint.save(run.work_file(STAGE, k, "result"), products_of(k, streaks))
    checkpoint.save(run.work_file(STAGE, n_frames - 1, "state"), None)
    run.downlink.write_bytes(b"")


def finish(folder: Path, n_frames: int) -> dict[str, Any]:
    """What the ground stage takes from there."""
    run, scenario = RunDirectory(path=folder), load("sso_antisun", registry=Registry(), overrides=("ground.orbits=false",))
    camera = NominalCamera(
        name="benchmark", rows=CAMERA.rows, cols=CAMERA.cols, focal_px=CAMERA.focal_px, center_row=2047.5, center_col=2047.5,
        psf_sigma_px=PSF_PX, gain_e_adu=1.0, read_noise_e=2.3, saturation_adu=65535.0, full_well_e=39000.0, zero_point_e_s=4.7e8,
        aperture_m=0.2,
    )  # fmt: skip
    shape = (camera.rows, camera.cols)
    maps = {"dark_adu": np.full(shape, 0.1, dtype=np.float32), "flat": np.full(shape, 1.001, dtype=np.float32)}
    calibration = Calibration(camera=camera, defects=np.full(shape, 0, dtype=np.uint8), provenance="benchmark", **maps)
    catalogue = star_catalogue(scenario)
    chain = ground_chain(scenario, calibration=calibration, camera=camera, catalogue=catalogue)
    _, nothing = chain.ingest(b"")

    def ingest(_: bytes) -> tuple[OnDemand[DownlinkFrame], IngestReport]:
        return OnDemand(n_frames, partial(frame_of, run), keep=64), dataclasses.replace(nothing, run_id=0)

    chain.ingest = ingest  # type: ignore[assignment, method-assign]  # frames on demand take the place of packets
    stage = GroundStage(run=run, chain=chain, options=scenario.ground, catalogue=catalogue)
    before_mb, start = peak_rss_mb(), time.process_time()
    stage.execute(Silent())
    return {
        "frames": n_frames,
        "cpu_s": time.process_time() - start,
        "finish_cpu_s": stage.meter.cpu_s,
        "peak_rss_mb": peak_rss_mb(),
        "before_finish_mb": before_mb,
    }


def ask(n_frames: int, per_frame: int) -> dict[str, Any]:
    """Both steps, each in a process of its own; the figures of the second."""
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, "-m", "tests.benchmarks.ground_run"]
        for step in ("make", "finish"):
            command = [*words, step, folder, str(n_frames), str(per_frame)]
            done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    return dict(json.loads(done.stdout))


if __name__ == "__main__":
    folder, sizes = Path(sys.argv[2]), [int(word) for word in sys.argv[3:]]
    if sys.argv[1] == "make":
        make(folder, *sizes)
    else:
        sys.stdout.write(json.dumps(finish(folder, sizes[0]), indent=1) + "\n")
