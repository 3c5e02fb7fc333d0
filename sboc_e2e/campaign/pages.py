"""campaign.json, campaign.md and campaign.html from the shards on disk."""

import json
from html import escape
from pathlib import Path
from typing import Any, Final

from sboc_e2e.campaign.aggregate import against_first, read_shards, summarise
from sboc_e2e.campaign.engine import CampaignResult
from sboc_e2e.campaign.pictures import heat_map, larger_than, over_keys
from sboc_e2e.campaign.plan import Campaign
from sboc_e2e.files.atomic import write_text
from sboc_e2e.report.page import simple_page, table
from sboc_e2e.report.words import figure_words, number
from sboc_e2e.score.figures import Figure

_HEAD: Final = ("point", "completeness S/N >= 8", "S/N half", "false per frame", "kB per frame", "detections a day")
GAIN_TITLE: Final = "Completeness minus that of the first point, on the same streaks"
MAP_TITLE: Final = "Completeness by size and range, number of streaks (S/N >= 3)"
_GAIN_HEAD: Final = ("point", "difference (S/N >= 5)", "streaks", "objects on which they differ", "p, exact by object")
_DAY: Final = ("injected_per_day", "detected_per_day", "recovered_per_day")


def write_results(campaign: Campaign, result: CampaignResult, out: Path) -> None:
    """All three files; failed tasks are listed with their reason."""
    points = read_shards(result.shards)
    summary = {point: summarise(shards) for point, shards in points.items()}
    failed = [{"point": task.label, "replica": task.replica, "reason": reason} for task, reason in result.failed]
    gains = against_first(points)
    document = {
        "campaign": campaign.name,
        "scenario": campaign.scenario,
        "points": summary,
        "against_first": gains,
        "failed": failed,
    }
    write_text(out / "campaign.json", json.dumps(document, indent=1))
    write_text(out / "campaign.md", _markdown(campaign, summary, gains, failed))
    maps = {point: heat_map(shards) for point, shards in points.items()}
    write_text(out / "campaign.html", _html(campaign, summary, gains, failed, maps))


def _label(point: str) -> str:
    values = json.loads(point)
    return ", ".join(f"{k} = {v}" for k, v in values.items()) or "the scenario as it is"


def _cells(s: dict[str, Any]) -> list[str]:
    def words(f: Figure) -> str:
        value, note = figure_words(f)
        return f"{value} ({note})" if note else value

    detected = [c["detected_per_day"]["value"] for c in s["per_day"]["size_classes"]]
    total = sum(v for v in detected if v is not None)
    return [
        words(s["completeness_snr8"]), words(s["snr50"]), words(s["false_per_frame"]),
        f"{s['downlink_bytes_per_frame'] / 1000:.1f}", f"{total:,.0f}",
    ]  # fmt: skip


def _gain_rows(gains: dict[str, Any]) -> list[list[str]]:
    """One row of words for each point that shares frames with the first."""
    return [
        [
            _label(point),
            *figure_words(g["completeness"]),
            str(g["mcnemar"]["objects_disagreeing"]),
            number(g["mcnemar"]["p_value"]),
        ]
        for point, g in gains.items()
    ]


def _notes(summary: dict[str, Any]) -> list[str]:
    return [f"Note on {_label(point)}: {note}." for point, s in summary.items() for note in s["notes"]]


def _markdown(campaign: Campaign, summary: dict[str, Any], gains: dict[str, Any], failed: list[dict[str, Any]]) -> str:
    head = "| " + " | ".join(_HEAD) + " |"
    lines = [f"# Campaign {campaign.name}", "", campaign.description, "", head, "|" + "---|" * len(_HEAD)]
    lines += [f"| {_label(point)} | " + " | ".join(_cells(s)) + " |" for point, s in summary.items()]
    if gains:
        lines += ["", GAIN_TITLE, "", "| " + " | ".join(_GAIN_HEAD) + " |", "|" + "---|" * len(_GAIN_HEAD)]
        lines += ["| " + " | ".join(row) + " |" for row in _gain_rows(gains)]
    lines += ["", *_notes(summary)]
    for f in failed:
        lines.append(f"- failed: {f['point']}, replica {f['replica']}: {f['reason']}")
    return "\n".join(lines) + "\n"


def _html(
    campaign: Campaign, summary: dict[str, Any], gains: dict[str, Any], failed: list[dict[str, Any]], maps: dict[str, str]
) -> str:
    body = [f"<p>{escape(campaign.description)}</p>", table(_HEAD, [[_label(p), *_cells(s)] for p, s in summary.items()])]
    if gains:
        body += [f"<h2>{GAIN_TITLE}</h2>", table(_GAIN_HEAD, _gain_rows(gains))]
    body += [f"<p>{escape(line)}</p>" for line in _notes(summary)]
    overview = over_keys([(json.loads(point), s) for point, s in summary.items()])
    if overview:
        body.append(f"<figure><figcaption>Over the varied keys</figcaption>{overview}</figure>")
    for point, s in summary.items():
        size = [
            [f"{c['from_m'] * 1000:g}-{c['to_m'] * 1000:g} mm", *(figure_words(c[k])[0] for k in _DAY)]
            for c in s["per_day"]["size_classes"]
        ]
        counts = larger_than(s["per_day"])
        body += [f"<h2>{escape(_label(point))}</h2>", '<div class="plots">']
        body.append(f"<figure><figcaption>{escape(MAP_TITLE)}</figcaption>{maps[point]}</figure>")
        if counts:
            body.append(f"<figure><figcaption>N(&gt; d), injected and recovered</figcaption>{counts}</figure>")
        body += ["</div>", table(("size", "injected a day", "detected a day", "recovered a day"), size)]
        slopes = [(name, *figure_words(s["per_day"][name])) for name in ("injected_slope", "recovered_slope", "false_per_day")]
        body.append(table(("", "value [90 %]", "n or reason"), slopes))
    if failed:
        rows = [[f["point"], f["replica"], f["reason"]] for f in failed]
        body += ["<h2>Failed tasks</h2>", table(("point", "replica", "reason"), rows)]
    return simple_page(f"Campaign {campaign.name}", body)
