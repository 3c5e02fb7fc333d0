"""Options of the on-board chain; each step has its own beside it."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class RoiOptions:
    """How much of the frame around a detection is sent."""

    half_width_sigma: float = field(
        default=5.0, metadata={"doc": "half width across the trail, in PSF sigmas", "min": 2.0, "max": 20.0}
    )
    max_half_width_px: float = field(
        default=20.0, metadata={"doc": "largest half width, for defocused trails", "min": 2.0, "max": 200.0}
    )
    end_margin: float = field(
        default=3.0, metadata={"doc": "margin beyond the ends over the rms of a faint end's position", "min": 0.0, "max": 10.0}
    )
    follow_light: bool = field(
        default=False,
        metadata={"doc": "whether regions reach as far as light goes on beyond an end, as of trails that fade; costs bytes"},
    )
    max_per_frame: int = field(
        default=60, metadata={"doc": "detections sent per frame; more means a particle storm", "min": 1, "max": 10000}
    )
    max_cosmic_like: int = field(
        default=1, metadata={"doc": "those flagged as particle hits among them; the others are counted", "min": 0, "max": 10000}
    )


@dataclass(frozen=True, kw_only=True)
class DownlinkOptions:
    """Limits and contents of the downlink."""

    budget_mbit_s: float = field(
        default=4.0, metadata={"doc": "downlink rate for everything but whole frames; 0: no limit", "min": 0.0, "max": 1e5}
    )
    burst_s: float = field(default=2.0, metadata={"doc": "unspent budget is kept for so long", "min": 0.0, "max": 86400.0})
    max_stars: int = field(default=250, metadata={"doc": "stars sent per frame", "min": 0, "max": 20000})
    thumbnail_px: int = field(default=64, metadata={"doc": "pixels per side of a thumbnail's cell", "min": 8, "max": 1024})
    whole_frame_every: int = field(
        default=0, metadata={"doc": "every n-th frame is sent whole, on top of the budget; 0: none", "min": 0, "max": 1000000}
    )
    whole_frames: tuple[int, ...] = field(
        default=(), metadata={"doc": "numbers of frames that are sent whole on request, on top of the budget", "min": 0}
    )


@dataclass(frozen=True, kw_only=True)
class OnboardOptions:
    """The on-board chain apart from its steps."""

    roi: RoiOptions = field(default_factory=RoiOptions)
    downlink: DownlinkOptions = field(default_factory=DownlinkOptions)
