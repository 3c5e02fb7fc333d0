"""Streaks in pixels: trailed-PSF fits of single frames, and joint refits of all frames of a tracklet."""

from ground.streaks.fitter import TrailedPsfFitter

__all__ = ["TrailedPsfFitter"]
