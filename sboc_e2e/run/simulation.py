"""Simulated frames: made here or by worker processes, handed on in frame order, never more than a few at a time."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from typing import Any

from sboc_e2e.files import checkpoint, frame_fits
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.frame import Frame
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.measure import Meter, peak_rss_mb, reset_peak, stage_figures
from sboc_e2e.truth import FrameTruth
from simulator.chain import Simulator
from simulator.options import SimulatorOptions
from simulator.scene.stars import sky_catalogue

STAGE = "simulate"


@dataclass(kw_only=True)
class SimulationCost:
    """What the frames cost, summed over processes; peak memory of the largest."""

    wall_s: float = 0.0
    compile_cpu_s: float = 0.0
    frames_cpu_s: list[float] = field(default_factory=list)
    peak_rss_mb: float = 0.0

    def add(self, meter: Meter, peak_mb: float) -> None:
        """A frame was made."""
        self.wall_s += meter.wall_s
        self.compile_cpu_s += meter.compile_cpu_s
        self.frames_cpu_s.append(meter.cpu_s)
        self.peak_rss_mb = max(self.peak_rss_mb, peak_mb)

    def figures(self) -> dict[str, float]:
        """What the stage cost, for the manifest."""
        cpu_s = sum(self.frames_cpu_s)
        return stage_figures(
            wall_s=self.wall_s,
            cpu_s=cpu_s,
            frames_cpu_s=self.frames_cpu_s,
            peak_mb=self.peak_rss_mb,
            compile_cpu_s=self.compile_cpu_s,
        )


@dataclass(frozen=True, kw_only=True)
class FrameMaker:
    """Makes any frame of a simulation: truth to the work folder, the frame to frames/ where it is kept.

    keep_every : every n-th frame is kept as FITS, 0 for none.
    """

    run: RunDirectory
    options: SimulatorOptions
    seed: int
    keep_every: int

    def simulator(self) -> Simulator:
        """The simulator; costs seconds to set up."""
        return Simulator(self.options, seed=self.seed, catalogue=sky_catalogue(self.options.stars))

    def kept(self, frame: int) -> bool:
        """Whether frames/ keeps this frame."""
        return self.keep_every > 0 and frame % self.keep_every == 0

    def complete(self, frame: int) -> bool:
        """Whether everything that stays on disk of this frame is there."""
        truth = self.run.work_file(STAGE, frame, "truth")
        return truth.exists() and (not self.kept(frame) or self.run.frame_file(frame).exists())

    def make(self, simulator: Simulator, index: int) -> Frame:
        """Simulate a frame and write what stays of it, truth last."""
        frame, truth = simulator.frame(index)
        if self.kept(index):
            frame_fits.write(self.run.frame_file(index), frame)
        checkpoint.save(self.run.work_file(STAGE, index, "truth"), truth)
        return frame

    def truth(self, frame: int) -> FrameTruth:
        """Truth of a frame that was made."""
        result: FrameTruth = checkpoint.load(self.run.work_file(STAGE, frame, "truth"))
        return result


@dataclass(kw_only=True)
class FrameStream:
    """Frames in order, from this process or from workers.

    hand_over : whether pixels are wanted; if False, each frame is `None`.
    """

    maker: FrameMaker
    indices: Sequence[int]
    workers: int
    hand_over: bool
    simulator: Simulator
    cost: SimulationCost = field(default_factory=SimulationCost)

    def __iter__(self) -> Iterator[Frame | None]:
        if self.workers <= 1 or len(self.indices) <= 1:
            yield from self._here()
        else:
            yield from self._elsewhere()

    def _here(self) -> Iterator[Frame | None]:
        for index in self.indices:
            reset_peak()
            meter = Meter()
            with meter:
                frame = self.maker.make(self.simulator, index)
            self.cost.add(meter, peak_rss_mb())
            yield frame if self.hand_over else None

    def _elsewhere(self) -> Iterator[Frame | None]:
        """Frames of a pool of processes. The number of waiting frames is at most the number of workers plus one."""
        pool = ProcessPoolExecutor(
            max_workers=self.workers,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_start_worker,
            initargs=(self.maker,),
        )
        waiting: list[Future[Any]] = []
        todo = iter(self.indices)
        try:
            for index in self.indices:
                while len(waiting) < self.workers + 1 and (following := next(todo, None)) is not None:
                    waiting.append(pool.submit(_make_in_worker, following, self.hand_over))
                self.cost.add(*waiting.pop(0).result())
                yield self._take(index) if self.hand_over else None
        except BrokenProcessPool as error:
            raise PluginError("a simulation worker died (out of memory, or killed); go on with --resume --workers 1") from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)

    def _take(self, index: int) -> Frame:
        path = self.maker.run.work_file(STAGE, index, "frame")
        frame: Frame = checkpoint.load(path)
        path.unlink()
        return frame


_worker: dict[str, Any] = {}
"""Simulator of a worker process; set once when the process starts."""


def _start_worker(maker: FrameMaker) -> None:
    _worker["maker"], _worker["simulator"] = maker, maker.simulator()


def _make_in_worker(index: int, hand_over: bool) -> tuple[Meter, float]:
    """Make a frame; its pixels wait in a file until the on-board stage takes them."""
    maker: FrameMaker = _worker["maker"]
    meter = Meter()
    reset_peak()
    with meter:
        frame = maker.make(_worker["simulator"], index)
    if hand_over:
        checkpoint.save(maker.run.work_file(STAGE, index, "frame"), frame)
    return meter, peak_rss_mb()
