"""Faults between the segments, at given rates: what happens to frames before the on-board software, to packets after it."""

from sboc_e2e.faults.frames import damaged_frame, delivered_frames
from sboc_e2e.faults.options import FaultOptions
from sboc_e2e.faults.packets import damaged_packets, split_packets

__all__ = ["FaultOptions", "damaged_frame", "damaged_packets", "delivered_frames", "split_packets"]
