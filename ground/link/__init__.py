"""Streaks of all frames into tracklets: two hypotheses of motion per streak, search, evidence, resolved directions."""

from ground.link.linker import MotionLinker
from ground.link.resolve import apply_links

__all__ = ["MotionLinker", "apply_links"]
