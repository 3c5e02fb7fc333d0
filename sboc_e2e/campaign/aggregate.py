"""Shards to answers: completeness by S/N, size, range and rate, detections a day by size class, heat maps."""

import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from sboc_e2e.campaign.engine import CampaignResult
from sboc_e2e.campaign.plan import Campaign
from sboc_e2e.files.atomic import write_text
from sboc_e2e.report import plots
from sboc_e2e.report.page import simple_page, table
from sboc_e2e.report.words import figure_words
from sboc_e2e.score.figures import Figure, half_point, proportion, rate
from sboc_e2e.score.population import detections_per_day

SIZE_EDGES_M: Final = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 2e-1, 5e-1, 1.0)
RANGE_EDGES_KM: Final = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 50000.0)
RATE_EDGES_DEG_S: Final = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)
AXES: Final = (("size_m", SIZE_EDGES_M), ("range_km", RANGE_EDGES_KM), ("rate_deg_s", RATE_EDGES_DEG_S))


def read_shards(out: Path) -> dict[str, list[Table]]:
    """Shards by the text of their point."""
    points: dict[str, list[Table]] = defaultdict(list)
    for path in sorted((out / "shards").glob("*.ecsv")):
        table = Table.read(path, format="ascii.ecsv")
        points[table.meta["point"]].append(table)
    return dict(points)


def summarise(shards: list[Table]) -> dict[str, Any]:
    """Figures of one point over its replicas."""
    snr = np.concatenate([np.asarray(s["snr"], float) for s in shards])
    found = np.concatenate([np.asarray(s["detected_ground"], bool) for s in shards])
    frames = sum(int(s.meta["n_frames"]) for s in shards)
    rate_hz = float(shards[0].meta["frame_rate_hz"])
    bright = snr >= 8.0
    by_axis = {}
    for axis, edges in AXES:
        value = np.concatenate([np.asarray(s[axis], float) for s in shards])
        cells = []
        for low, high in pairwise(edges):
            inside = (value >= low) & (value < high) & (snr >= 3.0)
            if inside.any():
                share = proportion(int(found[inside].sum()), int(inside.sum()))
                cells.append({"from": low, "to": high, "detected": share})
        by_axis[axis] = cells
    return {
        "replicas": len(shards),
        "frames": frames,
        "completeness_snr8": proportion(int(found[bright].sum()), int(bright.sum()), "no truth streak with S/N >= 8"),
        "snr50": half_point(snr[snr >= 3.0], found[snr >= 3.0]),
        "false_per_frame": rate(sum(int(s.meta["n_false_ground"]) for s in shards), frames, frames),
        "downlink_bytes_per_frame": sum(int(s.meta["downlink_bytes"]) for s in shards) / max(frames, 1),
        "completeness": by_axis,
        "per_day": _per_day(shards, frames, rate_hz),
    }


def _per_day(shards: list[Table], frames: int, rate_hz: float) -> dict[str, Any]:
    """Objects of all replicas as one long run: weights stay, the time span adds up."""
    size, weight, seen = [], [], {}
    offset = 0
    for s in shards:
        injected = np.asarray(s.meta["injected"], float).reshape(-1, 2)
        population = np.asarray(s["kind"]).astype(str) == "population"
        detected = {int(o) for o in np.asarray(s["object_id"])[population & np.asarray(s["detected_ground"], bool)]}
        sizes_seen = {float(m) for o, m in zip(s["object_id"], s["size_m"], strict=True) if int(o) in detected}
        for k, (size_m, w) in enumerate(injected):
            size.append(size_m)
            weight.append(w)
            if size_m in sizes_seen:
                seen[offset + k] = 1
        offset += len(injected)
    objects = Table({"object_id": np.arange(offset), "size_m": size, "weight": weight, "kind": ["population"] * offset})
    false = sum(int(s.meta["n_false_ground"]) for s in shards)
    return detections_per_day(objects, seen, frames / rate_hz, false, frames, rate_hz)


def _heat_map(shards: list[Table]) -> str:
    """Completeness over size and range, cells with the number of streaks behind them."""
    size = np.concatenate([np.asarray(s["size_m"], float) for s in shards])
    distance = np.concatenate([np.asarray(s["range_km"], float) for s in shards])
    found = np.concatenate([np.asarray(s["detected_ground"], bool) for s in shards])
    all_n, _, _ = np.histogram2d(size, distance, (SIZE_EDGES_M, RANGE_EDGES_KM))
    hit_n, _, _ = np.histogram2d(size[found], distance[found], (SIZE_EDGES_M, RANGE_EDGES_KM))
    with plots.canvas(5.6, 4.0) as (figure, (ax,)):
        share = np.where(all_n > 0, hit_n / np.maximum(all_n, 1), np.nan)
        mesh = ax.pcolormesh(RANGE_EDGES_KM, SIZE_EDGES_M, share, vmin=0, vmax=1, cmap="viridis")
        figure.colorbar(mesh, ax=ax, label="share detected")
        for i, j in np.argwhere(all_n > 0):
            x = np.sqrt(RANGE_EDGES_KM[j] * RANGE_EDGES_KM[j + 1])
            y = np.sqrt(SIZE_EDGES_M[i] * SIZE_EDGES_M[i + 1])
            ax.text(x, y, f"{int(all_n[i, j])}", ha="center", va="center", fontsize=6)
        ax.set(xscale="log", yscale="log", xlabel="range (km)", ylabel="size (m)")
        return plots.svg(figure)


def write_results(campaign: Campaign, result: CampaignResult, out: Path) -> None:
    """campaign.json, campaign.md and campaign.html from the shards on disk; failed tasks are listed with their reason."""
    points = read_shards(out)
    summary = {point: summarise(shards) for point, shards in points.items()}
    failed = [{"point": task.label, "replica": task.replica, "reason": reason} for task, reason in result.failed]
    result_page = {"campaign": campaign.name, "scenario": campaign.scenario, "points": summary, "failed": failed}
    write_text(out / "campaign.json", json.dumps(result_page, indent=1))
    write_text(out / "campaign.md", _markdown(campaign, summary, failed))
    figures = {point: _heat_map(shards) for point, shards in points.items()}
    write_text(out / "campaign.html", _html(campaign, summary, failed, figures))


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


_HEAD: Final = ("point", "completeness S/N >= 8", "S/N half", "false per frame", "kB per frame", "detections a day")


def _markdown(campaign: Campaign, summary: dict[str, Any], failed: list[dict[str, Any]]) -> str:
    lines = [
        f"# Campaign {campaign.name}",
        "",
        campaign.description,
        "",
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
    ]
    lines += [f"| {_label(point)} | " + " | ".join(_cells(s)) + " |" for point, s in summary.items()]
    for f in failed:
        lines.append(f"- failed: {f['point']}, replica {f['replica']}: {f['reason']}")
    return "\n".join(lines) + "\n"


def _html(campaign: Campaign, summary: dict[str, Any], failed: list[dict[str, Any]], figures: dict[str, str]) -> str:
    body = [f"<p>{campaign.description}</p>", table(_HEAD, [[_label(p), *_cells(s)] for p, s in summary.items()])]
    for point, s in summary.items():
        rows = [
            [
                f"{c['from_m'] * 1000:g}-{c['to_m'] * 1000:g} mm",
                *(figure_words(c[k])[0] for k in ("injected_per_day", "detected_per_day")),
            ]
            for c in s["per_day"]["size_classes"]
        ]
        body += [f"<h2>{_label(point)}</h2>", f"<figure>{figures[point]}</figure>"]
        body.append(table(("size", "injected a day", "detected a day"), rows))
    if failed:
        body += [
            "<h2>Failed tasks</h2>",
            table(("point", "replica", "reason"), [[f["point"], f["replica"], f["reason"]] for f in failed]),
        ]
    return simple_page(f"Campaign {campaign.name}", body)
