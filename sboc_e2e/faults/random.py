"""Random streams of the faults. They are independent of the simulator's streams, so that the same frames are hit in all runs."""

from enum import IntEnum

import numpy as np


class FaultStream(IntEnum):
    """Numbers of the streams, append only; simulator effects use numbers below 1000."""

    PACKETS = 1001
    FRAMES = 1002
    ATTITUDE = 1003


def generator(seed: int, stream: FaultStream, frame: int = 0) -> np.random.Generator:
    """The stream of a kind of fault, for one frame or for the run."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), frame, 0)))
