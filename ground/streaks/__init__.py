"""Streaks in pixels: trailed-PSF fits of single frames, and joint refits of all frames of a tracklet."""

from ground.streaks.fitter import TrailedPsfFitter
from ground.streaks.joint import TrackletFrame, refit_tracklet

__all__ = ["TrackletFrame", "TrailedPsfFitter", "refit_tracklet"]
