"""report.html of frames from outside: figures, what is lacking, frames with their streaks, cut-outs."""

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_text
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.outside.found import DIRECTIONS, RunFound
from sboc_e2e.report import pictures
from sboc_e2e.report.page import simple_page
from sboc_e2e.view.run_frames import ShownFrame, is_published

MOST_FRAMES: Final = 24  # Pictures of frames on the page, as many as the reports of runs show. Chosen: a page of a few MB.
MOST_CUTOUTS: Final = 60  # Cut-outs of published streaks, brightest first. Chosen; the table below them has all.
ENDS: Final = ("row0", "col0", "row1", "col1")
LOOKS_LIKE: Final = {
    StreakFlag.COSMIC_LIKE: "sharper than the PSF",
    StreakFlag.SPIKE_LIKE: "like a spike of a bright star",
    StreakFlag.STATIC: "stands still from frame to frame",
    StreakFlag.FIT_FAILED: "no trail fits it",
}


def write_report(found: RunFound) -> Path:
    """The page of a run of `sboc process`."""
    run_dir = found.run.path
    shown, cutouts = _pictures(found)
    body = [
        "<div class='cards'>",
        *(
            f"<div class='card'><span>{escape(label)}</span><b>{escape(value)}</b><small>{escape(note)}</small></div>"
            for label, value, note in found.rows()
        ),
        "</div>",
        f"<p>{escape(DIRECTIONS)} These frames have no truth. <code>sboc score {escape(run_dir.name)} --truth FILE</code> "
        "judges what was found by a list of yours.</p>",
        *_list("What is lacking", found.lacking()),
        "<h2>Frames</h2>",
        "<p class='legend'><i class='measured'></i>published<i class='vetoed'></i>measured and rejected</p>",
        f"<p><small>{len(shown)} of {len(found.run.frames)} frames, those with published streaks first. "
        f"<code>sboc view {escape(run_dir.name)} --browser</code> shows all at full resolution.</small></p>",
        "<div class='plots'>",
        *shown,
        "</div>",
        "<h2>Published streaks</h2>",
        "<div class='cases'>",
        *cutouts,
        "</div>" if cutouts else "</div><p>None.</p>",
        "<h2>Streaks</h2>",
        *_streak_table(found),
    ]
    page = run_dir / "report.html"
    write_text(page, simple_page(f"{run_dir.name}: frames from outside", body))
    return page


def _list(title: str, sentences: Sequence[str]) -> Iterator[str]:
    if sentences:
        yield f"<h2>{title}</h2><ul>" + "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences) + "</ul>"


def _pictures(found: RunFound) -> tuple[list[str], list[str]]:
    """Previews of frames, and cut-outs of published streaks with the highest S/N first."""
    frames = list(found.run)
    frames.sort(key=lambda frame: (-sum(is_published(s) for s in frame.streaks), frame.number))
    of_frame = {frame.number: frame for frame in frames[:MOST_FRAMES]}
    streaks = found.run.streaks[found.published]
    best = streaks[np.argsort(-np.asarray(streaks["snr"], dtype=float), kind="stable")[:MOST_CUTOUTS]]
    wanted = {int(s["frame"]) for s in best}
    shown: list[str] = []
    cut: dict[int, str] = {}
    for frame in frames:
        if frame.number not in of_frame and frame.number not in wanted:
            continue
        image = found.image(frame)
        if frame.number in of_frame:
            shown.append(_preview(frame, image))
        if image is not None:
            cut |= {int(s["streak_id"]): _cutout(frame, s, image) for s in best if int(s["frame"]) == frame.number}
    return shown, [cut[int(s["streak_id"])] for s in best if int(s["streak_id"]) in cut]


def _preview(frame: ShownFrame, image: NDArray[np.float32] | None) -> str:
    name = frame.file.name if frame.file is not None else f"frame {frame.number}"
    words = f"{escape(name)}: {sum(is_published(s) for s in frame.streaks)} published of {len(frame.streaks)} measured"
    if image is None:
        return f"<figure><figcaption>{words}. Its pixels are not where they were.</figcaption></figure>"
    uri, _ = pictures.preview(image)
    rows, cols = image.shape
    lines = "".join(_line(s) for s in frame.streaks)
    return (
        f"<figure><svg viewBox='-0.5 -0.5 {cols} {rows}' role='img' aria-label='{words}'>"
        f"<image href='{uri}' x='-0.5' y='-0.5' width='{cols}' height='{rows}' preserveAspectRatio='none'/>"
        f"<g fill='none' stroke-width='1.5'>{lines}</g></svg><figcaption>{words}</figcaption></figure>"
    )


def _line(streak: Any) -> str:
    """A streak as a pair of lines beside it, so that it stays visible."""
    row0, col0, row1, col1 = (float(streak[name]) for name in ENDS)
    if not np.isfinite([row0, col0, row1, col1]).all():
        return ""
    along = np.array([row1 - row0, col1 - col0])
    length = max(float(np.hypot(*along)), 1e-6)
    aside = 8.0 * np.array([-along[1], along[0]]) / length
    kind = "measured" if is_published(streak) else "vetoed"
    return "".join(
        f"<line class='{kind}' vector-effect='non-scaling-stroke' x1='{col0 + s * aside[1]:.1f}' y1='{row0 + s * aside[0]:.1f}' "
        f"x2='{col1 + s * aside[1]:.1f}' y2='{row1 + s * aside[0]:.1f}'/>"
        for s in (-1.0, 1.0)
    )


def _cutout(frame: ShownFrame, streak: Any, image: NDArray[np.float32]) -> str:
    uri, _, _ = pictures.cutout(image, float(streak["row_mid"]), float(streak["col_mid"]))
    words = f"frame {frame.number}, S/N {float(streak['snr']):.1f}, p {float(streak['probability']):.2f}"
    return f"<div class='case'><img src='{uri}' alt='{words}'>{words}<br><small>{float(streak['length_px']):.0f} px</small></div>"


def _streak_table(found: RunFound) -> Iterator[str]:
    names = ("frame", "streak_id", "row_mid", "col_mid", "length_px", "angle_deg", "snr", "probability", "mag", "tracklet_id")
    heads = ("frame", "streak", "row", "column", "length (px)", "angle (deg)", "S/N", "probability", "V", "tracklet", "verdict")
    streaks = found.run.streaks
    if not len(streaks):
        yield "<p>No streak was measured.</p>"
        return
    yield (
        "<div class='wide'><table class='sortable'><thead><tr>"
        + "".join(f"<th>{head}</th>" for head in heads)
        + "</tr></thead><tbody>"
    )
    for row, published in zip(streaks, found.published, strict=True):
        cells = [_cell(row[name]) for name in names]
        verdict = "published" if published else _why_rejected(int(row["flags"]))
        yield "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in (*cells, verdict)) + "</tr>"
    yield "</tbody></table></div>"


def _cell(value: Any) -> str:
    """A number as a person would write it; a dash for what is unknown or absent."""
    if isinstance(value, np.floating):
        return f"{value:.2f}" if np.isfinite(value) else "-"
    return str(value) if value >= 0 else "-"


def _why_rejected(flags: int) -> str:
    """What a rejected streak looks like, by its flags."""
    return "rejected: " + (
        ", ".join(words for flag, words in LOOKS_LIKE.items() if flags & int(flag)) or "its probability is too low"
    )
