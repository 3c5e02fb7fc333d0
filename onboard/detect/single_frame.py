"""What the detectors of single frames have in common: options of their star mask and of what they report."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class SingleFrameDetector:
    """Base of detectors that look at one frame at a time and judge segments by their matched-filter S/N."""

    min_snr: float = field(default=7.5, metadata={"doc": "least matched-filter S/N", "min": 0.0, "max": 1000.0})
    halo_px: float = field(default=1.0, metadata={"doc": "star mask growth per sqrt(S/N / 100)", "min": 0.0, "max": 20.0})
    max_detections: int = field(default=200, metadata={"doc": "most detections of a frame", "min": 1, "max": 10000})

    @property
    def history_frames(self) -> int:
        """Works on single frames."""
        return 0
