"""Sky level and noise of a frame's pixels, from the mesh that came down with it."""

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel

Array = NDArray[np.float64]


def gain_e_adu(header: FrameHeader) -> float:
    """Gain of a frame; 1 where none is known (the frame is flagged GAIN_ASSUMED)."""
    return header.gain_e_adu if header.gain_e_adu is not None else 1.0


def background_at(frame: DownlinkFrame, row: NDArray[np.intp], col: NDArray[np.intp]) -> tuple[Array, Array]:
    """Sky level and noise sigma (ADU) of pixels: bilinear in the mesh, else the frame's means, else 0 and the read noise."""
    if frame.background is not None:
        i, j = (
            _mesh_coordinate(row, frame.background.level_adu.shape[0], frame.background, frame.header.rows),
            _mesh_coordinate(col, frame.background.level_adu.shape[1], frame.background, frame.header.cols),
        )
        return _bilinear(frame.background.level_adu, i, j), _bilinear(frame.background.sigma_adu, i, j)
    if frame.housekeeping is not None:
        return np.full(len(row), frame.housekeeping.background_adu), np.full(len(row), max(frame.housekeeping.sigma_adu, 1e-3))
    read_noise_e = frame.header.read_noise_e if frame.header.read_noise_e is not None else 5.0
    return np.zeros(len(row)), np.full(len(row), read_noise_e / gain_e_adu(frame.header))


def _mesh_coordinate(pixel: NDArray[np.intp], n_tiles: int, mesh: BackgroundModel, n_pixels: int) -> Array:
    """Fractional tile index of pixels, held at the outermost tile centres; the last tile may be shorter."""
    first = np.arange(n_tiles) * mesh.tile_px
    centres = 0.5 * (first + np.minimum(first + mesh.tile_px, n_pixels) - 1.0)
    return np.interp(pixel, centres, np.arange(n_tiles))


def _bilinear(mesh: NDArray[np.float32], i: Array, j: Array) -> Array:
    i0, j0 = np.minimum(i.astype(np.intp), max(mesh.shape[0] - 2, 0)), np.minimum(j.astype(np.intp), max(mesh.shape[1] - 2, 0))
    i1, j1 = np.minimum(i0 + 1, mesh.shape[0] - 1), np.minimum(j0 + 1, mesh.shape[1] - 1)
    di, dj = i - i0, j - j0
    return np.asarray(
        (1.0 - di) * ((1.0 - dj) * mesh[i0, j0] + dj * mesh[i0, j1]) + di * ((1.0 - dj) * mesh[i1, j0] + dj * mesh[i1, j1])
    )
