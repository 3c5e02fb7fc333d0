"""One figure of the benchmark report, and which way is better."""

from dataclasses import dataclass
from fnmatch import fnmatch
from typing import Any, Final

from sboc_e2e.report.words import is_figure

HIGHER: Final = "higher"
LOWER: Final = "lower"
EITHER: Final = "either"
AIMED: Final = "aimed"

DIRECTIONS: Final = (
    ("*cold_cpu_s", EITHER),  # with compilation, where a kernel is compiled for the first time
    ("*first_frame_cpu_s", EITHER),
    ("*bias*", AIMED),  # before "*false*": a bias among false stars is a bias
    ("*pull_std*", AIMED),
    ("*nees*", AIMED),
    ("*coverage_68*", AIMED),
    ("*coverage_90*", AIMED),
    ("*completeness*", HIGHER),
    ("*captured_flux*", HIGHER),
    ("*purity*", HIGHER),
    ("*direction_correct*", HIGHER),
    ("*lossless_bit_exact*", HIGHER),
    ("*.reduction", HIGHER),
    ("*mb_s*", HIGHER),
    ("*efficiency*", HIGHER),
    ("*realtime_factor*", HIGHER),
    ("*speedup*", HIGHER),
    ("*false*", LOWER),
    ("*snr50*", LOWER),
    ("*_ratio*", LOWER),
    ("*rms*", LOWER),
    ("*error*", LOWER),
    ("*trivial*", LOWER),
    ("*differs_from_streaks*", LOWER),
    ("*gross_share*", LOWER),
    ("*veto_loss*", LOWER),
    ("*fragments*", LOWER),
    ("*cpu*", LOWER),
    ("*.timing.*_s_per_frame", EITHER),  # wall seconds, which parts and programs beside it stretch
    ("*_s_per_frame*", LOWER),
    ("*rss*", LOWER),
    ("*bits*", LOWER),
    ("*_ms*", LOWER),
)
"""First pattern that fits a figure's name decides; anything else is reported and not judged."""

AIMS: Final = (("*bias*", 0.0), ("*pull_std*", 1.0), ("*nees*", 1.0), ("*coverage_68*", 0.6827), ("*coverage_90*", 0.9))
"""What figures that may miss to either side should be: of them the distance from there is judged."""

TIMES: Final = "x"
"""Unit of a ratio of two timings of the same run."""

REAL_TIME: Final = "x real time"
"""Unit of a speed in units of the frame rate."""

EPOCH_MS: Final = "ms of epoch"
"""Unit of errors of published epochs: milliseconds that no machine makes longer or shorter."""

UNITS: Final = (
    ("*epoch_rms_ms", EPOCH_MS), ("*epoch_bias_ms", EPOCH_MS),
    ("*realtime_factor*", REAL_TIME), ("*speedup*", TIMES), ("*_over_numpy_floor", TIMES),
    ("*_arcsec", "arcsec"), ("*_mag", "mag"), ("*cpu_s*", "s"), ("*_s_per_frame", "s"), ("*_mb", "MB"), ("*mb_s*", "MB/s"),
    ("*_km_s", "km/s"), ("*_m_s", "m/s"), ("*_rms_m", "m"),
    ("*_km", "km"), ("*_deg", "deg"), ("*_px", "px"), ("*bits*", "bit"), ("*_bytes", "B"), ("*_ms*", "ms"), ("*_s", "s"),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A measured figure with its interval; `value` is None with a reason when it could not be measured."""

    name: str
    value: float | None
    n: int
    low: float
    high: float
    reason: str = ""
    measured: bool = True
    """Whether the bench gave an interval (a deterministic figure has one without width); bare numbers have an unknown noise."""

    @property
    def better(self) -> str:
        """Which way is better."""
        return next((way for pattern, way in DIRECTIONS if fnmatch(self.name, pattern)), EITHER)

    @property
    def aim(self) -> float:
        """What the figure should be where it may miss to either side, else 0."""
        return next((aim for pattern, aim in AIMS if fnmatch(self.name, pattern)), 0.0)

    @property
    def unit(self) -> str:
        """Unit, from the name's suffix."""
        return next((unit for pattern, unit in UNITS if fnmatch(self.name, pattern)), "")

    @property
    def sigma(self) -> float:
        """Noise of the value: the 90 % interval as a normal's."""
        return (self.high - self.low) / (2 * 1.645)


def flatten(prefix: str, tree: Any) -> list[Entry]:
    """Entries of a nested result: figures as they are, bare numbers as figures of unknown noise; texts and lists left out.

    Intervals are `low` and `high`, a pair `interval`, or, for rates of rare events, only an upper limit.
    """
    if is_figure(tree) or (isinstance(tree, dict) and "value" in tree and "n_frames" in tree):
        n = int(tree.get("n") or tree.get("n_frames") or 0)
        if tree["value"] is None:
            return [Entry(name=prefix, value=None, n=n, low=0.0, high=0.0, reason=str(tree.get("reason", "")))]
        value = float(tree["value"])
        low, high, known = _interval(tree, value)
        return [Entry(name=prefix, value=value, n=n, low=low, high=high, measured=known)]
    if isinstance(tree, bool):
        return []
    if isinstance(tree, int | float):
        return [Entry(name=prefix, value=float(tree), n=1, low=float(tree), high=float(tree), measured=False)]
    if isinstance(tree, dict):
        return [entry for key, item in tree.items() for entry in flatten(f"{prefix}.{key}", item)]
    return []


def _interval(tree: dict[str, Any], value: float) -> tuple[float, float, bool]:
    """Ends of a figure's interval, and whether it has one."""
    if tree.get("low") is not None and tree.get("high") is not None:
        return float(tree["low"]), float(tree["high"]), True
    pair = tree.get("interval")
    if isinstance(pair, list | tuple) and len(pair) == 2 and None not in pair:
        return float(pair[0]), float(pair[1]), True
    upper = next((tree[key] for key in ("upper_95", "upper95") if tree.get(key) is not None), None)
    if upper is not None:
        return max(0.0, 2.0 * value - float(upper)), float(upper), True
    return value, value, False
