"""Structure of the sky that is finer than the mesh: ripples, glow, edges of stray light.

A wave of 0.3 sigma and 200 px adds 5 to the S/N of every line of 100 px along its crests. Tiles of the mesh show it: their means
differ from the interpolated level by more than their own noise. Only there, the level is measured again on tiles of half the
size, because a finer mesh takes light from trails: 4 % of their S/N.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.image.background import fill_gaps, straight_neighbourhoods

STRUCTURED: Final = 4.0
"""Mean square of the tiles' departures over their noise from which a neighbourhood has structure; plain sky shows 1 to 2."""

WEAKER: Final = 2.2  # the weaker limit: plain sky shows 1 to 2
WIDESPREAD: Final = 0.05
"""Where so large a share of a frame has structure, weaker structure is believed too."""

BENT_SIGMA: Final = 0.12
"""Second difference of the level from one tile to the next, over the noise, from which a neighbourhood bends. A straight line
leaves an eighth of it between nodes and three eighths at the edge of the frame. Plain sky shows 0.01, slopes 0.02, and 0.05 at
most in 8,000 neighbourhoods."""

FIT_NODES: Final = 5  # three have a parabola through them, which smooths nothing; seven give their own tile a third only
APART_SIGMA: Final = 4.0
"""A tile that departs from the parabola by this many sigmas of its mean has light of its own."""

MOST_BEND: Final = 0.5
"""Second difference of the fine nodes at the edge of the frame, in sigma, that is believed."""

REACH_TILES: Final = 2
"""Half width of a neighbourhood in tiles."""


def box_mean(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Mean over squares of 2 reach + 1 cells, cut at the edges; same shape."""
    total, number = values, np.ones(values.shape)
    for axis in (0, 1):
        total, number = (_running(part, axis, reach) for part in (total, number))
    return np.asarray(total / number)


def _running(values: NDArray[np.float64], axis: int, reach: int) -> NDArray[np.float64]:
    pad = [(0, 0), (0, 0)]
    pad[axis] = (reach + 1, reach)
    sums = np.cumsum(np.pad(values, pad), axis=axis)
    n, width = values.shape[axis], 2 * reach + 1
    return np.asarray(np.take(sums, range(width, width + n), axis=axis) - np.take(sums, range(n), axis=axis))


def structured_tiles(mean: NDArray[np.float32], sigma: NDArray[np.float32], samples: int) -> NDArray[np.bool_]:
    """Tiles whose neighbourhood departs from its mesh. mean : (tile rows, tile cols), of `samples` values of noise sigma each."""
    known = np.isfinite(mean)
    departure = np.where(known, mean, 0.0).astype(np.float64) / np.maximum(sigma, 1e-9) * math.sqrt(samples)
    # A tile with other light does not count for its neighbours.
    square = np.minimum(departure**2, 6.0 * STRUCTURED)
    found = box_mean(square, REACH_TILES) / np.maximum(box_mean(known.astype(np.float64), REACH_TILES), 1e-9)
    return np.asarray(found > (WEAKER if (found > STRUCTURED).mean() > WIDESPREAD else STRUCTURED))


def bent_tiles(level: NDArray[np.float32], sigma: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Tiles about which the mesh bends so much that straight lines between its nodes leave light. level, sigma : of the nodes."""
    square = np.zeros(level.shape)
    smooth = straight_neighbourhoods(level, float(np.median(sigma))).mean(axis=0, dtype=np.float64)
    for axis in (0, 1):
        if level.shape[axis] > 2:
            bend = np.diff(np.moveaxis(smooth, axis, 0), 2, axis=0)
            square += np.moveaxis(np.pad(bend, [(1, 1), (0, 0)], mode="edge"), 0, axis) ** 2
    # One tile that bends is a bright star's.
    square = np.minimum(square / np.maximum(sigma, 1e-9) ** 2, 6.0 * BENT_SIGMA**2)
    return np.asarray(box_mean(square, REACH_TILES) > BENT_SIGMA**2)


def _fits(n: int) -> NDArray[np.float64]:
    """Matrix (n, n) that takes values at n nodes to those of parabolas fitted to the `FIT_NODES` nodes about each.

    Nodes too near an end keep their value: a parabola fitted to one side of a node is off by the third derivative.
    """
    half = FIT_NODES // 2
    powers = np.vander(np.arange(-half, half + 1.0), 3)
    weights = (powers @ np.linalg.pinv(powers))[half]
    fits = np.eye(n)
    for k in range(half, n - half):
        fits[k, k - half : k + half + 1] = weights
    return fits


def followed(mean: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means of tiles smoothed by parabolas both ways; those that no parabola follows, by their noise, stay as they are.

    A tile w px wide holds 1 / (0.332 w) of the light of a trail that crosses it: a tenth, with w = 32. A parabola over five tiles
    gives its own tile a weight of a half, and a wave of 200 px keeps 7 % of its height.
    """
    along, across = (_fits(n) for n in mean.shape)
    first = along @ mean @ across.T
    apart = np.abs(mean - first) > APART_SIGMA * noise
    second = along @ np.where(apart, first, mean) @ across.T
    return np.where(apart, mean, second)


def fine_nodes(mean: NDArray[np.float32], noise: NDArray[np.float32], structured: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Nodes of a mesh whose linear interpolation has the given means over its tiles, 0 where nothing is structured.

    The mean of an interpolated line over the tile of a node is 6/8 of it and 1/8 of each neighbour. Beyond the edge of the frame
    the neighbour is that of `continued_on_parabolas`.
    """
    smooth = followed(fill_gaps(mean, 0.0).astype(np.float64), noise.astype(np.float64))
    nodes = np.where(structured, smooth, 0.0)
    for axis in (0, 1):
        if nodes.shape[axis] > 2:
            bend = np.diff(np.moveaxis(nodes, axis, 0), 2, axis=0)
            nodes = nodes - 0.125 * np.moveaxis(np.pad(bend, [(1, 1), (0, 0)], mode="edge"), 0, axis)
    return nodes.astype(np.float32)


def continued_on_parabolas(nodes: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    """The mesh with one node more on each side, on the parabola of the three outer ones; (rows + 2, cols + 2).

    A wave of 0.3 sigma and 200 px bends by 0.3 sigma from one fine node to the next. A straight line would leave half of that
    along the edge, where a trail of 1,000 px then comes out at S/N 8. A bend of more than `MOST_BEND` sigma is cut to that.
    """
    for axis in (0, 1):
        mesh = np.moveaxis(nodes, axis, 0)
        if len(mesh) > 2:
            bend = np.clip(np.diff(mesh, 2, axis=0)[[0, -1]], -MOST_BEND * sigma, MOST_BEND * sigma)
            before, after = 2.0 * mesh[0] - mesh[1] + bend[0], 2.0 * mesh[-1] - mesh[-2] + bend[1]
        else:
            before, after = mesh[0], mesh[-1]
        nodes = np.moveaxis(np.concatenate((before[None], mesh, after[None])), 0, axis)
    return np.asarray(nodes, dtype=np.float32)
