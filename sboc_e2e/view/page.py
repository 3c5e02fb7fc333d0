"""A page that shows the frames of a run at full resolution: opened from disk, without a server or a network.

Pixels travel as 16-bit numbers in the red and green channel of a PNG, in a script file for each frame, which browsers load
from disk where they refuse to read images; the page stretches them.
"""

import base64
import json
from importlib import resources
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.errors import UserError
from sboc_e2e.view.run_frames import RunFrames, ShownFrame, is_published

LEVELS: Final = 65535  # Levels of a picture of 16 bits, 2**16 - 1; level 0 is a pixel without number.
PAGE: Final = "index.html"


def write_page(run: RunFrames, folder: Path) -> Path:
    """`index.html` and one script for each frame whose pixels are there. Raises `UserError` when there is none."""
    folder.mkdir(parents=True, exist_ok=True)
    listed = []
    for frame in run:
        pixels = frame.pixels()
        if pixels is None:
            continue
        listed.append(layers_of(frame))
        picture = json.dumps(picture_of(pixels))
        write_text(folder / f"{frame.name}.js", f"shown({json.dumps(frame.name)}, {picture});\n")
    if not listed:
        raise UserError(f"{run.path}: no frame's pixels are there; runs keep them with output.keep_frames_every = 1")
    parts = resources.files("sboc_e2e.view")
    page = (parts / "page.html").read_text(encoding="utf-8")
    script = (parts / "page.js").read_text(encoding="utf-8")
    data = json.dumps({"frames": listed, "sky": sky_of(run.streaks)}).replace("</", "<\\/")
    write_text(folder / PAGE, page.replace("/*DATA*/", data).replace("/*SCRIPT*/", script))
    return folder / PAGE


def picture_of(pixels: NDArray[Any]) -> dict[str, Any]:
    """A frame's numbers for the page: PNG (base64) of levels, value of level 0 and of one level, percentiles of the sky.

    Level 0 is a pixel without number. The finest sky structure stays: 65,535 levels between the extremes, or from
    far below the sky to the brightest where the extremes are absurd.
    """
    values = np.asarray(pixels, dtype=np.float64)
    finite = np.isfinite(values)
    sample = values[finite][:: max(int(finite.sum()) // 200_000, 1)]
    if sample.size == 0:
        sample = np.zeros(1)
    low, middle, high = (float(v) for v in np.percentile(sample, (0.5, 50.0, 99.5)))
    bottom = max(float(values[finite].min(initial=middle)), middle - 100.0 * max(middle - low, 1e-9))
    top = max(float(values[finite].max(initial=middle)), bottom + 1e-9)
    step = (top - bottom) / (LEVELS - 1)
    levels = np.where(finite, np.clip(np.round((np.where(finite, values, bottom) - bottom) / step), 0, LEVELS - 1) + 1, 0)
    levels = levels.astype(np.uint16)
    # OpenCV stores blue, green, red
    low_byte, high_byte = (levels & 255).astype(np.uint8), (levels >> 8).astype(np.uint8)
    channels = np.stack((np.zeros_like(low_byte), low_byte, high_byte), axis=-1)
    done, png = cv2.imencode(".png", channels, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not done:
        raise UserError(f"a frame of {values.shape[0]} x {values.shape[1]} pixels cannot be made a picture")
    return {
        "png": base64.b64encode(png.tobytes()).decode(), "bottom": bottom, "step": step,
        "low": low, "high": high, "rows": values.shape[0], "cols": values.shape[1],
    }  # fmt: skip


def layers_of(frame: ShownFrame) -> dict[str, Any]:
    """What is drawn over a frame, as (col, row)."""
    streaks = [
        {
            "line": [round(float(s[name]), 2) for name in ("col0", "row0", "col1", "row1")],
            "published": is_published(s),
            "words": f"streak {int(s['streak_id'])}: S/N {float(s['snr']):.1f}, {float(s['length_px']):.0f} px, "
            f"p {float(s['probability']):.2f}" + (f", tracklet {int(s['tracklet_id'])}" if int(s["tracklet_id"]) >= 0 else ""),
        }
        for s in frame.streaks
        if np.isfinite([float(s[name]) for name in ("col0", "row0", "col1", "row1")]).all()
    ]
    stars = [[round(float(s["col"]), 1), round(float(s["row"]), 1)] for s in frame.stars]
    where = "" if frame.file is None else frame.file.name + (f" [{frame.hdu}]" if frame.hdu else "")
    return {"name": frame.name, "number": frame.number, "file": where, "streaks": streaks, "stars": stars}


def sky_of(streaks: Table) -> list[dict[str, Any]]:
    """Published trails with directions, as lines on the sky (deg)."""
    out = []
    for s in streaks:
        ends = [float(s[name]) for name in ("ra0_deg", "dec0_deg", "ra1_deg", "dec1_deg")]
        if is_published(s) and np.isfinite(ends).all():
            out.append({"line": [round(v, 6) for v in ends], "frame": int(s["frame"]), "tracklet": int(s["tracklet_id"])})
    return out
