"""compare.json, compare.md and compare.html from the outcomes of each choice."""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_text
from sboc_e2e.report import plots
from sboc_e2e.report.page import simple_page, table
from sboc_e2e.report.words import figure_words, number

LEVEL: Final = 0.05
"""A difference that chance alone would show less often than this is called one."""


def completeness_plot(snr: NDArray[np.float64], found: dict[str, NDArray[np.bool_]], ideal: float | None) -> str:
    """Completeness against true S/N, one curve for each choice."""
    return plots.completeness({name: (snr, f) for name, f in found.items()}, ideal)


def froc_plot(curves: dict[str, list[list[float]]]) -> str:
    """Free-response curves of all choices."""
    with plots.canvas() as (figure, (ax,)):
        for k, (name, curve) in enumerate(curves.items()):
            points = np.array(curve or [[0.0, 0.0]])
            ax.step(np.maximum(points[:, 0], 1e-3), points[:, 1], where="post", color=plots.SERIES[k % 7], label=name)
        ax.set(xscale="log", xlabel="false per frame", ylabel="share of truth (S/N >= 3) found", ylim=(0, 1.02))
        plots.plain_logarithmic(ax.xaxis)
        ax.legend(loc="upper left")
        return plots.svg(figure)


def choice_rows(result: dict[str, Any]) -> list[list[str]]:
    """One row of words for each choice."""
    rows = []
    for name, c in result["choices"].items():
        rows.append(
            [
                name,
                figure_words(c["completeness_snr8"])[0],
                figure_words(c["snr50"])[0],
                figure_words(c["false_per_frame"])[0],
                figure_words(c["false_unflagged_per_frame"])[0],
                figure_words(c["cross_crlb_ratio"])[0],
                figure_words(c["median_cpu_ms_per_frame"])[0],
                number(c["cpu_ms_per_frame"]),
                number(c["downlink_bits_per_frame"] / 1000),
            ]
        )
    return rows


HEAD = (
    "choice",
    "completeness S/N >= 8",
    "S/N half",
    "false per frame",
    "of these unflagged",
    "cross / CRLB",
    "CPU ms per frame, median",
    "CPU ms per frame, all",
    "kbit per frame",
)


def pair_rows(result: dict[str, Any]) -> list[list[str]]:
    """One row of words for each pair: who finds more, and who found what the other lost."""
    return [
        [
            f"{p['second']} against {p['first']}",
            figure_words(p["difference"])[0],
            f"{p['mcnemar']['only_second']} found by {p['second']} only, {p['mcnemar']['only_first']} by {p['first']} only",
            str(p["mcnemar"]["objects_disagreeing"]),
            number(p["mcnemar"]["p_value"]),
        ]
        for p in result["pairs"]
    ]


PAIR_HEAD = (
    "pair",
    "completeness of the first minus that of the second (S/N >= 5)",
    "streaks",
    "objects on which they differ",
    "p, exact by object",
)


def verdict(result: dict[str, Any]) -> list[str]:
    """A sentence for each pair: who finds more, by how much, how sure that is, and at what cost."""
    lines = []
    for p in result["pairs"]:
        gain, p_value = p["difference"]["value"], p["mcnemar"]["p_value"]
        if gain is None:
            lines.append(f"{p['second']} and {p['first']}: {p['difference']['reason']}.")
            continue
        better, worse = (p["second"], p["first"]) if gain >= 0 else (p["first"], p["second"])
        cost = [figure_words(result["choices"][name]["median_cpu_ms_per_frame"])[0] for name in (better, worse)]
        false = [figure_words(result["choices"][name]["false_per_frame"])[0] for name in (better, worse)]
        sure = "more than chance explains" if p_value < LEVEL else "no more than chance explains"
        streaks = f"{number(100 * abs(gain))} of 100 streaks with S/N >= 5 more than" if gain else "as many streaks as"
        lines.append(
            f"{better} finds {streaks} {worse}: {sure} (p = {number(p_value)}); false per frame {false[0]} against {false[1]}, "
            f"CPU {cost[0]} against {cost[1]} ms in the median frame."
        )
    return lines


def write_pages(result: dict[str, Any], pictures: dict[str, str], gallery: list[dict[str, Any]], out: Path) -> None:
    """All three files; `pictures` are titled SVGs, `gallery` cut-outs of streaks that one found and another lost."""
    write_text(out / "compare.json", json.dumps(result, indent=1))
    title = f"{result['seam']} on {result['scenario']}"
    note = (
        f"{result['n_frames']} frames, {result['n_truth']} truth streaks with S/N >= 3, {result['seeds']} seed(s). "
        "CPU: the median of frames, and all that the half took over the number of frames: compilation of kernels in the first "
        "frames where none are stored, linking and orbits on ground."
    )
    rows, pairs = choice_rows(result), pair_rows(result)
    notes = [f"{name}: {note}" for name, c in result["choices"].items() for note in c["notes"]]
    sentences = [*verdict(result), *(f"Note: {line}." for line in notes)]
    lines = [f"# {title}", "", *(f"{line}\n" for line in sentences), note, ""]
    for head, cells in ((HEAD, rows), (PAIR_HEAD, pairs)):
        lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(r) + " |" for r in cells), ""]
    write_text(out / "compare.md", "\n".join(lines))
    body = [
        *(f"<p><strong>{line}</strong></p>" for line in sentences),
        f"<p>{note}</p>",
        table(HEAD, rows),
        "<h2>Pairs</h2>",
        table(PAIR_HEAD, pairs),
        '<div class="plots">',
    ]
    body += [f"<figure><figcaption>{name}</figcaption>{svg}</figure>" for name, svg in pictures.items()]
    body += ["</div>", "<h2>Found by one, lost by another</h2>"]
    body += ['<div class="cases">'] if gallery else ["<p>None.</p>"]
    for item in gallery:
        body.append(
            f'<figure class="case"><img src="{item["picture"]}" alt="cut-out"><figcaption>S/N {item["snr"]:.1f}, '
            f"{item['length_px']:.0f} px, frame {item['frame']}: found by {item['found']}, "
            f"lost by {item['lost']}</figcaption></figure>"
        )
    body += ["</div>"] if gallery else []
    write_text(out / "compare.html", simple_page(title, body))
