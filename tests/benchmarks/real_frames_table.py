"""What became of real frames, as records, and their table and sums for docs/real-frames.md."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from scipy.stats import beta, chi2

HALF: Final = 0.5
"""Share of its length from which on a trail counts as published."""

SURE: Final = 0.9
"""Probability from which on a published streak must be right in 85 of 100 cases."""

LEAST_SHARE: Final = 0.9
MOST_FALSE_RAW: Final = 0.1
MOST_FALSE_CALIBRATED: Final = 0.02
MOST_WRONG: Final = 0.15
NEAR_PX: Final = 2.0
"""What is asked of ends, px."""
LONG_PX: Final = 6.0
"""Intervals of ends that are longer are counted apart: of trails that fade."""
ASKED: Final = (
    "at least 90 % of trails published with half their length or more",
    "at least 90 % of their ends within 2 px or their interval",
    "at most 0.1 false in a blank raw frame",
    "at most 0.02 false in a blank calibrated frame",
    "at most 15 % false among those published at p of 0.9 or more",
    "frames of runs that ended in an error: none",
)
"""What is asked of real frames."""

CALIBRATED: Final = ("calibrated", "flc")
"""Words by which the name of a camera says that its frames are calibrated ("flc" is Hubble's name for flat-fielded chips)."""


@dataclass(frozen=True, kw_only=True)
class Trail:
    """What became of one trail that the eye saw.

    found, published : share of its length that the longest measured and the longest published streak cover.
    end_px : (2,) distance of the published streak's ends from the eye's.
    interval_px : (2,) the intervals of its light's ends on the eye's side.
    inside : which ends are within `NEAR_PX` or their interval.
    extra : further published streaks on the same trail.
    """

    found: float
    published: float
    end_px: tuple[float, float]
    interval_px: tuple[float, float]
    snr: float
    probability: float
    extra: int
    inside: tuple[bool, bool] = field(init=False)

    def __post_init__(self) -> None:
        first, last = (px <= max(NEAR_PX, quoted) for px, quoted in zip(self.end_px, self.interval_px, strict=True))
        object.__setattr__(self, "inside", (first, last))

    @property
    def ends_text(self) -> str:
        """Distance of both ends, px, "-" where nothing is published."""
        if self.published == 0.0:
            return "-"
        return " ".join(f"{px:.1f}{'' if ok else ' (outside)'}" for px, ok in zip(self.end_px, self.inside, strict=True))


@dataclass(frozen=True, kw_only=True)
class Row:
    """One frame. false_sure, sure : published at a probability of `SURE` or more, the false ones and all. CPU and wall seconds
    are those of its file, shared out among its frames.
    """

    file: str
    frame: str
    camera: str
    rows: int
    cols: int
    trails: tuple[Trail, ...]
    measured: int
    false: int
    false_sure: int
    sure: int
    cpu_s: float
    wall_s: float
    exit_code: int

    @property
    def kept(self) -> bool:
        """Whether the frame belongs to the half that nobody looks at while the program is changed.

        The rule is the last bit of SHA-256 of the file's name (without ".xz").
        """
        return bool(hashlib.sha256(self.file.encode()).digest()[-1] & 1)

    @property
    def calibrated(self) -> bool:
        """Whether dark and flat were applied to the frame before."""
        return any(word in self.camera for word in CALIBRATED)

    @property
    def line(self) -> str:
        """The frame in one line, for the reader of a run."""
        half = sum(trail.published >= HALF for trail in self.trails)
        found = sum(trail.found >= HALF for trail in self.trails)
        ends = "; ".join(trail.ends_text for trail in self.trails) or "-"
        return (
            f"{self.frame}: {len(self.trails)} trails, {found} measured, {half} published, ends off {ends} px, "
            f"{self.false} false of {self.measured} measured, {self.wall_s:.1f} s wall, exit {self.exit_code}"
        )


def share_text(k: int, n: int) -> str:
    """A proportion with its 95 % interval (Clopper & Pearson 1934)."""
    if n == 0:
        return "no case"
    low = 0.0 if k == 0 else float(beta.ppf(0.025, k, n - k + 1))
    high = 1.0 if k == n else float(beta.ppf(0.975, k + 1, n - k))
    return f"{k} of {n} ({100.0 * low:.0f} to {100.0 * high:.0f} %)"


def rate_text(k: int, n: int) -> str:
    """Counts in n frames as a rate with its 95 % interval (Garwood 1936)."""
    if n == 0:
        return "no case"
    low = 0.0 if k == 0 else 0.5 * float(chi2.ppf(0.025, 2 * k)) / n
    high = 0.5 * float(chi2.ppf(0.975, 2 * k + 2)) / n
    return f"{k} in {n}: {k / n:.3f} a frame ({low:.3f} to {high:.3f})"


def _verdict(cases: int, *, met: bool) -> str:
    """Whether a figure was met, where there was a case."""
    return "no case" if cases == 0 else "yes" if met else "no"


def _answers(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Measured, and whether it is met, for each of `ASKED`."""
    trails = [trail for row in rows for trail in row.trails]
    half = [trail for trail in trails if trail.published >= HALF]
    ends = [ok for trail in half for ok in trail.inside]
    sure, wrong = sum(row.sure for row in rows), sum(row.false_sure for row in rows)
    failed = sum(row.exit_code != 0 for row in rows)
    shares = [(len(half), len(trails)), (sum(ends), len(ends))]
    answers = [(share_text(k, n), _verdict(n, met=k >= LEAST_SHARE * n)) for k, n in shares]
    for wanted, most in ((False, MOST_FALSE_RAW), (True, MOST_FALSE_CALIBRATED)):
        blank = [row.false for row in rows if not row.trails and row.calibrated == wanted]
        answers.append((rate_text(sum(blank), len(blank)), _verdict(len(blank), met=sum(blank) <= most * len(blank))))
    answers.append((share_text(wrong, sure), _verdict(sure, met=wrong <= MOST_WRONG * sure)))
    return [*answers, (f"{failed} of {len(rows)}", _verdict(len(rows), met=failed == 0))]


def sums_text(rows: Sequence[Row]) -> str:
    """What is asked of real frames against what was measured, for all frames and for the half that is kept."""
    lines = ["| asked | all | met | kept half | met |", "|---|---|---|---|---|"]
    both = zip(ASKED, _answers(rows), _answers([row for row in rows if row.kept]), strict=True)
    table = [*lines, *(f"| {asked} | {' | '.join((*every, *kept))} |" for asked, every, kept in both)]
    return "\n".join([*table, "", _ends_text(rows)])


def _ends_text(rows: Sequence[Row]) -> str:
    """How much of what is asked of ends is owed to intervals, and whether these are as long as they should be."""
    half = [trail for row in rows for trail in row.trails if trail.published >= HALF]
    ends = [end for t in half for end in zip(t.end_px, t.inside, t.interval_px, strict=True)]
    fading = [ok for _, ok, interval_px in ends if interval_px > LONG_PX]
    near = share_text(sum(px <= NEAR_PX for px, _, _ in ends), len(ends))
    return (
        f"Ends within {NEAR_PX:g} px of the eye's, whatever is quoted: {near}. "
        f"With an interval of the light's end of more than {LONG_PX:g} px, as of trails that fade: {len(fading)}, "
        f"within it {share_text(sum(fading), len(fading))}; 68 % is what it stands for."
    )


def table_text(rows: Sequence[Row]) -> str:
    """The table of the page: a line for each frame with a trail, one for all blank frames of a camera, and the sums."""
    lines = [
        "| frame | trail by eye | measured | published | ends off (px) | S/N, p | false | CPU s | exit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        for number, trail in enumerate(row.trails):
            lines.append(
                f"| {row.frame} | {number + 1} | {trail.found:.0%} | {trail.published:.0%} | {trail.ends_text} | "
                f"{trail.snr:.0f}, {trail.probability:.2f} | {row.false} | {row.cpu_s:.1f} | {row.exit_code} |"
            )
    blank = [row for row in rows if not row.trails]
    for camera in dict.fromkeys(row.camera for row in blank):
        mine = [row for row in blank if row.camera == camera]
        codes = ", ".join(str(code) for code in sorted({row.exit_code for row in mine}))
        lines.append(
            f"| {camera}: {len(mine)} | none | {sum(row.measured for row in mine)} | - | - | - | "
            f"{sum(row.false for row in mine)} | {sum(row.cpu_s for row in mine):.1f} | {codes} |"
        )
    return "\n".join([*lines, "", sums_text(rows)])
