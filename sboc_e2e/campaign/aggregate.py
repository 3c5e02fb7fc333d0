"""Shards to answers: completeness by S/N, size, range and rate; debris a day by size class, injected, detected, recovered."""

from collections import defaultdict
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table

from sboc_e2e.compare.paired import PAIR_SNR, Outcomes, difference, mcnemar
from sboc_e2e.score.detection import LEAST_DETECTABLE_SNR
from sboc_e2e.score.figures import half_point, proportion, rate
from sboc_e2e.score.population import detections_per_day
from sboc_e2e.score.recovery import Counted, recovery, together

SIZE_EDGES_M: Final = (1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 1e-1, 2e-1, 5e-1, 1.0)
"""Bins of the plots: diameters, three a decade from 1 mm to 1 m. Chosen: finer bins hold fewer streaks each."""
RANGE_EDGES_KM: Final = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 50000.0)
"""Bins of the plots: two a decade; the last reaches beyond the geostationary ring (42,164 km). Chosen."""
RATE_EDGES_DEG_S: Final = (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)
"""Bins of the plots: two a decade from the slow end of the geostationary ring on. Chosen."""
SEED_STEP: Final = 1_000_000
"""Objects of different seeds are different ones."""
AXES: Final = (("size_m", SIZE_EDGES_M), ("range_km", RANGE_EDGES_KM), ("rate_deg_s", RATE_EDGES_DEG_S))


def read_shards(paths: Iterable[Path]) -> dict[str, list[Table]]:
    """Shards by the text of their point, in the order of the paths."""
    points: dict[str, list[Table]] = defaultdict(list)
    for path in paths:
        table = Table.read(path, format="ascii.ecsv")
        points[table.meta["point"]].append(table)
    return dict(points)


def summarise(shards: list[Table]) -> dict[str, Any]:
    """Figures of one point over its replicas."""
    snr = np.concatenate([np.asarray(s["snr"], float) for s in shards])
    found = np.concatenate([np.asarray(s["detected_ground"], bool) for s in shards])
    frames = sum(int(s.meta["n_frames"]) for s in shards)
    rate_hz = float(shards[0].meta["frame_rate_hz"])
    bright = snr >= LEAST_DETECTABLE_SNR
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
        "notes": sorted({note for s in shards for note in s.meta["notes"]}),
        "frames": frames,
        "completeness_snr8": proportion(int(found[bright].sum()), int(bright.sum()), "no truth streak with S/N >= 8"),
        "snr50": half_point(snr[snr >= 3.0], found[snr >= 3.0]),
        "false_per_frame": rate(sum(int(s.meta["n_false_ground"]) for s in shards), frames, frames),
        "downlink_bytes_per_frame": sum(int(s.meta["downlink_bytes"]) for s in shards) / max(frames, 1),
        "completeness": by_axis,
        "per_day": _per_day(shards, frames, rate_hz),
    }


def against_first(points: dict[str, list[Table]]) -> dict[str, dict[str, Any]]:
    """What points that share frames with the first one gain over it on the same streaks with S/N >= 5 (see `compare.paired`)."""
    if not points:
        return {}
    first = next(iter(points))
    out = {}
    for point, shards in points.items():
        earlier = {table.meta["frames"]: table for table in points[first]}
        pairs = [(earlier[table.meta["frames"]], table) for table in shards if table.meta["frames"] in earlier]
        if point == first or not pairs:
            continue
        outcomes = Outcomes(
            snr=np.concatenate([np.asarray(a["snr"], float) for a, _ in pairs]),
            length_px=np.concatenate([np.asarray(a["length_px"], float) for a, _ in pairs]),
            cluster=np.concatenate([SEED_STEP * k + np.asarray(a["object_id"], np.int64) for k, (a, _) in enumerate(pairs)]),
            found={
                name: np.concatenate([np.asarray(pair[k]["detected_ground"], bool) for pair in pairs])
                for k, name in enumerate(("first", "this"))
            },
        )
        judged = outcomes.select(outcomes.snr >= PAIR_SNR)
        test = mcnemar(judged.found["first"], judged.found["this"], judged.cluster)
        out[point] = {"completeness": difference(judged, "first", "this"), "mcnemar": test}
    return out


def _per_day(shards: list[Table], frames: int, rate_hz: float) -> dict[str, Any]:
    """Objects of all replicas as one long run: weights stay, the time span adds up."""
    sample = together([Counted.from_lists(s.meta["counted"]) for s in shards])
    n, span_s = len(sample.size_m), frames / rate_hz
    objects = Table({"object_id": np.arange(n), "size_m": sample.size_m, "weight": sample.weight, "kind": ["population"] * n})
    found = dict.fromkeys(np.flatnonzero(np.concatenate([np.asarray(s.meta["found"], bool) for s in shards])).tolist(), 1)
    false = sum(int(s.meta["n_false_ground"]) for s in shards)
    direct = detections_per_day(objects, found, span_s, false, frames, rate_hz)
    inferred = recovery(sample, span_s, float(shards[0].meta["field_deg"]))
    classes = [a | b for a, b in zip(direct["size_classes"], inferred["size_classes"], strict=True)]
    return inferred | {"size_classes": classes, "false_per_day": direct["false_per_day"]}
