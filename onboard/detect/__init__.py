"""Detectors of moving objects: `line_integral` (the default) and published methods, behind one Protocol.

Each is imported on first use, because OpenCV takes 20 MB of memory that most detectors do not need.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from onboard.detect.line_integral.detector import LineIntegralDetector
    from onboard.detect.peers.boundary_tensor import BoundaryTensorDetector
    from onboard.detect.peers.difference import DifferenceDetector
    from onboard.detect.peers.hough import HoughDetector
    from onboard.detect.peers.lsd import LsdDetector
    from onboard.detect.peers.segmentation import SegmentationDetector
    from onboard.detect.threshold import ThresholdDetector

_MODULES = {
    "BoundaryTensorDetector": "peers.boundary_tensor",
    "DifferenceDetector": "peers.difference",
    "HoughDetector": "peers.hough",
    "LineIntegralDetector": "line_integral.detector",
    "LsdDetector": "peers.lsd",
    "SegmentationDetector": "peers.segmentation",
    "ThresholdDetector": "threshold",
}

__all__ = [
    "BoundaryTensorDetector",
    "DifferenceDetector",
    "HoughDetector",
    "LineIntegralDetector",
    "LsdDetector",
    "SegmentationDetector",
    "ThresholdDetector",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
