"""compare.json, compare.md and compare.html from the outcomes of each choice."""

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.files.atomic import write_text
from sboc_e2e.report import plots
from sboc_e2e.report.page import simple_page, table
from sboc_e2e.report.words import figure_words, number

FINDING: Final = ("onboard.background", "onboard.star_extractor", "onboard.detector", "onboard.tracker", "ground.vetter")
"""Seams whose steps decide which streaks are found; the others are judged by their own figures first."""

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
                figure_words(c["cross_crlb_robust"])[0],
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
    "cross / CRLB, rms",
    "cross / CRLB, from the median",
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
        better, worse = (p["second"], p["first"]) if (gain or 0.0) >= 0 else (p["first"], p["second"])
        cost = [figure_words(result["choices"][name]["median_cpu_ms_per_frame"])[0] for name in (better, worse)]
        false = [figure_words(result["choices"][name]["false_per_frame"])[0] for name in (better, worse)]
        price = f"false per frame {false[0]} against {false[1]}, CPU {cost[0]} against {cost[1]} ms in the median frame."
        if gain is None:
            lines.append(f"{better} and {worse}: {p['difference']['reason']}; {price}")
            continue
        sure = "more than chance explains" if p_value < LEVEL else "no more than chance explains"
        streaks = f"{number(100 * abs(gain))} of 100 streaks with S/N >= 5 more than" if gain else "as many streaks as"
        lines.append(f"{better} finds {streaks} {worse}: {sure} (p = {number(p_value)}); {price}")
    return lines


def seam_verdict(result: dict[str, Any]) -> list[str]:
    """A sentence for each pair of a seam that does not decide which streaks are found: its first figure that tells them apart."""
    lines = []
    for p in result["pairs"]:
        a, b = p["first"], p["second"]
        # A third choice without a figure takes nothing away from these two.
        asked = [q for q in result["questions"] if all(q["choices"][name]["value"] is not None for name in (a, b))]
        cost = " against ".join(figure_words(result["choices"][name]["median_cpu_ms_per_frame"])[0] for name in (a, b))
        apart = [q for q in asked if _apart(q["choices"][a], q["choices"][b])]
        if not asked:
            lines.append(f"{a} and {b}: no figure of this step could be measured here.")
        elif not apart:
            shown = asked[0]
            values = " and ".join(figure_words(shown["choices"][name])[0] for name in (a, b))
            lines.append(
                f"No figure of this step tells {a} from {b} ({shown['label']} {values}); CPU {cost} ms in the median frame."
            )
        else:
            words = "; ".join(
                f"{q['label']} {figure_words(q['choices'][a])[0]} with {a}, {figure_words(q['choices'][b])[0]} with {b}"
                for q in apart[:3]
            )
            lines.append(f"{a} and {b} differ: {words}; CPU {cost} ms in the median frame.")
    return lines


def _apart(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two intervals do not overlap."""
    return bool(one["high"] < other["low"] or other["high"] < one["low"])


def question_rows(result: dict[str, Any]) -> list[list[str]]:
    """A row for each figure of the seam, a cell for each choice; a figure that is absent says why."""
    rows = []
    for q in result["questions"]:
        cells = [figure_words(q["choices"][name]) for name in result["choices"]]
        rows.append([q["label"], *(value if value != "-" else f"- ({note})" for value, note in cells)])
    return rows


def split_rows(result: dict[str, Any]) -> list[list[str]]:
    """A row for each bin of S/N and length, a cell for each choice."""
    return [
        [s["quantity"], s["bin"], str(s["n"]), *(figure_words(s["choices"][name])[0] for name in result["choices"])]
        for s in result["splits"]
    ]


def sentences_of(result: dict[str, Any]) -> list[str]:
    """What the page begins with."""
    return verdict(result) if result["seam"] in FINDING else seam_verdict(result)


def write_pages(
    result: dict[str, Any],
    pictures: dict[str, str],
    gallery: list[dict[str, Any]],
    false_alarms: dict[str, list[dict[str, Any]]],
    out: Path,
) -> None:
    """All three files.

    pictures : titled SVGs. gallery : cut-outs of streaks that one found and another lost. false_alarms : cut-outs by choice.
    """
    write_text(out / "compare.json", json.dumps(result, indent=1))
    title = f"{result['seam']} on {result['scenario']}"
    note = (
        f"{result['n_frames']} frames, {result['n_truth']} truth streaks with S/N >= 3, {result['seeds']} seed(s). "
        "CPU: the median of frames, and all that the half took over the number of frames, with start-up, linking and orbits. "
        "Compilation of kernels is left out."
    )
    rows, pairs = choice_rows(result), pair_rows(result)
    notes = [f"{name}: {note}" for name, c in result["choices"].items() for note in c["notes"]]
    sentences = [*sentences_of(result), *(f"Note: {line}." for line in notes)]
    lines = [f"# {title}", "", *(f"{line}\n" for line in sentences), note, ""]
    names = list(result["choices"])
    questions, by_bin = ("asked of this step", *names), ("completeness by", "bin", "n", *names)
    tables = ((questions, question_rows(result)), (HEAD, rows), (PAIR_HEAD, pairs), (by_bin, split_rows(result)))
    for head, cells in tables:
        lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(r) + " |" for r in cells), ""]
    write_text(out / "compare.md", "\n".join(lines))
    body = [
        *(f"<p><strong>{escape(line)}</strong></p>" for line in sentences),
        f"<p>{note}</p>",
        f"<h2>What {escape(result['seam'])} decides</h2>",
        table(*tables[0]),
        "<h2>Choices</h2>",
        table(HEAD, rows),
        "<p>Runs: " + "; ".join(_links(name, result["runs"][name]) for name in names) + "</p>",
        "<h2>Pairs</h2>",
        table(PAIR_HEAD, pairs),
        "<h2>Where they differ</h2>",
        table(*tables[3]) if tables[3][1] else "<p>There is no truth streak.</p>",
        '<div class="plots">',
    ]
    body += [f"<figure><figcaption>{name}</figcaption>{svg}</figure>" for name, svg in pictures.items()]
    body += ["</div>", "<h2>Found by one, lost by another</h2>"]
    body += ['<div class="cases">'] if gallery else ["<p>None.</p>"]
    for item in gallery:
        body.append(
            f'<figure class="case"><img src="{item["picture"]}" alt="cut-out"><figcaption>S/N {item["snr"]:.1f}, '
            f"{item['length_px']:.0f} px, frame {item['frame']}: found by {escape(item['found'])}, "
            f"lost by {escape(item['lost'])}</figcaption></figure>"
        )
    body += ["</div>"] if gallery else []
    for name, items in false_alarms.items():
        body += [f"<h2>False alarms of {escape(name)}, most significant first</h2>"]
        body += ['<div class="cases">'] if items else ["<p>None.</p>"]
        body += [
            f'<figure class="case"><img src="{item["picture"]}" alt="cut-out"><figcaption>S/N {item["snr"]:.1f}, '
            f"{item['length_px']:.0f} px, frame {item['frame']}</figcaption></figure>"
            for item in items
        ]
        body += ["</div>"] if items else []
    write_text(out / "compare.html", simple_page(title, body))


def _links(name: str, folders: Sequence[str]) -> str:
    """Links to the reports of a choice's runs."""
    links = (f'<a href="{escape(folder)}/report.html">{k}</a>' for k, folder in enumerate(folders, 1))
    return f"{escape(name)} {', '.join(links)}"
