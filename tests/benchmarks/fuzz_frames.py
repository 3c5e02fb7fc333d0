"""Frames with any header and content, counted: through the reader, the WCS and the solution stage, or all of `sboc process`.

python -m tests.benchmarks.fuzz_frames [--frames N] [--first SEED] [--stage reader|process] [--seconds S]

Each seed draws a file (`tests.fuzz.outside`). Every file must be a frame or be refused in one line, and the plain file of its
batch must be among the products. Seeds that break this are listed with the error, and the exit code is 1.
"""

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.io import fits
from astropy.table import Table

from ground.astrometry.header_wcs import identify_by_header
from ground.astrometry.wcs_export import pixel_icrs, sip_header
from ground.sky.pixel_sky import published_directions, sky_of
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.outside import one_step
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.header_wcs import MARGIN_PX, usable_wcs
from tests.fuzz.outside import content, header, odd_file, run

BATCH: Final = 25
MEMORY: Final = Path("/dev/shm")  # noqa: S108 - the name inside is random
LARGEST_SIDE_PX: Final = 6000
"""Headers are also taken as those of frames of this size: in the reader's small frames few projections end inside."""


@cache
def downlinked() -> tuple[DownlinkFrame, NominalCamera, StarCatalogue]:
    """A frame of stars that came down, for the solution stage."""
    image = content(np.random.default_rng(3), (64, 64), "stars").astype(np.float32)
    scenario = one_step._scenario(None)
    frame, _ = one_step._frame(image, None, None, None, 0.0)
    _, (camera, packets) = one_step._on_board(frame, scenario, one_step.GivenDetections())
    catalogue = StarCatalogue.embedded()
    chain = one_step.ground_chain(scenario, calibration=None, camera=camera, catalogue=catalogue, run_id=one_step.RUN_ID)
    return chain.ingest(packets)[0][0], camera, catalogue


def through_reader(seed: int, folder: Path) -> str:
    """Reader, WCS and solution stage of one file: "refused", "pixels" or "sky". Raises what it breaks with."""
    rng = np.random.default_rng(seed)
    path = folder / "odd.fits"
    odd_file(rng).writeto(path, overwrite=True, output_verify="ignore")
    fate = "pixels"
    try:
        for sourced in FitsFolder(path=path).frames():
            if sourced.frame.pixels.ndim != 2:
                raise AssertionError(f"{sourced.frame.pixels.ndim} dimensions")
            if sourced.wcs is not None:
                through_solution(rng, sourced.wcs, *sourced.frame.pixels.shape)
                fate = "sky"
    except UserError as error:
        if "\n" in str(error):
            raise
        fate = "refused"
    rows, cols = (int(side) for side in rng.integers(16, LARGEST_SIDE_PX, 2))
    cards = fits.Header()
    header(rng, cards, (rows, cols))
    wcs, _ = usable_wcs(cards, rows, cols)
    if wcs is not None:
        through_solution(rng, wcs, rows, cols)
    return fate


def through_solution(rng: np.random.Generator, wcs: Any, rows: int, cols: int) -> None:
    """What the ground does with a believed WCS: identified stars, published directions, the WCS of images; all finite."""
    frame, camera, catalogue = downlinked()
    frame = replace(frame, header=replace(frame.header, rows=rows, cols=cols))
    solution = identify_by_header(frame, wcs, catalogue, camera)
    sky = sky_of(frame.header, solution, wcs)
    assert sky is not None
    row, col = rng.uniform(-MARGIN_PX, rows - 1 + MARGIN_PX, 40), rng.uniform(-MARGIN_PX, cols - 1 + MARGIN_PX, 40)
    middle = np.full(40, frame.header.t_start_tai_ns)
    if not np.isfinite(published_directions(sky, frame.header, row, col, middle)).all():
        raise AssertionError("a place in a believed frame has no direction")
    icrs = pixel_icrs(frame.header, solution, wcs)
    assert icrs is not None
    numbers = [value for value in sip_header(icrs, rows, cols).values() if isinstance(value, float)]
    if not np.isfinite(numbers).all():
        raise AssertionError("the WCS of an image is not finite")


def through_process(seeds: list[int], folder: Path) -> dict[str, str]:
    """Files of these seeds and a plain one through all of `process`: the fate of each file."""
    frames = folder / "frames"
    frames.mkdir(exist_ok=True)
    for path in frames.iterdir():
        path.unlink()
    plain = content(np.random.default_rng(1), (48, 48), "trail").astype(np.float32)
    fits.PrimaryHDU(plain).writeto(frames / "plain.fits")
    for seed in seeds:
        name = f"{'a' if seed % 2 else 'z'}{seed:09d}.fits"
        odd_file(np.random.default_rng(seed)).writeto(frames / name, output_verify="ignore")
    ingest = run(frames, folder / "out")["outside"]
    table = Table.read(folder / "out" / "products" / "frames.ecsv", format="ascii.ecsv")
    fates = {str(name): "frame" for name in table["file"]}
    for path in frames.iterdir():
        if path.name not in fates and any(path.name in line for line in ingest["left_out"]):
            fates[path.name] = "refused"
        if path.name not in fates:
            raise AssertionError(f"{path.name} is neither a frame nor left out")
    if fates["plain.fits"] != "frame":
        raise AssertionError("the plain frame is lost")
    return fates


def broken_of(seeds: list[int], stage: str, folder: Path, fates: dict[str, int]) -> list[dict[str, Any]]:
    """The seeds of a batch that break the promise, each with its error. A batch that breaks is gone through one by one."""
    try:
        if stage == "process":
            made = list(through_process(seeds, folder).values())
            made.remove("frame")  # the plain one
        else:
            made = [through_reader(seed, folder) for seed in seeds]
    except Exception as error:  # noqa: BLE001 - any error is what is looked for
        if len(seeds) > 1:
            alone = [each for seed in seeds for each in broken_of([seed], stage, folder, fates)]
            return alone or [{"seeds": seeds, "error": _said(error)}]
        return [{"seeds": seeds, "error": _said(error)}]
    for fate in made:
        fates[fate] = fates.get(fate, 0) + 1
    return []


def _said(error: BaseException) -> str:
    where = traceback.extract_tb(error.__traceback__)[-3:]
    return f"{type(error).__name__}: {str(error)[:160]} | " + " < ".join(
        f"{Path(w.filename).name}:{w.lineno}" for w in reversed(where)
    )


def tried(first: int, frames: int, stage: str, seconds: float = float("inf")) -> dict[str, Any]:
    """Seeds from the first on, until they or the time are used up."""
    start, seed = time.monotonic(), first
    broken: list[dict[str, Any]] = []
    fates: dict[str, int] = {}
    memory = MEMORY if os.access(MEMORY, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="sboc-fuzz-", dir=memory) as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while seed < first + frames and time.monotonic() - start < seconds:
            seeds = list(range(seed, min(seed + BATCH, first + frames)))
            broken += broken_of(seeds, stage, Path(name), fates)
            seed = seeds[-1] + 1
    return {
        "stage": stage,
        "first": first,
        "frames": seed - first,
        "fates": fates,
        "n_broken": len(broken),
        "broken": broken[:40],
    }


def main() -> None:
    """How many frames of how many broke the promise, as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--stage", choices=("reader", "process"), default="process")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    options = parser.parse_args()
    result = tried(options.first, options.frames, options.stage, options.seconds)
    sys.stdout.write(json.dumps(result, indent=1) + "\n")
    sys.exit(1 if result["n_broken"] else 0)


if __name__ == "__main__":
    main()
