"""Frames -> packets: the on-board chain frame by frame, its packets kept as they leave and joined at the end."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from onboard import latency
from onboard.chain import OnboardChain, OnboardResult, OnboardState, OnboardSteps, RunEnd
from sboc_e2e.faults import FaultOptions, damaged_packets, split_packets
from sboc_e2e.files.atomic import replacing, write_bytes
from sboc_e2e.icd.frame import Calibration, Frame, NominalCamera
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.measure import Meter, peak_rss_mb, reset_peak, stage_figures
from sboc_e2e.run.progress import Progress
from sboc_e2e.run.states import StateKeeper

if TYPE_CHECKING:
    from sboc_e2e.scenario import Scenario

STAGE = "onboard"


def onboard_steps(scenario: "Scenario") -> OnboardSteps:
    """The on-board steps of a scenario."""
    return OnboardSteps(
        background=scenario.step("onboard.background"),
        star_extractor=scenario.step("onboard.star_extractor"),
        detector=scenario.step("onboard.detector"),
        tracker=scenario.step("onboard.tracker"),
        codec=scenario.step("onboard.codec"),
    )


def onboard_chain(scenario: "Scenario", *, calibration: Calibration | None, camera: NominalCamera, run_id: int) -> OnboardChain:
    """The on-board chain of a scenario."""
    return OnboardChain(scenario.onboard, onboard_steps(scenario), calibration=calibration, camera=camera, run_id=run_id)


class Sequence(Protocol):
    """What takes frames as `onboard.latency.FrameSequence` does."""

    def take(self, frame: Frame) -> tuple[OnboardResult, ...]:
        """What a frame makes known."""
        ...

    @property
    def is_open(self) -> bool:
        """Whether something is left to be sent after the last frame."""
        ...

    def end(self) -> tuple[OnboardResult | RunEnd, ...]:
        """What is sent after the last frame."""
        ...

    @property
    def state(self) -> Any:
        """What is kept for a run that is resumed."""
        ...


@dataclass(kw_only=True)
class OnboardStage:
    """The on-board stage of a run, ready to take frames from `first` on."""

    run: RunDirectory
    chain: OnboardChain
    resumed: bool = True
    """Whether the run can be resumed."""
    keep: Callable[[int, bytes], None] | None = None
    """Takes the packets that left at a position, in place of a file."""
    sequence: Sequence | None = None
    """Takes the frames in place of the chain's own sequence; such a run is not resumed."""
    meter: Meter = field(default_factory=Meter)
    peak_rss_mb: float = 0.0

    def __post_init__(self) -> None:
        self._keeper = StateKeeper(run=self.run, stage=STAGE, resumed=self.resumed)
        last = self._keeper.last()
        self.first: int = 0 if last is None else last[0] + 1
        state: OnboardState = self.chain.initial_state() if last is None else last[1]
        self._sequence: Sequence = self.sequence or latency.FrameSequence(chain=self.chain, state=state)

    def take(self, frames: Iterable[Frame], progress: Progress) -> int:
        """Process frames in order; returns how many the run has in all."""
        position = self.first
        for frame in frames:
            reset_peak()
            with self.meter:
                results = self._sequence.take(frame)
            self.peak_rss_mb = max(self.peak_rss_mb, peak_rss_mb())
            self._write(position, results)
            self._keeper.offer(position, self._sequence.state)
            position += 1
            progress.advance()
        left: tuple[OnboardResult | RunEnd, ...] = ()
        if self._sequence.is_open:
            reset_peak()
            with self.meter:
                left = self._sequence.end()
            self.peak_rss_mb = max(self.peak_rss_mb, peak_rss_mb())
        self._write(position, left)
        return position

    def _write(self, position: int, results: Iterable[OnboardResult | RunEnd]) -> None:
        """Keep the packets that left at a position; after the last frame those of what waited."""
        (self.keep or partial(keep, self.run))(position, b"".join(result.packets for result in results))

    def figures(self) -> dict[str, float]:
        """What the stage cost, for the manifest."""
        meter = self.meter
        return stage_figures(
            wall_s=meter.wall_s,
            cpu_s=meter.cpu_s,
            frames_cpu_s=meter.blocks_cpu_s,
            peak_mb=self.peak_rss_mb,
            compile_cpu_s=meter.compile_cpu_s,
        )


def keep(run: RunDirectory, position: int, packets: bytes) -> None:
    """Keep the packets that left at a position for `join`."""
    write_bytes(run.work_file(STAGE, position, "bin"), packets)


def join(run: RunDirectory, n_frames: int, faults: FaultOptions, seed: int) -> None:
    """Write downlink.bin from the packets of all frames, as they arrive on ground."""
    files = (run.work_file(STAGE, position, "bin") for position in range(n_frames + 1))
    with replacing(run.downlink) as stream:
        if faults.packets.any:
            packets = [packet for path in files for packet in split_packets(path.read_bytes())]
            stream.write(damaged_packets(packets, faults.packets, seed)[0])
        else:
            for path in files:
                stream.write(path.read_bytes())
