"""Streaks of all frames into tracklets: two hypotheses of motion each, search, evidence, resolved ends, measured tracklets."""

from ground.link.linker import MotionLinker
from ground.link.measured import Member, measured_tracklet
from ground.link.resolve import apply_links

__all__ = ["Member", "MotionLinker", "apply_links", "measured_tracklet"]
