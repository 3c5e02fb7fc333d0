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
LARGEST: Final = float(np.finfo(np.float32).max)
"""Of the numbers of pixels: what is more is no number to the chain either."""
STEP_NOISE: Final = 0.1
"""Of the noise of the sky, which steps between levels may be: rounding then adds 0.04 % to it. Chosen."""
SHOWN_PERCENT: Final = (0.5, 99.5)
"""Percentiles of the pixels that are black and white at first. Chosen."""
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
    """A frame (rows, cols) for the page: PNG (base64) of levels, what they mean, and percentiles of the sky.

    Level 0 is a pixel without number. Level k is `bottom` + (k - 1) `step` where that resolves the sky. Else this number is
    u = arsinh((value - `middle`) / `soft`): steps are fine about the sky, and a fixed share of the light of bright pixels.
    """
    values = np.asarray(pixels, dtype=np.float64)
    finite = np.abs(values) <= LARGEST  # NaN is not
    sample = values[finite][:: max(int(finite.sum()) // 200_000, 1)]
    if sample.size == 0:
        sample = np.zeros(1)
    below, middle = (float(v) for v in np.percentile(sample, (15.87, 50.0)))
    low, high = _limits(sample, middle)
    bottom, top = float(values[finite].min(initial=middle)), float(values[finite].max(initial=middle))
    noise = middle - below or high - low
    step, soft = (top - bottom) / (LEVELS - 1), None
    if pixels.dtype.kind in "ui" and top - bottom <= LEVELS:
        step = max(step, 1.0)
    elif step > STEP_NOISE * noise:
        soft = noise
        bottom, top = (float(np.arcsinh((v - middle) / soft)) for v in (bottom, top))
        step = (top - bottom) / (LEVELS - 1)
    known = np.where(finite, values, middle)
    at = known if soft is None else np.arcsinh((known - middle) / soft)
    # all is of one level where all is alike
    levels = np.where(finite, np.clip(np.round((at - bottom) / (step or 1.0)), 0, LEVELS - 1) + 1, 0).astype(np.uint16)
    # OpenCV stores blue, green, red
    low_byte, high_byte = (levels & 255).astype(np.uint8), (levels >> 8).astype(np.uint8)
    channels = np.stack((np.zeros_like(low_byte), low_byte, high_byte), axis=-1)
    done, png = cv2.imencode(".png", channels, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not done:
        raise UserError(f"a frame of {values.shape[0]} x {values.shape[1]} pixels cannot be made a picture")
    return {
        "png": base64.b64encode(png.tobytes()).decode(), "bottom": bottom, "step": step or 1.0,
        "middle": middle, "soft": soft, "low": low, "high": high, "rows": values.shape[0], "cols": values.shape[1],
    }  # fmt: skip


def _limits(sample: NDArray[np.float64], middle: float) -> tuple[float, float]:
    """Values shown as black and as white at first: percentiles of the sky, the latter above the former."""
    low, high = (float(v) for v in np.percentile(sample, SHOWN_PERCENT))
    if not high > low:  # nearly all is alike, as a sky that is cut off at black
        others = sample[sample != middle]
        if others.size:
            low, high = min(middle, float(others.min())), max(middle, float(np.median(others)))
        else:
            high = low + (abs(low) or 1.0)
    return low, high


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
