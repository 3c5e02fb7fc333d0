"""Frames and cut-outs as pictures: stretched to eight bits, encoded, ready to embed."""

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

PREVIEW_PX: Final = 1024  # Longest side of a preview: frames of 4096 px shrink by whole pixels, and a browser shows it unscaled.
CUTOUT_PX: Final = 96  # Side of a cut-out: a trail's surroundings at full resolution. Chosen; longer trails leave it.
TILE_PX: Final = 256  # Side of a full-resolution tile: 16 a side of 4096 px, so that a page carries only those with streaks.
JPEG_QUALITY: Final = 72  # Of 100. A megapixel of noise takes 0.29 MB (0.49 MB at 90), with an error of half the noise.


def kept_frames(run_dir: Path) -> dict[int, Path]:
    """Frame number -> FITS file of the frames that the run kept."""
    return {int(path.stem): path for path in sorted((run_dir / "frames").glob("*.fits")) if path.stem.isdigit()}


def read_pixels(path: Path) -> NDArray[np.float32]:
    """Pixels of the first image of a FITS file, float32."""
    with fits.open(path, memmap=False) as hdus:
        data = next(h.data for h in hdus if h.data is not None and h.data.ndim == 2)
        return np.ascontiguousarray(data, dtype=np.float32)


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """Arcsinh stretch from 2 sigma below the median to `top_sigma` above: pixel = 255 asinh((ADU - black) / soft) / top.

    black_adu, soft_adu : where it begins, and where it turns from linear to logarithmic. top : asinh at 255.
    """

    black_adu: float
    soft_adu: float
    top: float

    @classmethod
    def of(cls, image: NDArray[np.float32], soft_sigma: float = 3.0, top_sigma: float = 60.0) -> "Stretch":
        """The stretch for an image, with the noise from its quartiles."""
        low, median, high = np.nanpercentile(image[:: max(1, image.shape[0] // 512)], [25, 50, 75])
        sigma = max(float(high - low) / 1.349, 1e-6)
        return cls(
            black_adu=float(median) - 2 * sigma, soft_adu=soft_sigma * sigma, top=float(np.arcsinh((top_sigma + 2) / soft_sigma))
        )

    def apply(self, image: NDArray[np.float32]) -> NDArray[np.uint8]:
        """Eight bits of an image."""
        scaled = np.arcsinh((image - self.black_adu) / self.soft_adu)
        return np.asarray(np.clip(np.nan_to_num(scaled) / self.top * 255, 0, 255), dtype=np.uint8)

    def as_list(self) -> list[float]:
        """The three numbers as the page's script takes them, to turn a pixel back into ADU."""
        return [round(self.black_adu, 3), round(self.soft_adu, 4), round(self.top, 5)]


def stretch(image: NDArray[np.float32], soft_sigma: float = 3.0, top_sigma: float = 60.0) -> NDArray[np.uint8]:
    """An image under its own stretch."""
    return Stretch.of(image, soft_sigma, top_sigma).apply(image)


def data_uri(picture: NDArray[np.uint8], lossless: bool) -> str:
    """A picture as PNG or JPEG, ready to embed."""
    kind, options = (".png", []) if lossless else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    _, encoded = cv2.imencode(kind, picture, options)
    return f"data:image/{'png' if lossless else 'jpeg'};base64," + base64.b64encode(encoded.tobytes()).decode()


def shrink_factor(shape: tuple[int, int]) -> int:
    """Pixels of a frame along the side of a pixel of its preview."""
    return max(1, -(-max(shape) // PREVIEW_PX))


def preview(image: NDArray[np.float32]) -> tuple[str, Stretch]:
    """The whole frame at `PREVIEW_PX` or less, averaged (which keeps faint streaks), as a data URI, and its stretch."""
    factor = shrink_factor((image.shape[0], image.shape[1]))
    size = (-(-image.shape[1] // factor), -(-image.shape[0] // factor))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    chosen = Stretch.of(small)
    return data_uri(chosen.apply(small), lossless=False), chosen


def tiles(image: NDArray[np.float32], places: Iterable[tuple[float, float]]) -> tuple[list[tuple[int, int, str]], Stretch]:
    """Full-resolution tiles of `TILE_PX` that hold the given (row, col), as (first row, col, data URI), and their stretch."""
    chosen = Stretch.of(image, soft_sigma=2.0, top_sigma=30.0)
    rows, cols = image.shape
    wanted = sorted({(int(r) // TILE_PX, int(c) // TILE_PX) for r, c in places if 0 <= r < rows and 0 <= c < cols})
    out = []
    for i, j in wanted:
        part = image[i * TILE_PX : (i + 1) * TILE_PX, j * TILE_PX : (j + 1) * TILE_PX]
        out.append((i * TILE_PX, j * TILE_PX, data_uri(chosen.apply(part), lossless=False)))
    return out, chosen


def cutout(image: NDArray[np.float32], row: float, col: float, size_px: int = CUTOUT_PX) -> tuple[str, int, int]:
    """A full-resolution cut-out around a position, and its first row and col."""
    half = size_px // 2
    row0 = int(np.clip(round(row) - half, 0, max(0, image.shape[0] - size_px)))
    col0 = int(np.clip(round(col) - half, 0, max(0, image.shape[1] - size_px)))
    part = image[row0 : row0 + size_px, col0 : col0 + size_px]
    return data_uri(stretch(part, soft_sigma=2.0, top_sigma=15.0), lossless=True), row0, col0
