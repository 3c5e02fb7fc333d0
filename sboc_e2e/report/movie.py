"""A short movie of a run for talks: its frames with truth and measurements over them, as an animated GIF.

Matplotlib brings Pillow along, which writes GIFs; no further library is needed.
"""

from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sboc_e2e.files.atomic import replacing
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.report import pictures
from sboc_e2e.score.evaluation import Evaluation, evaluate

WIDTH_PX: Final = 640  # Width of the film; a frame of 4096 px shrinks by 6.4. Chosen, not measured: wider films are larger files.
SECONDS: Final = 0.4
"""How long each frame stands."""
MAX_FRAMES: Final = 60  # 24 s of film at `SECONDS` each; of longer runs every second, third ... frame is taken. Chosen.
GREYS: Final = 240
"""Entries of the palette that are grey; the colours of what is drawn follow."""
COLOURS: Final = ((57, 195, 106), (255, 81, 72), (74, 168, 255), (255, 157, 46))
"""Red, green and blue of what is drawn: true, missed, measured, false, as in the report."""
TRUE, MISSED, MEASURED, FALSE = range(GREYS, GREYS + len(COLOURS))
BESIDE_PX: Final = 5
"""Truth is drawn beside its trail, so that the trail stays visible."""


def write_movie(run_dir: Path, target: Path, evaluation: Evaluation | None = None) -> int:
    """Write the kept frames of a run as a GIF; returns their number. Raises `UserError` when none was kept."""
    kept = pictures.kept_frames(run_dir)
    if not kept:
        raise UserError(f"{run_dir / 'frames'}: no frames were kept; run again with --set output.keep_frames_every=1")
    e = evaluation or evaluate(run_dir)
    numbers = sorted(kept)[:: -(-len(kept) // MAX_FRAMES)]
    shots = [_in_colours(_shot(pictures.read_pixels(kept[number]), number, e)) for number in numbers]
    with replacing(target) as stream:
        shots[0].save(stream, format="GIF", save_all=True, append_images=shots[1:], duration=int(1000 * SECONDS), loop=0)
    return len(shots)


def _in_colours(entries: NDArray[np.uint8]) -> Image.Image:
    """A picture of palette entries."""
    picture = Image.fromarray(entries, mode="P")
    greys = [round(255 * k / (GREYS - 1)) for k in range(GREYS) for _ in range(3)]
    picture.putpalette([*greys, *(value for colour in COLOURS for value in colour)])
    return picture


def _shot(image: NDArray[np.float32], number: int, e: Evaluation) -> NDArray[np.uint8]:
    """One frame, (rows, cols), as entries of the palette."""
    scale = WIDTH_PX / image.shape[1]
    size = (WIDTH_PX, max(1, round(image.shape[0] * scale)))
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    small = np.asarray(cv2.resize(image, size, interpolation=kind), dtype=np.float32)
    picture = np.minimum(pictures.stretch(small, top_sigma=200.0), GREYS - 1)
    found = e.detected_ground
    for t in e.truth:
        if t.frame == number and t.counted:
            path = np.stack([t.path.col + 0.5, t.path.row + 0.5], axis=1) * scale
            along = path[-1] - path[0]
            beside = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9) * BESIDE_PX
            cv2.polylines(picture, [np.round(path + beside).astype(np.int32)], False, TRUE if t.index in found else MISSED, 1)
    for row, s in enumerate(e.streaks):
        if int(s["frame"]) == number and not int(s["flags"]) & StreakFlag.VETOED:
            ends = [(round((float(s[f"col{k}"]) + 0.5) * scale), round((float(s[f"row{k}"]) + 0.5) * scale)) for k in (0, 1)]
            colour = MEASURED if row in e.pairs else FALSE
            for end in ends:
                cv2.circle(picture, end, 4, colour, 1)
    cv2.putText(picture, f"frame {number}", (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, GREYS - 1, 1)
    return picture
