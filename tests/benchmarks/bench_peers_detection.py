"""Completeness by length and S/N, false detections and CPU seconds: this line-integral detector beside acstools findsat_mrt.

Both see the same frames of `detection_frames` (Gaussian PSF, white noise, stars). findsat_mrt gives lines from
edge to edge and no ends, so that for it a streak counts as found when a line passes within 10 px of both of its ends; ours has to
match midpoint, angle and overlap. Where both claim the same, the peer's rule is the easier one.
"""

import json
import math
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from onboard.detect import LineIntegralDetector
from sboc_e2e.score.figures import proportion, rate
from tests.benchmarks.bench_detection import history_of, score
from tests.benchmarks.detection_frames import Scene, Streak, add_streak, exposure, random_stars, random_streak, view_of
from tests.benchmarks.detector_warm_up import warm_up
from tests.benchmarks.peers.environment import PeerError, absent, ask, spread

SIZE_PX = 1024
N_STARS = 25_000
"""Above S/N 8 per 4096 x 4096 px, so 1,562 in one of these frames."""
CELLS = ((400.0, 15.0), (400.0, 100.0), (900.0, 15.0), (900.0, 60.0), (900.0, 200.0))
"""Length (px) and S/N; findsat_mrt is made for trails that cross the frame."""
BIN_PX = 2
NEAR_PX = 10.0


def on_line(streak: Streak, line: list[float]) -> bool:
    """Whether both ends of a streak lie within `NEAR_PX` of a line through two points (row, col, row, col)."""
    row0, col0, row1, col1 = line
    length = math.hypot(row1 - row0, col1 - col0)
    if length == 0.0:
        return False
    across = [
        abs((row - row0) * (col1 - col0) - (col - col0) * (row1 - row0)) / length
        for row, col in ((streak.row0, streak.col0), (streak.row1, streak.col1))
    ]
    return max(across) <= NEAR_PX


def scenes(n_each: int) -> list[tuple[Scene, Any]]:
    """Frames with one streak each, cell by cell, then as many without; the earlier frame of each for our detector."""
    made = []
    for k, cell in enumerate([cell for cell in CELLS for _ in range(n_each)] + [None] * n_each):
        rng = np.random.default_rng((77, k))
        stars = random_stars(SIZE_PX, N_STARS, rng)
        earlier, scene = history_of(SIZE_PX, stars, rng), exposure(SIZE_PX, stars, rng)
        if cell is not None:
            add_streak(scene, random_streak(SIZE_PX, *cell, rng), rng)
        made.append((scene, earlier))
    return made


def main(quick: bool) -> dict[str, Any]:
    """Completeness of each cell, false detections for each frame, CPU seconds for each frame, and the ratio of these."""
    warm_up()
    n_each = 2 if quick else 5
    made = scenes(n_each)
    detector = LineIntegralDetector()
    found_ours: list[bool] = []
    false_ours, cpu_ours = 0, []
    for scene, earlier in made:
        view = view_of(scene, frame=1, history=(earlier,))
        begin = time.process_time()
        detections = detector.detect(view)
        cpu_ours.append(time.process_time() - begin)
        paired, _, false = score(detections, scene.streaks)
        found_ours += [hit is not None for hit in paired]
        false_ours += false
    result = {
        **_completeness("line_integral", found_ours, n_each),
        "line_integral_false_per_frame": rate(false_ours, len(made), len(made)),
        "line_integral_cpu_s": spread(cpu_ours),
    }
    try:
        with tempfile.TemporaryDirectory() as folder:
            frames = Path(folder) / "frames.npy"
            np.save(frames, np.stack([scene.image for scene, _ in made]))
            answer = ask("findsat_trails", {"frames": str(frames), "bin_px": BIN_PX}, timeout_s=600.0 if quick else 1800.0)
    except PeerError as error:
        names = [
            *_completeness("findsat_mrt", [], n_each),
            "findsat_mrt_false_per_frame",
            "findsat_mrt_cpu_s",
            "findsat_mrt_over_ours",
        ]
        return result | {name: absent(error) for name in names}
    found_theirs: list[bool] = []
    false_theirs, cpu_theirs = 0, []
    for (scene, _), frame in zip(made, answer["frames"], strict=True):
        cpu_theirs.append(frame["cpu_s"])
        hits = [[on_line(streak, line) for streak in scene.streaks] for line in frame["trails"]]
        found_theirs += [any(row[k] for row in hits) for k in range(len(scene.streaks))]
        false_theirs += sum(not any(row) for row in hits)
    theirs, ours = spread(cpu_theirs), spread(cpu_ours)
    return result | {
        **_completeness("findsat_mrt", found_theirs, n_each),
        "findsat_mrt_false_per_frame": rate(false_theirs, len(made), len(made)),
        "findsat_mrt_cpu_s": theirs,
        "findsat_mrt_over_ours": {
            "value": theirs["value"] / ours["value"],
            "n": len(made),
            "low": theirs["low"] / ours["high"],
            "high": theirs["high"] / ours["low"],
        },
    }


def _completeness(name: str, found: list[bool], n_each: int) -> dict[str, Any]:
    """Share found in each cell."""
    out = {}
    for k, (length, snr) in enumerate(CELLS):
        cell = found[k * n_each : (k + 1) * n_each]
        out[f"{name}_completeness_length{length:g}_snr{snr:g}"] = proportion(sum(cell), len(cell))
    return out


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main("--quick" in sys.argv), indent=1) + "\n")
