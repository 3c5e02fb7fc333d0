"""Thumbnails of the shipped scenarios for the README: ``python -m sboc_e2e.report.gallery docs/gallery``.

One frame of each scenario is simulated, stretched as a person sees it, and drawn small with its truth streaks marked. One picture
more, `as_measured`, shows parts of `sso_antisun` with an ideal camera and sky beside those with everything that real ones have.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.report.pictures import stretch
from sboc_e2e.scenario import available, load
from simulator.chain import Simulator

THUMBNAIL_PX: Final = 360  # Longer side of a picture: three stand side by side in README.md.
MARKED_SNR: Final = 5.0  # Chosen, not measured: fainter truth streaks hardly show in a thumbnail.
MARK_BGR: Final = (80, 190, 60)  # Green that stands off from grey, blue first as OpenCV has it.
MEASURED_PARTS: Final = ((2044, 1828), (3368, 2280))
"""Middles of parts of `sso_antisun`: a star of V = 3.9, a galaxy of V = 12.1."""
PART_PX: Final = 240  # Side of a part: holds the halo of the star and the galaxy.
PART_SCALE: Final = 2  # Screen pixels for a pixel, so that single pixels can be seen.


def thumbnail(name: str, catalogue: StarCatalogue) -> NDArray[np.uint8]:
    """The frame nearest to the middle that shows a streak, with its truth streaks marked, (height, width, 3) BGR."""
    scenario = load(name, registry=Registry())
    made = Simulator(scenario.simulator, seed=scenario.seed, catalogue=catalogue)
    middle = made.n_frames // 2
    frame, truth = made.frame(middle)
    for index in sorted(range(made.n_frames), key=lambda index: abs(index - middle))[1:]:
        if (truth.streaks["snr"] >= MARKED_SNR).any():
            break
        frame, truth = made.frame(index)
    image = frame.pixels.astype(np.float32)
    scale = THUMBNAIL_PX / max(image.shape)
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    picture = np.repeat(stretch(small)[:, :, None], 3, axis=2)
    for streak in truth.streaks:
        if streak["snr"] < MARKED_SNR:
            continue
        points = np.stack([streak["path_col"], streak["path_row"]], axis=1) * scale
        # Marked beside the trail, so that the light itself stays visible.
        ends = points[[0, -1]]
        across = np.array([-(ends[1] - ends[0])[1], (ends[1] - ends[0])[0]])
        across = 6.0 * across / max(float(np.hypot(*across)), 1e-6) if np.hypot(*across) > 1.0 else np.array([0.0, 6.0])
        marks = np.rint(points + across).astype(np.int32)
        cv2.polylines(picture, [marks], isClosed=False, color=MARK_BGR, thickness=1, lineType=cv2.LINE_AA)
        cv2.circle(picture, tuple(int(v) for v in marks[-1]), 2, MARK_BGR, -1, cv2.LINE_AA)
    return np.asarray(picture)


def as_measured(catalogue: StarCatalogue) -> NDArray[np.uint8]:
    """Parts of one frame, the ideal camera and sky left, the preset `as_measured` right, (height, width) grey."""
    columns = []
    for preset in ("ideal", "as_measured"):
        overrides = ("population.classes=[]", f"psf.preset={preset}")
        scenario = load("sso_antisun", registry=Registry(), overrides=overrides)
        frame, _ = Simulator(scenario.simulator, seed=scenario.seed, catalogue=catalogue).frame(1)
        half = PART_PX // 2
        parts = [frame.pixels[r - half : r + half, c - half : c + half] for r, c in MEASURED_PARTS]
        columns.append(np.vstack([stretch(part.astype(np.float32)) for part in parts]))
    return np.repeat(np.repeat(np.hstack(columns), PART_SCALE, axis=0), PART_SCALE, axis=1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write one PNG for each shipped scenario; recreated frames are on their own page, beside the real ones."""
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.report.gallery", description="Thumbnails of the shipped scenarios.")
    parser.add_argument("folder", type=Path, help="where the PNG files go; made if it is not there")
    folder: Path = parser.parse_args(arguments).folder
    folder.mkdir(parents=True, exist_ok=True)
    catalogue = StarCatalogue.embedded()
    cv2.imwrite(str(folder / "as_measured.png"), as_measured(catalogue), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    for name in (name for name in available() if "/" not in name):
        cv2.imwrite(str(folder / f"{name}.png"), thumbnail(name, catalogue), [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
