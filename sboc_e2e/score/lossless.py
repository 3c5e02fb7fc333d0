"""Is a whole frame lossless, and at how many bits per pixel? Coded and decoded again with the default codec."""

from pathlib import Path
from typing import Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from ground.ingest.codecs import PlanesDecoder
from onboard.downlink.codec import PlanesCodec
from sboc_e2e.icd.layout import MAX_STRIP_PIXELS
from sboc_e2e.score.figures import Figure, absent, bootstrap, proportion

MAX_FRAMES: Final = 3  # Frames coded again, 50 million pixels at 4096 px a side. Chosen: all frames of a run are alike.


def code_frame(values_adu: NDArray[np.int32]) -> tuple[int, bool]:
    """Bytes of a frame in blocks of whole rows, and whether all of it came back the same."""
    encoder, decoder = PlanesCodec(), PlanesDecoder()
    lines = max(1, MAX_STRIP_PIXELS // values_adu.shape[1])
    size, same = 0, True
    for first in range(0, values_adu.shape[0], lines):
        block = np.ascontiguousarray(values_adu[first : first + lines])
        level = int(np.median(block[:, ::8]))
        sigma = float(np.std(np.clip(block[:, ::8], level - 50, level + 50)))
        coded = encoder.encode(block, level_adu=level, sigma_adu=sigma)
        size += len(coded)
        same &= bool(np.array_equal(decoder.decode(coded, block.shape, level_adu=level, sigma_adu=sigma), block))
    return size, same


def lossless_check(run_dir: Path) -> tuple[Figure, Figure]:
    """Bits per pixel and share of bit-exact frames, over the first kept frames, dark map subtracted as on board."""
    paths = sorted((run_dir / "frames").glob("*.fits"))[:MAX_FRAMES]
    if not paths:
        none = absent("no frame was kept (output.keep_frames_every is 0)")
        return none, none
    dark = np.rint(fits.getdata(run_dir / "calibration" / "dark.fits")).astype(np.int32)
    bits, exact = [], 0
    for path in paths:
        pixels = np.asarray(fits.getdata(path))
        if pixels.dtype.kind == "f":
            return absent("frames hold floating-point pixels"), absent("frames hold floating-point pixels")
        size, same = code_frame(pixels.astype(np.int32) - dark)
        bits.append(8.0 * size / pixels.size)
        exact += same
    return bootstrap(bits, lambda v: float(v.mean()), "fewer than three kept frames"), proportion(exact, len(paths))
