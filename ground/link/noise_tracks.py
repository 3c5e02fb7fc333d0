"""Whether the light that an on-board track joins is an object's, or the highest of very many sums of noise.

The search on board takes the best of all tracks, and what noise adds to a sum there it adds at the pixels, path and ends of that
search. Ground weighs whole pixels. In 984 simulated frames (`sso_faint`, with and without debris, 2026-11-29) ground's joint S/N
of 41 tracks of noise was 0.9 less than the one on board, and that of 122 faint objects 0.2 less. So the mean of both tells more
than either: 35 of the 41 have less than 7.4, and five of the 122.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

NOISE_SNR: Final = 7.5
"""Mean of the S/N on board and on ground at which ..."""

NOISE_PER_FRAME: Final = 0.015
"""... noise makes so many tracks for each unit of S/N in a frame of `SIDE_PX` ..."""

FALL: Final = 4.0
"""... and e to this power fewer for each unit more: twelve of the 41 have 7.2 and more, 7.47 on average."""

MOST_FALSE: Final = 0.006
"""Tracks of noise as bright as one that is published, for each frame."""

SIDE_PX: Final = 4096
"""In smaller frames fewer tracks are tried."""

SURE_SNR: Final = 8.5
"""Noise makes a track of this S/N once in 15,000 frames."""

FLUX_LAW: Final = 2.0
"""Objects brighter than S are as many as S to this power less: between disks of one size (2.0 in flux of their cross-section)
and fragments (2.5). Where nothing is lost, 0.34 of those beyond `SURE_SNR` lie in a unit about `NOISE_SNR`."""

BEFORE_ANY: Final = 0.5
"""Objects beyond `SURE_SNR` that a run is expected to hold before it is looked at."""


def joint_snr(snr: NDArray[np.float64]) -> float:
    """S/N of the light of frames (n,) together, each with the same share of the noise.

    Each frame's fit puts the light where it is brightest across, which adds one to its square.
    """
    return float(np.sqrt(np.maximum(np.nan_to_num(snr) ** 2 - 1.0, 0.0)).sum()) / math.sqrt(max(len(snr), 1))


def noise_per_frame(snr: NDArray[np.float64], shape: tuple[float, float]) -> NDArray[np.float64]:
    """Tracks of noise for each unit of the mean S/N (k,) in a frame of `shape` px.

    They are as many as there are tracks to try, by area times longest trail.
    """
    share = shape[0] * shape[1] * math.hypot(*shape) / (math.sqrt(2.0) * float(SIDE_PX) ** 3)
    return NOISE_PER_FRAME * share * np.exp(FALL * (NOISE_SNR - snr))


def log_odds_of_tracks(snr: NDArray[np.float64], n_frames: int, shape: tuple[float, float]) -> NDArray[np.float64]:
    """Natural log odds (k,) that tracks are objects, by the mean of their joint S/N (k,) on board and on ground.

    How many objects there are the run itself says, by those that are sure. -inf where noise makes more than `MOST_FALSE`.
    """
    sure = float(np.count_nonzero(snr > SURE_SNR)) + BEFORE_ANY
    snr = np.clip(snr, 1.0, 100.0)
    objects = sure * FLUX_LAW * SURE_SNR**FLUX_LAW / snr ** (FLUX_LAW + 1.0) / max(n_frames, 1)
    noise = noise_per_frame(snr, shape)
    return np.where(noise > FALL * MOST_FALSE, -np.inf, np.log(objects) - np.log(noise))
