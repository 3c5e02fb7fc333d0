"""A whole frame as chunks of one packet each, lossless or as the codec gives it."""

from collections.abc import Iterator

import numpy as np

from onboard.downlink import packets
from onboard.downlink.roi_coding import bits_per_pixel, encoded
from onboard.image.calibrate import Counts
from sboc_e2e.icd import layout
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.signals import BackgroundModel
from sboc_e2e.icd.steps import Encoder

ROOM_BYTES = layout.MAX_PAYLOAD_BYTES - layout.CHUNK.size
FILL = 0.98
"""Chunks are planned by the one before to fill this share of a packet; one that does not fit is coded again, narrower."""


def frame_payloads(counts: Counts, background: BackgroundModel, codec: Encoder) -> tuple[bytes, ...]:
    """Payloads of all chunks in row-major order; chunks are one mesh tile high and as wide as fits."""
    rows, cols = counts.pixels.shape
    tile = background.tile_px
    bands = [(row, min(tile, rows - row), 0, cols) for row in range(0, rows, tile)]
    return tuple(payload for band in bands for payload in _band(band, counts, background, codec))


def _band(band: tuple[int, int, int, int], counts: Counts, background: BackgroundModel, codec: Encoder) -> Iterator[bytes]:
    """Payloads of a rectangle (row, rows, col, cols) from left to right."""
    row, n_rows, col, n_cols = band
    stop = col + n_cols
    sigma = max(float(np.median(background.sigma_adu)) / counts.adu_scale, 0.1)
    most = max(1, layout.MAX_STRIP_PIXELS // n_rows)
    width = max(1, int(FILL * 8.0 * ROOM_BYTES / bits_per_pixel(sigma)) // n_rows)
    while col < stop:
        width = min(width, most, stop - col)
        payload, block_bytes = _chunk((row, n_rows, col, width), counts, background, codec)
        if block_bytes <= ROOM_BYTES:
            yield payload
            col += width
        elif width == 1:
            if n_rows == 1:
                raise PluginError(f"codec {type(codec).__name__}: {block_bytes} bytes for one pixel")
            half = n_rows // 2
            yield from _band((row, half, col, 1), counts, background, codec)
            yield from _band((row + half, n_rows - half, col, 1), counts, background, codec)
            col += 1
        width = max(1, int(width * FILL * ROOM_BYTES / block_bytes))


def _chunk(window: tuple[int, int, int, int], counts: Counts, background: BackgroundModel, codec: Encoder) -> tuple[bytes, int]:
    """Payload of a rectangle (row, rows, col, cols), and the length of its block."""
    row, n_rows, col, n_cols = window
    part = np.s_[row : row + n_rows, col : col + n_cols]
    values = counts.pixels[part].astype(np.int32) - counts.dark.window(row, col, (n_rows, n_cols)).whole_adu()
    i = min((row + n_rows // 2) // background.tile_px, background.level_adu.shape[0] - 1)
    j = min((col + n_cols // 2) // background.tile_px, background.level_adu.shape[1] - 1)
    level = round((float(background.level_adu[i, j]) - counts.adu_offset) / counts.adu_scale)
    sigma = float(np.float32(background.sigma_adu[i, j] / counts.adu_scale))
    block = encoded(codec, values, level, sigma)
    return packets.chunk_payload(window, codec.number, level_adu=level, sigma_adu=sigma, block=block), len(block)
