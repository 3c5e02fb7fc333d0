"""One figure of the benchmark report, and which way is better."""

from dataclasses import dataclass
from fnmatch import fnmatch
from typing import Any, Final

from sboc_e2e.report.words import is_figure

HIGHER: Final = "higher"
LOWER: Final = "lower"
EITHER: Final = "either"

DIRECTIONS: Final = (
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
    ("*bias*", LOWER),
    ("*error*", LOWER),
    ("*trivial*", LOWER),
    ("*veto_loss*", LOWER),
    ("*fragments*", LOWER),
    ("*cpu*", LOWER),
    ("*_s_per_frame*", LOWER),
    ("*rss*", LOWER),
    ("*bits*", LOWER),
    ("*_ms*", LOWER),
)
"""First pattern that fits a figure's name decides; anything else is reported and not judged."""

UNITS: Final = (
    ("*_arcsec", "arcsec"), ("*_mag", "mag"), ("*cpu_s*", "s"), ("*_s_per_frame", "s"), ("*_mb", "MB"), ("*mb_s*", "MB/s"),
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

    @property
    def better(self) -> str:
        """Which way is better."""
        return next((way for pattern, way in DIRECTIONS if fnmatch(self.name, pattern)), EITHER)

    @property
    def unit(self) -> str:
        """Unit, from the name's suffix."""
        return next((unit for pattern, unit in UNITS if fnmatch(self.name, pattern)), "")

    @property
    def sigma(self) -> float:
        """Noise of the value: the 90 % interval as a normal's."""
        return (self.high - self.low) / (2 * 1.645)


def flatten(prefix: str, tree: Any) -> list[Entry]:
    """Entries of a nested result: figures as they are, bare numbers as figures without interval; texts and lists left out."""
    if is_figure(tree):
        if tree["value"] is None:
            return [Entry(name=prefix, value=None, n=int(tree["n"]), low=0.0, high=0.0, reason=str(tree.get("reason", "")))]
        value = float(tree["value"])
        low, high = tree.get("low"), tree.get("high")
        return [
            Entry(
                name=prefix, value=value, n=int(tree["n"] or 0), low=value if low is None else float(low),
                high=value if high is None else float(high),
            )
        ]  # fmt: skip
    if isinstance(tree, bool):
        return []
    if isinstance(tree, int | float):
        return [Entry(name=prefix, value=float(tree), n=1, low=float(tree), high=float(tree))]
    if isinstance(tree, dict):
        return [entry for key, item in tree.items() for entry in flatten(f"{prefix}.{key}", item)]
    return []
