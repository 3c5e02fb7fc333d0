"""CPU seconds of one 2048 x 2048 frame with 3,000 stars and 5 streaks of 300 px: this simulator beside SatSim and GalSim.

Each program gets the same pixel scale, PSF sigma (0.85 px), exposure, zero point and read noise, one thread, and four frames of
which the first (set-up, compilation, caches) is not counted. Ours has every effect of its default camera on besides, the
peers what their features allow: SatSim in its quickest mode (ePSF, 3 sub-pixels), GalSim with stamps and its CCD noise.
"""

import json
import math
import resource
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from astropy.utils import iers

from sboc_e2e.catalogue import StarCatalogue
from simulator.chain import Simulator
from simulator.options import SimulatorOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.sources import ObjectOptions, PixelPathOptions
from tests.benchmarks.peers.environment import PeerError, absent, ask, spread

SIZE_PX = 2048
N_STARS = 3000
EXPOSURE_S = 0.2
LENGTH_PX = 300.0
PSF_SIGMA_PX = 0.85
FAINT_LIMIT_MAG = 14.3
"""V down to which the field at the anti-Sun point of the epoch holds about `N_STARS` stars; the real number is reported."""


def trails(n: int) -> list[tuple[float, float, float]]:
    """Row, col of the middle (px) and angle (rad) of streaks wholly inside the frame."""
    rng = np.random.default_rng(20270129)
    return [(*rng.uniform(0.2 * SIZE_PX, 0.8 * SIZE_PX, 2), float(rng.uniform(0.0, math.pi))) for _ in range(n)]


def our_frames() -> dict[str, Any]:
    """CPU seconds of three frames after the first, stars in the frame, peak memory of this process."""
    paths = []
    for row, col, angle in trails(5):
        rate = LENGTH_PX / EXPOSURE_S
        d_row, d_col = math.sin(angle), math.cos(angle)
        paths.append(
            PixelPathOptions(
                name=f"trail {len(paths)}",
                v_mag=9.0,
                row_px=row - 0.5 * LENGTH_PX * d_row,
                col_px=col - 0.5 * LENGTH_PX * d_col,
                row_rate_px_s=rate * d_row,
                col_rate_px_s=rate * d_col,
            )
        )
    base = SimulatorOptions()
    options = replace(
        base,
        frames=4,
        instrument=replace(base.instrument, rows=SIZE_PX, cols=SIZE_PX),
        stars=replace(base.stars, faint_limit_mag=FAINT_LIMIT_MAG),
        population=PopulationOptions(classes=()),
        objects=ObjectOptions(passing=(), pixel_path=tuple(paths)),
    )
    simulator = Simulator(options, seed=1, catalogue=StarCatalogue.embedded())
    costs, n_stars = [], 0
    for k in range(4):
        begin = time.process_time()
        _, truth = simulator.frame(k)
        costs.append(time.process_time() - begin)
        n_stars = len(truth.stars)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"cpu_s": costs[1:], "first_cpu_s": costs[0], "n_stars": n_stars, "peak_mb": peak_mb}


def questions() -> dict[str, dict[str, Any]]:
    """The same scene in the words of each peer."""
    rng = np.random.default_rng(1)
    streaks = []
    for row, col, angle in trails(5):
        rate = LENGTH_PX / EXPOSURE_S
        begin = [(x - 0.5 * LENGTH_PX * d) / SIZE_PX for x, d in ((row, math.sin(angle)), (col, math.cos(angle)))]
        streaks.append([*begin, rate * math.sin(angle), rate * math.cos(angle)])
    flux_e = np.minimum(100.0 * rng.random(N_STARS) ** (-1 / 0.9), 2e5)
    stars = np.column_stack([rng.uniform(0, SIZE_PX, (N_STARS, 2)), flux_e])
    return {
        "satsim_frame": {"size": SIZE_PX, "n_stars": N_STARS, "streaks": streaks, "exposure_s": EXPOSURE_S},
        "galsim_frame": {
            "size": SIZE_PX,
            "stars": stars.tolist(),
            "streaks": [[row, col, LENGTH_PX, math.degrees(angle), 20000.0] for row, col, angle in trails(5)],
            "sigma_px": PSF_SIGMA_PX,
        },
    }


def main(quick: bool) -> dict[str, Any]:
    """CPU seconds for each frame of each program, peak memory, and their ratios to ours."""
    iers.conf.auto_download = False
    ours = our_frames()
    result: dict[str, Any] = {
        "ours_cpu_s": spread(ours["cpu_s"]),
        "ours_stars_above_snr5": {"value": ours["n_stars"], "n": 1, "low": ours["n_stars"], "high": ours["n_stars"]},
        "ours_peak_mb": {"value": ours["peak_mb"], "n": 1, "low": ours["peak_mb"], "high": ours["peak_mb"]},
    }
    for script, question in questions().items():
        name = script.removesuffix("_frame")
        try:
            answer = ask(script, question, timeout_s=300.0 if quick else 900.0)
        except PeerError as error:
            result |= {f"{name}_{what}": absent(error) for what in ("cpu_s", "over_ours", "peak_mb")}
            continue
        result[f"{name}_cpu_s"] = spread(answer["cpu_s"])
        low, high = min(answer["cpu_s"]) / max(ours["cpu_s"]), max(answer["cpu_s"]) / min(ours["cpu_s"])
        ratio = result[f"{name}_cpu_s"]["value"] / result["ours_cpu_s"]["value"]
        result[f"{name}_over_ours"] = {"value": ratio, "n": len(answer["cpu_s"]), "low": low, "high": high}
        result[f"{name}_peak_mb"] = {"value": answer["peak_mb"], "n": 1, "low": answer["peak_mb"], "high": answer["peak_mb"]}
    return result


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main("--quick" in sys.argv), indent=1) + "\n")
