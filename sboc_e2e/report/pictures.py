"""Frames and cut-outs as pictures: stretched to eight bits, encoded, ready to embed."""

import base64
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

PREVIEW_PX: Final = 1024
CUTOUT_PX: Final = 96
JPEG_QUALITY: Final = 72


def kept_frames(run_dir: Path) -> dict[int, Path]:
    """Frame number -> FITS file of the frames that the run kept."""
    return {int(path.stem): path for path in sorted((run_dir / "frames").glob("*.fits")) if path.stem.isdigit()}


def read_pixels(path: Path) -> NDArray[np.float32]:
    """Pixels of the first image of a FITS file, float32."""
    with fits.open(path, memmap=False) as hdus:
        data = next(h.data for h in hdus if h.data is not None and h.data.ndim == 2)
        return np.ascontiguousarray(data, dtype=np.float32)


def stretch(image: NDArray[np.float32], soft_sigma: float = 3.0, top_sigma: float = 60.0) -> NDArray[np.uint8]:
    """Arcsinh stretch from 2 sigma below the median to `top_sigma` above, with the noise from the quartiles."""
    low, median, high = np.nanpercentile(image[:: max(1, image.shape[0] // 512)], [25, 50, 75])
    sigma = max(float(high - low) / 1.349, 1e-6)
    scaled = np.arcsinh((image - (median - 2 * sigma)) / (soft_sigma * sigma))
    top = np.arcsinh((top_sigma + 2) / soft_sigma)
    return np.asarray(np.clip(np.nan_to_num(scaled) / top * 255, 0, 255), dtype=np.uint8)


def _data_uri(picture: NDArray[np.uint8], lossless: bool) -> str:
    kind, options = (".png", []) if lossless else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    _, encoded = cv2.imencode(kind, picture, options)
    return f"data:image/{'png' if lossless else 'jpeg'};base64," + base64.b64encode(encoded.tobytes()).decode()


def preview(image: NDArray[np.float32]) -> str:
    """The whole frame at `PREVIEW_PX` or less, averaged (which keeps faint streaks), as a data URI."""
    factor = max(1, -(-max(image.shape) // PREVIEW_PX))
    size = (-(-image.shape[1] // factor), -(-image.shape[0] // factor))
    small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
    return _data_uri(stretch(small), lossless=False)


def cutout(image: NDArray[np.float32], row: float, col: float, size_px: int = CUTOUT_PX) -> tuple[str, int, int]:
    """A full-resolution cut-out around a position, and its first row and col."""
    half = size_px // 2
    row0 = int(np.clip(round(row) - half, 0, max(0, image.shape[0] - size_px)))
    col0 = int(np.clip(round(col) - half, 0, max(0, image.shape[1] - size_px)))
    part = image[row0 : row0 + size_px, col0 : col0 + size_px]
    return _data_uri(stretch(part, soft_sigma=2.0, top_sigma=15.0), lossless=True), row0, col0
