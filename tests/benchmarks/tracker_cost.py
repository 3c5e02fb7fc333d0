"""CPU time of the on-board chain by tracker, on the same frames in one process, in turns.

``python -m tests.benchmarks.tracker_cost [--frames 24] [--seed 5] [--trackers none joint joint_and_stack]`` simulates frames of
4096 x 4096 px with the defaults. Each chain takes each frame, in an order that turns from frame to frame. Frames count
from the one on that fills the window. Before each frame the yardstick of the benchmark report is timed: times are also given as
the machine of the stored baseline would have taken.
"""

import argparse
import json
import sys
import time
from importlib import import_module
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain, OnboardSteps
from onboard.detect import LineIntegralDetector
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.options import OnboardOptions
from onboard.stars.matched import MatchedStars
from sboc_e2e.bench.baseline import read_baseline
from sboc_e2e.bench.run_bench import baseline_file
from sboc_e2e.bench.yardstick import yardstick_s
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.score.figures import Figure, bootstrap
from simulator.chain import Simulator
from simulator.options import SimulatorOptions
from tests.benchmarks.onboard_process import TRACKERS

WARM_UP: Final = 7
"""First frames, which do not count: the window of `joint` fills with them, and kernels are loaded."""


def chain_of(tracker: str, simulator: Simulator) -> OnboardChain:
    """The chain as the scenarios have it, with a tracker."""
    module, name = TRACKERS[tracker]
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=LineIntegralDetector(), codec=PlanesCodec(),
        tracker=getattr(import_module(module), name)(),
    )  # fmt: skip
    calibration = simulator.calibration()
    return OnboardChain(OnboardOptions(), steps, calibration=calibration, camera=calibration.camera, run_id=1)


def main(n_frames: int, seed: int, trackers: list[str]) -> dict[str, Any]:
    """Mean CPU-seconds of a frame by tracker; over those of the first one, by frame; as the baseline's machine takes."""
    simulator = Simulator(SimulatorOptions(frames=n_frames), seed=seed, catalogue=StarCatalogue.embedded())
    chains = {name: chain_of(name, simulator) for name in trackers}
    states = {name: chain.initial_state() for name, chain in chains.items()}
    spent: dict[str, list[float]] = {name: [] for name in trackers}
    yardstick = []
    for number in range(n_frames):
        frame = simulator.frame(number)[0]
        yardstick.append(yardstick_s())
        for name in trackers if number % 2 else reversed(trackers):
            began = time.process_time()
            states[name], _ = chains[name].process(states[name], frame)
            spent[name].append(time.process_time() - began)
    counted = {name: np.array(s[WARM_UP:]) for name, s in spent.items()}
    speed = read_baseline(baseline_file(quick=False))["onboard.yardstick_s"]["value"] / np.array(yardstick[WARM_UP:])
    return {
        "frames": n_frames - WARM_UP,
        "cpu_s": {name: shown(s) for name, s in counted.items()},
        "times_first": {name: shown(s / counted[trackers[0]]) for name, s in counted.items()},
        "cpu_s_of_baseline_machine": {name: shown(s * speed) for name, s in counted.items()},
    }


def shown(values: NDArray[np.float64]) -> Figure:
    """The mean with its 90 % interval."""
    return bootstrap(values, lambda v: float(np.mean(v)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--trackers", nargs="+", choices=tuple(TRACKERS), default=["none", "joint"])
    chosen = parser.parse_args()
    sys.stdout.write(json.dumps(main(chosen.frames, chosen.seed, chosen.trackers), indent=1) + "\n")
