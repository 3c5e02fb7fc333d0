"""Detectors of moving objects: `line_integral` (the default) and published methods beside it, behind one Protocol."""

from onboard.detect.line_integral import LineIntegralDetector

__all__ = ["LineIntegralDetector"]
