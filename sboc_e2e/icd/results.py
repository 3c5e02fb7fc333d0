"""Rules for the results of on-board steps, beyond their types. The chain checks every frame, and `sboc check` asks for them.

Each function raises a `ContractError` that says what was expected and what was returned.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.layout import STAR_POSITION_OFFSET_PX
from sboc_e2e.icd.signals import BackgroundModel, Detection, StarList, Track

OUTSIDE_TOLERANCE_PX: Final = 2.0
"""A detection's end may lie this far outside the frame: PSF centres of trails that touch the edge do."""

STAR_OUTSIDE_PX: Final = -STAR_POSITION_OFFSET_PX
"""So may a star, for centres of trailed stars at the edge do; packets carry no more."""

LARGEST_COUNT: Final = 2.0**31
"""Pixels are integers of 32 bits at most."""

LEAST_NOISE: Final = 1e-6  # Noise (ADU) is divided by: this keeps S/N finite. No converter's noise is near it.
LARGEST_SNR: Final = 1e9
"""A whole frame of saturated pixels has less."""


def check_background(model: Any, shape: tuple[int, ...]) -> None:
    """A mesh over a frame of a shape (rows, cols), levels finite and noise positive."""
    _check_type(model, BackgroundModel)
    mesh = tuple(-(-size // model.tile_px) for size in shape)
    if model.level_adu.shape != mesh:
        raise ContractError(f"expected a mesh of {mesh} for tiles of {model.tile_px} px, got {model.level_adu.shape}")
    _check_range("level_adu", model.level_adu, -LARGEST_COUNT, LARGEST_COUNT)
    _check_range("sigma_adu", model.sigma_adu, LEAST_NOISE, LARGEST_COUNT)


def check_stars(stars: Any, shape: tuple[int, ...]) -> None:
    """Stars in or near a frame of a shape (rows, cols), by falling flux, everything finite."""
    _check_type(stars, StarList)
    for name, size in zip(("row", "col"), shape, strict=True):
        _check_range(name, getattr(stars, name), -STAR_OUTSIDE_PX, size - 1 + STAR_OUTSIDE_PX)
    largest = float(np.finfo(np.float32).max)
    for name in ("flux_e", "snr"):
        _check_range(name, getattr(stars, name), -largest, largest)
    if (stars.flux_e[1:] > stars.flux_e[:-1]).any():
        raise ContractError("expected stars by falling flux")


def check_detections(found: Any, shape: tuple[int, ...]) -> None:
    """Detections with their ends in a frame of a shape (rows, cols), and numbers that a packet can carry."""
    _check_type(found, tuple, list)
    rows, cols = shape
    for detection in found:
        _check_type(detection, Detection)
        slack = OUTSIDE_TOLERANCE_PX
        for row, col in ((detection.row0, detection.col0), (detection.row1, detection.col1)):
            if not (-slack <= row <= rows - 1 + slack and -slack <= col <= cols - 1 + slack):
                raise ContractError(f"end ({row:.1f}, {col:.1f}) lies outside the frame of {rows} x {cols} px")
        if not 0.0 <= detection.snr <= LARGEST_SNR:
            raise ContractError(f"detection.snr: expected a value in [0, {LARGEST_SNR:g}], got {detection.snr:g}")
        if not abs(detection.sagitta_px) <= max(shape):
            raise ContractError(f"detection.sagitta_px: expected a value within +-{max(shape)}, got {detection.sagitta_px:g}")


def check_tracks(found: Any, window: Mapping[int, tuple[int, int]]) -> None:
    """Tracks with members in the window's frames (rows and columns by number), numbers of their own, ends within the frame."""
    _check_type(found, tuple, list)
    for track in found:
        _check_type(track, Track)
        if not 0.0 <= track.snr <= LARGEST_SNR:
            raise ContractError(f"track.snr: expected a value in [0, {LARGEST_SNR:g}], got {track.snr:g}")
        for member in track.members:
            if member.frame not in window:
                raise ContractError(f"track.members: expected frames of the window, {sorted(window)}, got {member.frame}")
            check_detections([member.detection], window[member.frame])


def _check_type(found: Any, *wanted: type) -> None:
    if not isinstance(found, wanted):
        raise ContractError(f"expected a {wanted[0].__name__}, got {type(found).__name__}")


def _check_range(name: str, values: NDArray[Any], low: float, high: float) -> None:
    good = (values >= low) & (values <= high)
    if not good.all():
        raise ContractError(f"{name}: expected values in [{low:g}, {high:g}], got {values[~good][0]:g}")
