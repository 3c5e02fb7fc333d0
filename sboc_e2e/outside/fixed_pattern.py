"""Frames of one camera calibrate each other: what stays on its pixels while the stars move is subtracted.

Without a dark and a flat, vignetting, dust rings, warm columns and hot pixels stay in a frame, and lines are found in them.
The median over frames of one camera shows them. It is smoothed where it holds noise alone, and it is used only where two halves
of the frames agree on it. It is subtracted and not divided by, since nobody tells the bias; the light of streaks keeps the
flat's few per cent.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import scipy  # scipy.ndimage is loaded where it is used: a frame alone has no pattern
from numpy.typing import NDArray

from sboc_e2e.icd.frame import Frame
from sboc_e2e.outside.frame_source import Calibrating, Note, SourcedFrame
from sboc_e2e.outside.same_exposure import Mark, note_of, same_exposures

LEAST_FRAMES: Final = 3
"""With two, nobody can tell which of them has a star."""

MOST_FRAMES: Final = 15
"""The noise of a median of 15 is a third of one frame's; after `SMOOTH_PX` it is below a twentieth. More frames cost memory."""
MOST_PIXELS: Final = 100_000_000
"""Frames, and pixels of them together, that a pattern is made of; evenly taken from all."""

TILE_PX: Final = 32
"""Of the level that sources are told against. Chosen, not measured: smaller tiles take large stars for sky."""
SOURCE_BOX_PX: Final = 3
"""Side of the box whose mean is compared: about a star's width. Its noise is that of a pixel over this number."""
SOURCE_SIGMAS: Final = 5.0
"""Of a box's mean: 3e-7 of the pixels of plain noise are above it, five in a frame of 4096 x 4096."""
GROWN_PX: Final = 3
"""Light: boxes this far above the median of their tile, grown by `GROWN_PX`."""

SMOOTH_PX: Final = 2.0
"""Sigma of the smoothing: the noise of three frames' median falls to a tenth of one frame's; dust rings are wider."""

LINE_SIGMAS: Final = 5.0
"""Of the median along a line; of 8,192 lines of plain noise 0.005 exceed it. Fainter lines stay as they are."""
HOT_SIGMAS: Final = 8.0
"""Of the median over frames: Gaussian noise lifts one pixel in 1e15 above it. Chosen, not measured: less masks more of the
sky."""
LEAST_AGREEMENT: Final = 0.5
"""Correlation of the patterns of two halves of the frames from which on it counts as one camera's."""

FEWEST_STEPS: Final = 200
"""Differences of neighbouring pixels that tell the noise, to 8 %: 1.17 over their root. The smallest frame has 240."""

LEAST_LEVEL_SIGMAS: Final = 3.0
"""A sky level of less than so much noise of a pixel scales nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FixedPattern:
    """excess : (rows, cols) float32, light that stays on its pixel over the level of the sky, in units of that level.

    hot : (rows, cols) pixels that differ from their neighbours in all frames. n_frames : that it was made of.
    """

    excess: NDArray[np.float32]
    hot: NDArray[np.bool_]
    n_frames: int


def level_of(pixels: NDArray[Any]) -> float:
    """Level of the sky of a frame: the median of its pixels."""
    return float(np.nanmedian(pixels))


def without_sources(pixels: NDArray[Any]) -> tuple[NDArray[np.float32], float] | None:
    """Pixels in units of the sky's level, NaN about everything bright; and the noise of a pixel in that unit.

    None where too few pixels have a number beside them for their noise.
    """
    level = level_of(pixels)
    scaled = np.asarray(pixels, dtype=np.float32) / np.float32(level)
    steps = np.abs(np.diff(scaled, axis=1))
    steps = steps[np.isfinite(steps)]  # masked pixels, all alike, would tell a noise of 0
    if steps.size < FEWEST_STEPS:
        return None
    noise = 1.4826 * float(np.median(steps)) / np.sqrt(2.0)
    known = np.nan_to_num(scaled, nan=1.0)
    excess = scipy.ndimage.uniform_filter(known - _tile_medians(known), SOURCE_BOX_PX)
    bright = excess > SOURCE_SIGMAS * noise / SOURCE_BOX_PX
    scaled[scipy.ndimage.binary_dilation(bright, iterations=GROWN_PX)] = np.nan
    return scaled, noise


def _tile_medians(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median of tiles, interpolated to the pixels of an image."""
    rows, cols = image.shape
    down, over = -(-rows // TILE_PX), -(-cols // TILE_PX)
    padded = np.pad(image, ((0, down * TILE_PX - rows), (0, over * TILE_PX - cols)), mode="reflect")
    tiles = np.median(padded.reshape(down, TILE_PX, over, TILE_PX).swapaxes(1, 2).reshape(down, over, -1), axis=-1)
    row = (np.arange(rows) + 0.5) / TILE_PX - 0.5
    col = (np.arange(cols) + 0.5) / TILE_PX - 0.5
    at = np.meshgrid(row, col, indexing="ij")
    return np.asarray(scipy.ndimage.map_coordinates(tiles, at, order=1, mode="nearest"), dtype=np.float32)


def fixed_pattern(images: Sequence[NDArray[Any]]) -> FixedPattern | None:
    """The pattern of frames of one camera; None where two halves of them do not agree, where the sky is too faint to scale it,
    and where nearly all pixels are masked.

    images : three or more (rows, cols), NaN where there is no number.
    """
    scaled, noises = [], []
    for image in images:
        level = level_of(image)
        if not level > 0.0:
            return None
        told = without_sources(image)
        if told is None:
            return None
        one, noise = told
        if noise * LEAST_LEVEL_SIGMAS > 1.0:
            return None
        scaled.append(one)
        noises.append(noise)
    cube, noise = np.array(scaled), float(np.median(noises))
    halves = [_smooth(_median(cube[k::2])) for k in (0, 1)]
    if not all(np.ptp(half) > 0.0 for half in halves):  # blank frames have no correlation with others
        return None
    if not np.corrcoef(halves[0].ravel(), halves[1].ravel())[0, 1] >= LEAST_AGREEMENT:
        return None
    median = _median(cube)
    smooth = _smooth(median)
    rest = np.nan_to_num(median - smooth)
    of_median = 1.25 * noise / np.sqrt(len(images))
    for axis in (0, 1):  # columns, then rows
        line = np.median(rest, axis=axis, keepdims=True)
        line[np.abs(line) < LINE_SIGMAS * 1.25 * of_median / np.sqrt(rest.shape[axis])] = 0.0
        smooth, rest = smooth + line, rest - line
    plain = _median(np.array([np.asarray(image, dtype=np.float32) / np.float32(level_of(image)) for image in images]))
    aside = np.abs(plain - scipy.ndimage.median_filter(np.nan_to_num(plain, nan=1.0), SOURCE_BOX_PX))
    hot = _alone(np.nan_to_num(aside) > HOT_SIGMAS * of_median)
    return FixedPattern(excess=(smooth - 1.0).astype(np.float32), hot=hot, n_frames=len(images))


def _median(cube: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median over frames, NaN where less than half of them know."""
    order = np.sort(cube, axis=0)  # NaN last
    known = np.isfinite(cube).sum(axis=0)
    low, high = np.maximum(known - 1, 0) // 2, known // 2
    pick = [np.take_along_axis(order, np.minimum(k, len(cube) - 1)[None], axis=0)[0] for k in (low, high)]
    out = 0.5 * (pick[0] + pick[1])
    out[2 * known < len(cube)] = np.nan
    return np.asarray(out, dtype=np.float32)


def _smooth(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Smoothed over the pixels that are known; 1 where none is near."""
    known = np.isfinite(image)
    weight = scipy.ndimage.gaussian_filter(known.astype(np.float32), SMOOTH_PX)
    light = scipy.ndimage.gaussian_filter(np.where(known, image, 0.0).astype(np.float32), SMOOTH_PX)
    return np.where(weight > 0.05, light / np.maximum(weight, 0.05), 1.0).astype(np.float32)


def _alone(pixels: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those of a mask that have no neighbour in it: hot pixels, and not the stars of a sky that stays."""
    neighbours = scipy.ndimage.convolve(pixels.astype(np.uint8), np.ones((3, 3), np.uint8), mode="constant")
    return pixels & (neighbours == 1)


def subtracted(frame: Frame, pattern: FixedPattern) -> Frame:
    """A frame without the pattern; its hot pixels are unknown. Saturated pixels stay as they are."""
    pixels = frame.pixels.astype(np.float32)
    level = level_of(pixels)
    full = frame.header.saturation_adu
    out = pixels - np.float32(level) * pattern.excess
    if full is not None:
        out = np.where(pixels >= full, pixels, out)
    out[pattern.hot] = np.nan
    return Frame(header=frame.header, pixels=np.ascontiguousarray(out, dtype=np.float32))


@dataclass(frozen=True, kw_only=True)
class MutuallyCalibrated(Calibrating):
    """A `FrameSource` whose frames have the fixed pattern of their camera subtracted, where frames enough tell it.

    Its frames know which others are of the same exposure; of these one goes into the pattern.
    """

    @cached_property
    def _looked_at(self) -> tuple[dict[tuple[str, int, int], list[int]], list[Mark]]:
        """Numbers of the frames of each camera and size, and marks of their exposures."""
        found: dict[tuple[str, int, int], list[int]] = {}
        marks: list[Mark] = []
        if self.n_frames < LEAST_FRAMES:  # nothing to be learned: they are read once
            return found, marks
        for each in self.source.frames():
            found.setdefault(_camera(each), []).append(each.frame.header.frame)
            marks.append(Mark.of(each))
        return found, marks

    @cached_property
    def same_exposures(self) -> dict[int, frozenset[int]]:
        """See `same_exposure.same_exposures`; nothing where the frames are read once."""
        return same_exposures(self._looked_at[1])

    @cached_property
    def cameras(self) -> dict[tuple[str, int, int], list[int]]:
        """Numbers of the frames of each camera and size, one of each exposure."""
        return {camera: self._of_different_exposures(numbers) for camera, numbers in self._looked_at[0].items()}

    def _of_different_exposures(self, numbers: Sequence[int]) -> list[int]:
        out: list[int] = []
        for number in numbers:
            if self.same_exposures.get(number, frozenset()).isdisjoint(out):
                out.append(number)
        return out

    @cached_property
    def patterns(self) -> dict[tuple[str, int, int], FixedPattern | None]:
        """The pattern of each camera with frames enough."""
        wanted = {
            camera: _spread(numbers, min(MOST_FRAMES, max(MOST_PIXELS // (camera[1] * camera[2]), LEAST_FRAMES)))
            for camera, numbers in self.cameras.items()
            if len(numbers) >= LEAST_FRAMES
        }
        out: dict[tuple[str, int, int], FixedPattern | None] = {}
        for camera, numbers in wanted.items():
            chosen = set(numbers)
            images = [each.frame.pixels for each in self.source.frames() if each.frame.header.frame in chosen]
            out[camera] = fixed_pattern(images)
        return out

    def frames(self) -> Iterator[SourcedFrame]:
        """The frames, calibrated, each with a note on it."""
        read: list[Mark] = []
        for each in self.source.frames():
            each = self._with_others(each, read)
            camera = _camera(each)
            n, pattern = len(self.cameras.get(camera, ())) or self.n_frames, self.patterns.get(camera)
            if pattern is not None:
                text = (
                    f"fixed pattern of {pattern.n_frames} frames of this camera subtracted; {pattern.hot.sum()} hot pixels masked"
                )
                each = replace(each, frame=subtracted(each.frame, pattern))
            elif n < LEAST_FRAMES:
                text = f"{n} frame{'s' if n > 1 else ''} of this camera: a fixed pattern needs {LEAST_FRAMES}"
            else:
                text = f"{n} frames of this camera show no fixed pattern in common"
            yield replace(each, notes=(*each.notes, Note(kind="fixed pattern", text=text)))

    def _with_others(self, each: SourcedFrame, read: list[Mark]) -> SourcedFrame:
        """A frame that knows others of its exposure. read : marks of those read once; that of this frame is added."""
        marks, same = self._looked_at[1], self.same_exposures
        if not marks and self.n_frames > 1:
            read.append(Mark.of(each))
            marks, same = read, same_exposures(read)
        others = same.get(each.frame.header.frame)
        if not others:
            return each
        note = note_of(others, {mark.number: mark.file for mark in marks})
        return replace(each, same_exposure=others, notes=(*each.notes, note))


def _camera(each: SourcedFrame) -> tuple[str, int, int]:
    return each.camera, each.frame.header.rows, each.frame.header.cols


def _spread(numbers: Sequence[int], most: int) -> list[int]:
    """At most `most` of them, evenly."""
    if len(numbers) <= most:
        return list(numbers)
    return [numbers[k] for k in np.unique(np.linspace(0, len(numbers) - 1, most).round().astype(int))]
