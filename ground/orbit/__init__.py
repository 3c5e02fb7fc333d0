"""Tracklets into posteriors of range and orbit."""

from ground.orbit.range_scan import RangeScan

__all__ = ["RangeScan"]
