"""Shutter and clock: exposure times of each row, true and by the on-board clock."""

from dataclasses import dataclass, field

from sboc_e2e.icd.errors import UserError
from simulator.randomness import Effect, generator


@dataclass(frozen=True, kw_only=True)
class ShutterOptions:
    """Exposure of each row; a line time of zero is a global shutter."""

    exposure_s: float = field(default=0.2, metadata={"doc": "exposure of each row", "min": 1e-5, "max": 3600.0})
    line_time_us: float = field(
        default=10.0,
        metadata={
            "doc": "time to read a detector row, and of a CMOS the delay from the exposure of one row to the next; 0 is global",
            "min": 0.0,
            "max": 1e5,
        },
    )
    direction: str = field(
        default="down", metadata={"doc": "order in which rows start", "choices": ("down", "up", "alternating")}
    )

    def refuse_overlap(self, rows: int, frame_rate_hz: float) -> None:
        """UserError when exposure or read-out of a number of detector rows lasts longer than a frame.

        A rolling shutter exposes a row while others are read; where directions alternate, the row that is read last is the
        next frame's first, so that exposure and read-out must fit together.
        """
        period_s = 1.0 / frame_rate_hz
        readout_s = self.line_time_us * 1e-6 * rows
        allowed_s = period_s - (readout_s if self.direction == "alternating" else 0.0)
        fits = f"does not fit {frame_rate_hz:g} frames/s"
        if readout_s > period_s * (1.0 + 1e-9):
            raise UserError(
                f"shutter.line_time: {self.line_time_us:g} us for each of {rows} rows is a read-out of {readout_s:g} s, which "
                f"{fits}; allowed is up to {1e6 * period_s / rows:.4g} us"
            )
        if self.exposure_s > allowed_s + 1e-9 * period_s:
            beside = f" beside a read-out of {readout_s:g} s that alternates" if self.direction == "alternating" else ""
            raise UserError(f"shutter.exposure: {self.exposure_s:g} s {fits}{beside}; allowed is up to {allowed_s:.6g} s")


@dataclass(frozen=True, kw_only=True)
class ClockOptions:
    """Errors of the time tags (tag = true + offset + drift x time since epoch + jitter)."""

    offset_us: float = field(default=0.0, metadata={"doc": "constant offset of the tags", "min": -1e7, "max": 1e7})
    drift_ppm: float = field(default=0.0, metadata={"doc": "rate error of the clock", "min": -1e4, "max": 1e4})
    jitter_us: float = field(default=1.0, metadata={"doc": "rms of each tag", "min": 0.0, "max": 1e6})


@dataclass(frozen=True, kw_only=True)
class FrameTiming:
    """Times of one frame. `line_time_ns` is signed and counts rows of the grid it is made for.

    t_start_tai_ns : true start of exposure of row 0; clock_tai_ns : the same as tagged.
    """

    t_start_tai_ns: int
    clock_tai_ns: int
    exposure_ns: int
    line_time_ns: int
    rows: int

    @property
    def first_open_tai_ns(self) -> int:
        """Start of the first row to open."""
        return self.t_start_tai_ns + min(0, self.line_time_ns * (self.rows - 1))

    @property
    def last_close_tai_ns(self) -> int:
        """End of the last row to close."""
        return self.t_start_tai_ns + max(0, self.line_time_ns * (self.rows - 1)) + self.exposure_ns

    @property
    def middle_tai_ns(self) -> int:
        """Mid-exposure of the middle row, the epoch of the attitude."""
        return self.t_start_tai_ns + round(0.5 * self.line_time_ns * (self.rows - 1)) + self.exposure_ns // 2


def frame_timing(
    shutter: ShutterOptions,
    clock: ClockOptions,
    *,
    seed: int,
    epoch_tai_ns: int,
    frame: int,
    frame_rate_hz: float,
    rows: int,
    row_step: int,
) -> FrameTiming:
    """Times of one frame whose first row opens at ``epoch + frame / rate``.

    rows : delivered rows. row_step : detector rows for each of them; the epoch of a binned row is that of its middle.
    """
    first_open = epoch_tai_ns + round(frame * 1e9 / frame_rate_hz)
    upwards = shutter.direction == "up" or (shutter.direction == "alternating" and frame % 2 == 1)
    line_ns = round(shutter.line_time_us * 1e3 * row_step) * (-1 if upwards else 1)
    start = first_open + (abs(line_ns) * (rows - 1) if upwards else 0)
    start += round(0.5 * (row_step - 1) * shutter.line_time_us * 1e3)
    noise_us = clock.jitter_us * generator(seed, Effect.TIME_TAG, frame).standard_normal()
    since_us = (start - epoch_tai_ns) * 1e-3
    tag = start + round(1e3 * (clock.offset_us + clock.drift_ppm * 1e-6 * since_us + noise_us))
    return FrameTiming(
        t_start_tai_ns=start, clock_tai_ns=tag, exposure_ns=round(shutter.exposure_s * 1e9), line_time_ns=line_ns, rows=rows
    )
