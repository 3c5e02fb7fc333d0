"""A whole frame as chunks of one packet each, lossless or as the codec gives it."""

from collections.abc import Iterator

import numpy as np

from onboard import packets
from onboard.calibrate import Counts
from onboard.roi_coding import bits_per_pixel, encoded
from sboc_e2e.icd import layout
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.signals import BackgroundModel
from sboc_e2e.icd.steps import Encoder

ROOM_BYTES = layout.MAX_PAYLOAD_BYTES - layout.CHUNK.size


def frame_payloads(counts: Counts, background: BackgroundModel, codec: Encoder) -> tuple[bytes, ...]:
    """Payloads of all chunks in row-major order; chunks are one mesh tile high and as wide as fits."""
    rows, cols = counts.pixels.shape
    tile = background.tile_px
    sigma = max(float(np.median(background.sigma_adu)) / counts.adu_scale, 0.1)
    wanted = int(0.94 * 8.0 * ROOM_BYTES / (bits_per_pixel(sigma) - 0.15))
    width = max(1, min(cols, wanted // tile))
    windows = [
        (row, min(tile, rows - row), col, min(width, cols - col)) for row in range(0, rows, tile) for col in range(0, cols, width)
    ]
    return tuple(payload for window in windows for payload in _chunk(window, counts, background, codec))


def _chunk(window: tuple[int, int, int, int], counts: Counts, background: BackgroundModel, codec: Encoder) -> Iterator[bytes]:
    """Payloads of a rectangle (row, rows, col, cols); halved until its block fits."""
    row, n_rows, col, n_cols = window
    part = np.s_[row : row + n_rows, col : col + n_cols]
    values = counts.pixels[part].astype(np.int32) - counts.dark[part]
    i = min((row + n_rows // 2) // background.tile_px, background.level_adu.shape[0] - 1)
    j = min((col + n_cols // 2) // background.tile_px, background.level_adu.shape[1] - 1)
    level = round((float(background.level_adu[i, j]) - counts.adu_offset) / counts.adu_scale)
    sigma = float(np.float32(background.sigma_adu[i, j] / counts.adu_scale))
    block = encoded(codec, values, level, sigma)
    if len(block) <= ROOM_BYTES:
        yield packets.chunk_payload(window, codec.number, level_adu=level, sigma_adu=sigma, block=block)
    elif n_cols > 1:
        half = n_cols // 2
        yield from _chunk((row, n_rows, col, half), counts, background, codec)
        yield from _chunk((row, n_rows, col + half, n_cols - half), counts, background, codec)
    elif n_rows > 1:
        half = n_rows // 2
        yield from _chunk((row, half, col, n_cols), counts, background, codec)
        yield from _chunk((row + half, n_rows - half, col, n_cols), counts, background, codec)
    else:
        raise PluginError(f"codec {type(codec).__name__}: {len(block)} bytes for one pixel")
