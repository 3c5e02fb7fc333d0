"""Streaks in pixels: trailed-PSF fits of single frames, and joint refits of all frames of a tracklet."""

from ground.streaks.fitter import TrailedPsfFitter
from ground.streaks.joint import refit_tracklet
from ground.streaks.joint_evidence import TrackletFrame
from ground.streaks.psf_field import PsfField

__all__ = ["PsfField", "TrackletFrame", "TrailedPsfFitter", "refit_tracklet"]
