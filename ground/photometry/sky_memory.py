"""Level of the sky under the trails: the meshes of a run's frames averaged for as long as the sky stays the same.

The mesh of one frame errs by 0.02 of a pixel's noise (sampling of its tiles, step of its transmission) and holds a per cent of
the light of the trails that cross its tiles. This does not matter for one pixel, but a trail of 150 px sums it to a third of a
sigma of its flux. Both errors change from frame to frame while the sky does not. A Kalman filter of the nodes, with one variance
for all of them, follows changes that exceed the scatter.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import DownlinkFrame

LARGEST_SCATTER: Final = 0.04
"""Largest scatter of a node from frame to frame, in pixel sigmas. A larger scatter means that the sky changes."""

CLIP_SIGMAS: Final = 3.5
"""One node in 2,000 of a steady sky is beyond it; a trail is brighter."""
ROUNDS: Final = 3
"""Each round takes out what the one before had made visible; a trail holds few nodes. Chosen, not measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SkyMemory:
    """Filtered sky of the frames so far; picklable.

    level_adu : (rows, cols) filtered level less its mean. latest_adu : of the last frame alone. variance_adu2 : of a node of the
    first; NaN after one frame. settings : what must not change: tile, gain, exposure, window.
    """

    level_adu: NDArray[np.float64]
    latest_adu: NDArray[np.float64]
    variance_adu2: float
    settings: tuple[object, ...]


def filtered_sky(memory: SkyMemory | None, frame: DownlinkFrame) -> tuple[SkyMemory | None, DownlinkFrame]:
    """The memory after a frame, and the frame with the filtered level in place of its own."""
    mesh, header = frame.background, frame.header
    if mesh is None or not np.isfinite(mesh.level_adu).all():
        return memory, frame
    settings = (
        mesh.tile_px, mesh.level_adu.shape, header.gain_e_adu, header.exposure_ns, header.window_row0, header.window_col0,
    )  # fmt: skip
    measured = mesh.level_adu.astype(np.float64)
    middle = float(measured.mean())
    latest = measured - middle
    if memory is None or memory.settings != settings:
        return SkyMemory(level_adu=latest, latest_adu=latest, variance_adu2=float("nan"), settings=settings), frame
    scatter2 = 0.5 * _spread2(latest - memory.latest_adu)
    noise2 = max(min(scatter2, (LARGEST_SCATTER * float(np.median(mesh.sigma_adu))) ** 2), 1e-12)
    innovation = latest - memory.level_adu
    # The scatter of the innovations beyond the frame's own noise is the error of the memory.
    before2 = max(np.nan_to_num(memory.variance_adu2), _spread2(innovation) - noise2)
    gain = before2 / (before2 + noise2)
    offset = float(innovation.mean())
    level = memory.level_adu + gain * (innovation - offset)
    after = SkyMemory(level_adu=level, latest_adu=latest, variance_adu2=gain * noise2, settings=settings)
    return after, replace(frame, background=replace(mesh, level_adu=(middle + offset + level).astype(np.float32)))


def _spread2(values: NDArray[np.float64]) -> float:
    """Variance without the few nodes that hold a trail. Levels come in coarse steps, so that their median says nothing."""
    kept = values
    for _ in range(ROUNDS):
        kept = kept[np.abs(kept - kept.mean()) <= CLIP_SIGMAS * kept.std()]
    return float(kept.var())
