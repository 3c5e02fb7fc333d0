"""Slopes of the sky at the borders of a frame that nobody calibrated: the edge of a vignetted field.

The level falls there within some ten pixels, faster than the mesh of the sky (64 px) follows. What is left looks like lines
along the border, as bright as satellites. Such an edge runs along the border, and a trail crosses it. So the level is taken from
medians that are long along the border and short across it. What of it bends is subtracted. A trail within 2 deg of the border's
direction loses a part of its light.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import scipy  # scipy.ndimage is loaded where it is used: small frames have no slopes
from numpy.typing import NDArray

from sboc_e2e.icd.frame import Frame
from sboc_e2e.outside.frame_source import Calibrating, Note, SourcedFrame

DEPTH_PX: Final = 256
"""Depth of the zone along a border: an edge seen 60 px wide began 180 px inside the frame. Chosen, not measured."""
LEAST_SIDE_PX: Final = 3 * DEPTH_PX
"""Smaller frames have no middle that a border could differ from."""

ACROSS_PX: Final = 4
"""Side of a tile across the border. A tile of 4 by 32 px tells its level to 0.11 of a pixel's noise."""
ALONG_PX: Final = 32
"""Side of a tile along the border; see `ACROSS_PX`."""

MEDIAN_TILES: Final = 7
"""Tiles along the border whose median is taken: 224 px, so that stars, ghosts and trails that cross are left out."""

INNER_TILES: Final = 15
"""The same for the level at the inner side of the zone: 480 px, more than a ghost is wide (170 px seen)."""

SMOOTH_TILES: Final = 1.0
"""Sigma of the smoothing across the border, in tiles, done twice to follow what bends (Tukey's twicing)."""

MESH_PX: Final = 64
"""Tiles of the mesh that follows the sky afterwards."""

LEAST_BEND: Final = 0.4
"""Departure of the level from straight lines between the nodes of that mesh (rms, in noise of a pixel) from which it is
subtracted. Noise alone shows 0.15, gentle vignetting 0.15 to 0.2, the edge of a field 0.9 to 5 (two cameras)."""


def without_slopes(pixels: NDArray[Any]) -> tuple[NDArray[Any], tuple[str, ...]]:
    """A frame (rows, cols), NaN where there is no number, without the slopes of its borders, and the borders that had some.

    Pixels come back as they are where there are none.
    """
    if min(pixels.shape) < LEAST_SIDE_PX:
        return pixels, ()
    noise = noise_of(pixels)
    if not noise > 0.0:
        return pixels, ()
    out = np.asarray(pixels, dtype=np.float32)
    borders: list[str] = []
    for name, turned in _BORDERS:
        zone = turned(out)
        slope = _slope(zone, noise)
        if slope is not None:
            if not borders:
                out = out.copy()
                zone = turned(out)
            first, excess = slope
            zone[first : first + len(excess)] -= excess
            borders.append(name)
    return (out, tuple(borders)) if borders else (pixels, ())


_BORDERS: Final[tuple[tuple[str, Any], ...]] = (
    ("left", lambda image: image.T),
    ("right", lambda image: image.T[::-1]),
    ("lower", lambda image: image),
    ("upper", lambda image: image[::-1]),
)
"""Views of a frame whose first line is that border."""


def noise_of(pixels: NDArray[Any]) -> float:
    """Noise of a pixel, from differences of neighbours; 0 where none is known.

    In smoothed pictures it is less than `pixel_unit.noise_adu`, and `LEAST_BEND` was chosen with it: with the other number 92 of
    315 frames have other slopes.
    """
    steps = np.abs(np.diff(np.asarray(pixels[::8], dtype=np.float32), axis=1))
    steps = steps[np.isfinite(steps)]
    return 1.4826 * float(np.median(steps)) / np.sqrt(2.0) if steps.size else 0.0


def _slope(image: NDArray[np.float32], noise: float) -> tuple[int, NDArray[np.float32]] | None:
    """First line of the zone below a border and what is to be subtracted from it; None where the mesh follows the sky.

    image : the border is its first line.
    """
    seen = np.isfinite(image[:, :: ALONG_PX // 2]).mean(axis=1) > 0.5
    first = int(np.argmax(seen))
    zone = image[first : first + DEPTH_PX]
    if not seen.any() or len(zone) < DEPTH_PX:
        return None
    tiles = _tiles(zone)
    if not np.isfinite(tiles).all():
        return None
    level = _smooth(_running_median(tiles))
    bend = level - _on_mesh(level)
    if float(np.sqrt(np.mean(bend**2))) < LEAST_BEND * noise:
        return None
    return first, _expanded(level - _tangent(level), zone.shape)


def _tiles(zone: NDArray[np.float32]) -> NDArray[np.float64]:
    """Medians of tiles (across, along); those without numbers from their neighbours along the border."""
    along = zone.shape[1] // ALONG_PX
    cut = zone[:, : along * ALONG_PX].reshape(DEPTH_PX // ACROSS_PX, ACROSS_PX, along, ALONG_PX).swapaxes(1, 2)
    flat = cut.reshape(*cut.shape[:2], -1)
    known = np.isfinite(flat).sum(axis=-1)
    if known.min() == flat.shape[-1]:
        half = (flat.shape[-1] - 1) // 2
        return np.partition(flat, half, axis=-1)[..., half].astype(np.float64)
    flat = np.sort(flat, axis=-1)  # NaN last
    middle = np.take_along_axis(flat, (np.maximum(known - 1, 0) // 2)[..., None], axis=-1)[..., 0].astype(np.float64)
    middle[known < flat.shape[-1] // 4] = np.nan
    for line in middle:
        good = np.isfinite(line)
        if good.any() and not good.all():
            line[~good] = np.interp(np.flatnonzero(~good), np.flatnonzero(good), line[good])
    return middle


def _running_median(tiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Medians along the border over windows that shrink evenly towards its ends, so that a tilted edge stays in place."""
    n = tiles.shape[1]
    out = np.empty_like(tiles)
    for k in range(n):
        reach = min(MEDIAN_TILES // 2, k, n - 1 - k)
        out[:, k] = np.median(tiles[:, k - reach : k + reach + 1], axis=1)
    return out


def _smooth(level: NDArray[np.float64]) -> NDArray[np.float64]:
    once = scipy.ndimage.gaussian_filter1d(level, SMOOTH_TILES, axis=0, mode="nearest")
    return np.asarray(once + scipy.ndimage.gaussian_filter1d(level - once, SMOOTH_TILES, axis=0, mode="nearest"))


def _on_mesh(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same level as the mesh shows it: means of its tiles across the border, with straight lines between them."""
    per = MESH_PX // ACROSS_PX
    nodes = level.reshape(-1, per, level.shape[1]).mean(axis=1)
    at = (np.arange(len(level)) + 0.5) / per - 0.5
    low = np.clip(np.floor(at).astype(np.int64), 0, len(nodes) - 2)
    share = (at - low)[:, None]
    return np.asarray(nodes[low] * (1.0 - share) + nodes[low + 1] * share)


def _tangent(level: NDArray[np.float64]) -> NDArray[np.float64]:
    """The straight line that the level has at the zone's inner side, carried on to the border, so that nothing bends there.

    One slope for the whole border, and levels from medians along it: a ghost or a bright column at the inner side is none of it.
    """
    per = MESH_PX // ACROSS_PX
    inner, before = (np.median(level[part], axis=0) for part in (slice(-per, None), slice(-2 * per, -per)))
    slope = float(np.median(inner - before)) / per
    last = scipy.ndimage.median_filter(inner, INNER_TILES, mode="nearest")
    return np.asarray(last + (np.arange(len(level))[:, None] - (len(level) - 0.5 * (per + 1))) * slope)


def _expanded(tiles: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Tiles interpolated to the pixels of the zone; at its inner side they fade to nothing over a tile of the mesh."""
    row = (np.arange(shape[0]) + 0.5) / ACROSS_PX - 0.5
    col = (np.arange(shape[1]) + 0.5) / ALONG_PX - 0.5
    out = scipy.ndimage.map_coordinates(tiles, np.meshgrid(row, col, indexing="ij"), order=1, mode="nearest")
    fade = np.clip((shape[0] - np.arange(shape[0])) / MESH_PX, 0.0, 1.0)
    return np.asarray(out * fade[:, None], dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class WithoutSlopes(Calibrating):
    """A `FrameSource` whose frames have no slopes at their borders."""

    def frames(self) -> Iterator[SourcedFrame]:
        """The frames; those that had slopes say so in a note."""
        for each in self.source.frames():
            pixels, borders = without_slopes(each.frame.pixels)
            if borders:
                full = each.frame.header.saturation_adu
                if full is not None:
                    pixels = np.where(each.frame.pixels >= full, each.frame.pixels, pixels).astype(np.float32)
                note = Note(kind="slopes", text=f"steep sky subtracted at these borders: {', '.join(borders)}")
                frame = Frame(header=each.frame.header, pixels=np.ascontiguousarray(pixels))
                each = replace(each, frame=frame, notes=(*each.notes, note))
            yield each
