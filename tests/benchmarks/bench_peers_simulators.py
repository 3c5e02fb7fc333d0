"""CPU seconds of one frame with 3,000 stars and 5 streaks of 300 px, 2048 and 4096 px wide: ours beside SatSim and GalSim.

Each program gets the same pixel scale, PSF sigma (0.85 px), exposure, zero point and read noise, one thread, and frames of
which the first (set-up, compilation, caches) is not counted. What each renders:

ours    everything of the default camera: orbit and pointing with jitter, rolling shutter, aberration, distortion,
        field-dependent PSF, zodiacal light, vignetting, particle tracks by Bethe-Bloch, exact Poisson noise at low levels,
        dark current, fixed pattern, hot and telegraph pixels, row, column and read noise, non-linearity, two amplifiers,
        header, truth of stars and streaks; `ours_all_stars`: with 30,000 stars (4096 x 4096 px) and 12 streaks
SatSim  its quickest mode (ePSF, 3 sub-pixels): stars, streaks, even background, shot and read noise, full well, 14 bit
GalSim  a stamp for each star, boxes convolved with the PSF, even background, shot and read noise, 16 bit
numpy   no scene at all: exact Poisson of an even background, normal read noise, converter

Ours is measured before and after the peers, since other work on the machine slows all of them.
"""

import json
import math
import sys
from functools import partial
from typing import Any

import numpy as np

from tests.benchmarks.bench_simulator_sensor import SKY_E, cpu_s, numpy_floor
from tests.benchmarks.peers.environment import PeerError, absent, ask, spread
from tests.benchmarks.simulator_process import ALL_STARS_MAG, EXPOSURE_S, LENGTH_PX, trails
from tests.benchmarks.simulator_process import ask as ask_ours

N_STARS = 3000
PSF_SIGMA_PX = 0.85
FAINT_LIMIT_MAG = {2048: 14.3, 4096: 12.7}
"""V down to which a field of that size at the anti-Sun point of the epoch holds about `N_STARS` stars; the number is reported."""


def questions(size_px: int) -> dict[str, dict[str, Any]]:
    """The same scene in the words of each peer."""
    rng = np.random.default_rng(1)
    streaks = []
    for row, col, angle in trails(5, size_px):
        rate = LENGTH_PX / EXPOSURE_S
        begin = [(x - 0.5 * LENGTH_PX * d) / size_px for x, d in ((row, math.sin(angle)), (col, math.cos(angle)))]
        streaks.append([*begin, rate * math.sin(angle), rate * math.cos(angle)])
    flux_e = np.minimum(100.0 * rng.random(N_STARS) ** (-1 / 0.9), 2e5)
    stars = np.column_stack([rng.uniform(0, size_px, (N_STARS, 2)), flux_e])
    return {
        "satsim_frame": {"size": size_px, "n_stars": N_STARS, "streaks": streaks, "exposure_s": EXPOSURE_S},
        "galsim_frame": {
            "size": size_px,
            "stars": stars.tolist(),
            "streaks": [[row, col, LENGTH_PX, math.degrees(angle), 20000.0] for row, col, angle in trails(5, size_px)],
            "sigma_px": PSF_SIGMA_PX,
        },
    }


def exact(value: float) -> dict[str, Any]:
    """A figure measured once."""
    return spread([value])


def ratio(above: list[float], below: list[float]) -> dict[str, Any]:
    """Ratio of medians, with the least and the largest that the repeats allow."""
    value = spread(above)["value"] / spread(below)["value"]
    return {"value": value, "n": len(above), "low": min(above) / max(below), "high": max(above) / min(below)}


def one_size(size_px: int, timeout_s: float) -> dict[str, Any]:
    """All programs at one frame size."""
    mean_e = np.full((size_px, size_px), SKY_E, dtype=np.float32)
    scenes = {"ours": (FAINT_LIMIT_MAG[size_px], 5), "ours_all_stars": (ALL_STARS_MAG, 12)}
    first = {name: ask_ours(size_px, *scene) for name, scene in scenes.items()}
    costs = {"numpy_floor": [cpu_s(partial(numpy_floor, mean_e), 1) for _ in range(3)]}
    result: dict[str, Any] = {}
    for script, question in questions(size_px).items():
        name = script.removesuffix("_frame")
        try:
            answer = ask(script, question, timeout_s=timeout_s)
        except PeerError as error:
            result |= {f"{name}_{what}": absent(error) for what in ("cpu_s", "over_ours", "peak_mb")}
            continue
        costs[name] = answer["cpu_s"]
        result[f"{name}_peak_mb"] = exact(answer["peak_mb"])
    for name, scene in scenes.items():
        again = ask_ours(size_px, *scene)
        costs[name] = first[name]["cpu_s"] + again["cpu_s"]
        result[f"{name}_stars_above_snr5"] = exact(again["n_stars"])
        result[f"{name}_peak_mb"] = spread([first[name]["peak_mb"], again["peak_mb"]])
    for name, values in costs.items():
        result[f"{name}_cpu_s"] = spread(values)
        if name != "ours":
            result[f"{name}_over_ours"] = ratio(values, costs["ours"])
    return result


def main(quick: bool) -> dict[str, Any]:
    """CPU seconds for each frame of each program, peak memory, and their ratios to ours; `quick`: the smaller frame only."""
    sizes = [2048] if quick else [2048, 4096]
    return {f"{size_px}_px": one_size(size_px, 300.0 if quick else 900.0) for size_px in sizes}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main("--quick" in sys.argv), indent=1) + "\n")
