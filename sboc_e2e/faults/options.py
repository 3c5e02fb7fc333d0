"""Options of `[faults]`; all are off by default."""

from dataclasses import dataclass, field


def _share(doc: str) -> float:
    """A share from 0 (off) to 1."""
    result: float = field(default=0.0, metadata={"doc": doc, "min": 0.0, "max": 1.0})
    return result


@dataclass(frozen=True, kw_only=True)
class PacketFaults:
    """Damage to packets on their way down; each is drawn for each packet by itself."""

    lost: float = _share("share of packets that do not arrive")
    duplicated: float = _share("share of packets that arrive twice")
    reordered: float = _share("share of packets that arrive somewhere else in the stream")
    truncated: float = _share("share of packets that are cut at a random byte")
    bit_flipped: float = _share("share of packets with one flipped bit")

    @property
    def any(self) -> bool:
        """Whether there is anything to do."""
        return max(self.lost, self.duplicated, self.reordered, self.truncated, self.bit_flipped) > 0.0


@dataclass(frozen=True, kw_only=True)
class FrameFaults:
    """Frames that the camera interface loses or hands over twice."""

    dropped: float = _share("share of frames that do not reach the on-board software")
    repeated: float = _share("share of frames that reach it twice")


@dataclass(frozen=True, kw_only=True)
class HeaderFaults:
    """What goes wrong with time tags and attitude."""

    clock_jump_s: float = field(
        default=0.0, metadata={"doc": "the clock jumps by this much, and stays off", "min": -1e6, "max": 1e6}
    )
    clock_jump_frame: int = field(default=0, metadata={"doc": "first frame after the jump", "min": 0, "max": 10_000_000})
    attitude: str = field(default="good", metadata={"doc": "telemetered attitude", "choices": ("good", "missing", "wrong")})
    attitude_error_deg: float = field(
        default=3.0, metadata={"doc": "error of a wrong attitude, about the row axis", "min": -180.0, "max": 180.0}
    )
    attitude_frames: float = field(
        default=1.0, metadata={"doc": "share of frames with a missing or wrong attitude", "min": 0.0, "max": 1.0}
    )


@dataclass(frozen=True, kw_only=True)
class PixelFaults:
    """What goes wrong with the detector after calibration; the particle storm is `radiation.environment`."""

    stuck_column: int = field(
        default=-1, metadata={"doc": "column that reads the stuck level, -1: none", "min": -1, "max": 16383}
    )
    stuck_level_adu: int = field(default=4000, metadata={"doc": "level of the stuck column", "min": 0, "max": 65535})
    dead_quadrant: bool = field(default=False, metadata={"doc": "the last rows and columns read nothing but their offset"})
    dead_level_adu: int = field(default=100, metadata={"doc": "level of the dead quadrant", "min": 0, "max": 65535})
    stray_light_adu: float = field(
        default=0.0, metadata={"doc": "glow at the first column, falling to nothing at the last", "min": 0.0, "max": 65535.0}
    )


@dataclass(frozen=True, kw_only=True)
class FaultOptions:
    """Faults of a run."""

    packets: PacketFaults = field(default_factory=PacketFaults, metadata={"doc": "packets on their way down"})
    frames: FrameFaults = field(default_factory=FrameFaults, metadata={"doc": "frames lost or doubled"})
    header: HeaderFaults = field(default_factory=HeaderFaults, metadata={"doc": "time tags and attitude"})
    pixels: PixelFaults = field(default_factory=PixelFaults, metadata={"doc": "detector"})
