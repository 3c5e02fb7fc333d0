"""Detectors of moving objects: `line_integral` (the default) and published methods beside it, behind one Protocol."""

from onboard.detect.boundary_tensor import BoundaryTensorDetector
from onboard.detect.difference import DifferenceDetector
from onboard.detect.line_integral import LineIntegralDetector
from onboard.detect.lsd import LsdDetector
from onboard.detect.threshold import ThresholdDetector
from onboard.detect.warm_up import warm_up

__all__ = [
    "BoundaryTensorDetector",
    "DifferenceDetector",
    "LineIntegralDetector",
    "LsdDetector",
    "ThresholdDetector",
    "warm_up",
]
