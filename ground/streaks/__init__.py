"""Streaks in pixels: trailed-PSF fits of single frames, and joint refits of all frames of a tracklet."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from ground.streaks.fitter import TrailedPsfFitter
    from ground.streaks.joint import refit_tracklet
    from ground.streaks.joint_evidence import TrackletFrame
    from ground.streaks.psf_field import PsfField

__all__ = ["PsfField", "TrackletFrame", "TrailedPsfFitter", "refit_tracklet"]

_HOMES: Final = {
    "PsfField": "psf_field",
    "TrackletFrame": "joint_evidence",
    "TrailedPsfFitter": "fitter",
    "refit_tracklet": "joint",
}


def __getattr__(name: str) -> Any:
    """Import on first use: lines of a frame are judged on board of `sboc process` without the fits."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
