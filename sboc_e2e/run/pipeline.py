"""Stages in order over a run directory: simulate and on board together, frame by frame; then ground, score, report."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from sboc_e2e.faults import damaged_frame, delivered_frames
from sboc_e2e.files import calibration_files, frame_fits
from sboc_e2e.files.atomic import write_json
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Frame
from sboc_e2e.registry import Registry
from sboc_e2e.report.write import write_report
from sboc_e2e.run import disk, onboard_stage, truth_files
from sboc_e2e.run.decoders import decoders_of, require_decoder
from sboc_e2e.run.directory import STAGES, RunDirectory
from sboc_e2e.run.ground_stage import GroundStage, ground_chain, require_files, star_catalogue
from sboc_e2e.run.manifest import Manifest, decisive, first_difference
from sboc_e2e.run.onboard_stage import OnboardStage, onboard_chain
from sboc_e2e.run.progress import Progress, Silent
from sboc_e2e.run.simulation import FrameMaker, FrameStream, SimulationCost
from sboc_e2e.run.workers import simulation_processes
from sboc_e2e.scenario import Scenario
from sboc_e2e.score import Evaluation, evaluate, score_evaluation
from simulator.chain import Simulator

KEEP_KEY: Final = "output.keep_frames_every"


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """What the user asked for."""

    scenario: Scenario
    out: Path
    resume: bool = False
    force: bool = False
    workers: int = 0
    """Simulation processes; 0 for as many as pay (`simulation_processes`)."""


@dataclass(kw_only=True)
class Run:
    """A run directory with its manifest and resolved scenario; each method is one stage."""

    directory: RunDirectory
    manifest: Manifest
    scenario: Scenario
    workers: int
    progress: Progress = field(default_factory=Silent)
    present: Manifest | None = None
    """The manifest that this program would begin the run with, where the caller has it already."""
    _evaluation: Evaluation | None = None
    """What the score stage found, for the report that follows it."""

    @classmethod
    def open(cls, path: Path, registry: Registry, *, workers: int = 0, progress: Progress | None = None) -> "Run":
        """An existing run. Raises `UserError` when the directory holds none."""
        directory = RunDirectory(path=path).require()
        manifest = Manifest.read(directory.manifest)
        scenario = manifest.resolve(registry)
        return cls(
            directory=directory,
            manifest=manifest,
            scenario=scenario,
            workers=simulation_processes(workers, scenario),
            progress=progress or Silent(),
        )

    # -- simulate ---------------------------------------------------------------------------------------------------

    def simulate(self) -> None:
        """All frames and their truth; frames stay on disk as the scenario says."""
        maker, simulator = self._maker(), self.open_simulator()
        self._drop_work_of_other_code("simulate")
        self._write_calibration(simulator.calibration)
        todo = [index for index in range(self.manifest.n_frames) if not maker.complete(index)]
        self.manifest.forget(STAGES)
        for later in ("onboard", "ground"):
            self.directory.clear_work(later)
        self._begin("simulate")
        self.progress.stage("simulate", self.manifest.n_frames, self.manifest.n_frames - len(todo))
        stream = FrameStream(maker=maker, indices=todo, workers=self.workers, hand_over=False, simulator=simulator)
        for _ in stream:
            self.progress.advance()
        self._finish_simulation(maker, simulator.objects(), simulator.population_summary(), stream.cost)

    def onboard(self) -> None:
        """Packets of the kept frames. Raises `UserError` when not all frames were kept."""
        self._require("simulate")
        missing = [i for i in range(self.manifest.n_frames) if not self.directory.frame_file(i).exists()]
        if missing:
            raise UserError(
                f"{self.directory.frames}: {len(missing)} of {self.manifest.n_frames} frames were not kept; "
                f"keep all of them: sboc run SCENARIO --out {self.directory.path} --force --set {KEEP_KEY}=1"
            )
        self.directory.clear_work("onboard")
        stage = self._onboard_stage()
        self._begin_onboard(stage)
        plan = self._plan()
        frames = (self._as_delivered(frame_fits.read(self.directory.frame_file(number))) for number in plan)
        self._finish_onboard(stage, stage.take(frames, self.progress))

    def open_simulator(self) -> Simulator:
        """The scenario's simulator; writes nothing. Raises `UserError` for what it cannot simulate."""
        try:
            return self._maker().simulator()
        except UserError as error:
            raise UserError(f"scenario {self.scenario.name}: {self.scenario.told(str(error))}") from error

    def simulate_and_onboard(self, simulator: Simulator | None = None) -> None:
        """Simulator and on-board software, streamed: only a few frames exist at a time."""
        maker = self._maker()
        simulator = simulator or self.open_simulator()
        if self._drop_work_of_other_code("simulate") or self._drop_work_of_other_code("onboard"):
            self.directory.clear_work("onboard")  # its states follow frames whose truth is in the other folder
        self._write_calibration(simulator.calibration)
        stage = self._onboard_stage()
        # Truth that is joined is not joined again: that of frames before the on-board state is no longer there by frame.
        simulated = self.manifest.done("simulate")
        if not simulated:
            self._begin("simulate")
        self._begin_onboard(stage)
        plan = self._plan()
        indices = range(_next_to_make(plan, stage.first), self.manifest.n_frames)
        stream = FrameStream(maker=maker, indices=indices, workers=self.workers, hand_over=True, simulator=simulator)

        def frames() -> Iterator[Frame]:
            position = stage.first
            for frame in stream:
                while frame is not None and position < len(plan) and plan[position] == frame.header.frame:
                    position += 1
                    yield self._as_delivered(frame)

        n_onboard = stage.take(frames(), self.progress)
        if not simulated:
            self._finish_simulation(maker, simulator.objects(), simulator.population_summary(), stream.cost)
        self.directory.clear_work("simulate")
        self._finish_onboard(stage, n_onboard)

    # -- ground -----------------------------------------------------------------------------------------------------

    def ground(self, run_id: int | None = None) -> None:
        """Products from downlink, calibration and catalogue; run_id : whose packets are used, None for this run's."""
        wanted = self.manifest.run_id if run_id is None else run_id
        calibration = calibration_files.read(self.directory.calibration)
        camera = calibration_files.read_camera(self.directory.calibration)
        catalogue = star_catalogue(self.scenario)
        chain = ground_chain(self.scenario, calibration=calibration, camera=camera, catalogue=catalogue, run_id=wanted)
        stage = GroundStage(run=self.directory, chain=chain, options=self.scenario.ground, catalogue=catalogue)
        stage.receive(self.progress)  # what is refused leaves finished results as they are
        if self.manifest.stages.get("ground", {}).get("run_id", self.manifest.run_id) != wanted:
            self.directory.clear_work("ground")  # an interrupted attempt at another run's packets
        self._drop_work_of_other_code("ground")
        self.manifest.forget(("score", "report"))
        self._begin("ground", run_id=wanted)
        stage.execute(self.progress)
        self.manifest.finish("ground", **stage.figures())
        self.directory.clear_work("ground")

    def evaluation(self, truth: Path | None = None) -> Evaluation:
        """Truth and products brought together, the packets read with the decoders of the run."""
        found = evaluate(self.directory.path, truth, decoders_of(self.scenario))
        for note in found.notes:
            self.progress.note(f"{self.directory.path}: {note}")
        return found

    def score(self, truth: Path | None = None, found: Evaluation | None = None) -> None:
        """score.json against the run's truth, or against truth from elsewhere, which the report reads again.

        found : that evaluation, where the caller has it already.
        """
        self._require("ground")
        self.progress.stage("score", 1)
        self._evaluation = found or self.evaluation(truth)
        figures = score_evaluation(self._evaluation, self.directory.path)
        self.manifest.forget(("score", "report"))
        self._begin("score")
        write_json(self.directory.score, figures)
        self.manifest.finish("score", **({"truth": str(truth.resolve())} if truth else {}))
        self.progress.advance()

    def report(self) -> None:
        """report.html and report.md."""
        self._require("score")
        self.progress.stage("report", 1)
        truth = self.manifest.stages["score"].get("truth")
        evaluation = self._evaluation or self.evaluation(Path(truth) if truth else None)
        self._begin("report")
        write_report(self.directory.path, evaluation)
        self.manifest.finish("report")
        self.progress.advance()

    # -- parts ------------------------------------------------------------------------------------------------------

    def _require(self, stage: str) -> None:
        if not self.manifest.done(stage):
            raise UserError(f"{self.directory.path}: stage {stage} is not done; run: sboc {stage} {self.directory.path}")

    def _made_by(self, stage: str) -> dict[str, Any]:
        """What decides the bytes of a stage that this process makes."""
        if self.present is None:
            self.present = Manifest.of(self.directory.manifest, self.scenario)
        return self.present.made_by(stage)

    def _begin(self, stage: str, **figures: int) -> None:
        """Note that a stage runs, on what and by which code."""
        self.manifest.begin(stage, made_by=self._made_by(stage), **figures)

    def _other_code(self, stage: str) -> str | None:
        """What differs between the code that last made a stage and this process's; None: nothing."""
        earlier = self.manifest.stages.get(stage, {}).get("made_by")
        return first_difference(decisive(earlier), decisive(self._made_by(stage))) if earlier else "of which nothing is known"

    def _drop_work_of_other_code(self, stage: str) -> bool:
        """Begin an interrupted stage anew whose attempt was made by other code; whether there was such an attempt."""
        if not self.directory.work(stage).is_dir():
            return False
        difference = self._other_code(stage)
        if difference is not None:
            self.progress.note(
                f"{self.directory.path}: stage {stage} begins anew; an attempt by other code was interrupted ({difference})"
            )
            self.directory.clear_work(stage)
        return difference is not None

    def _maker(self) -> FrameMaker:
        return FrameMaker(
            run=self.directory,
            options=self.scenario.simulator,
            seed=self.scenario.seed,
            keep_every=self.scenario.output.keep_frames_every,
        )

    def _plan(self) -> tuple[int, ...]:
        """Numbers of the frames that reach the on-board software, in order."""
        return delivered_frames(self.manifest.n_frames, self.scenario.faults, self.scenario.seed)

    def _as_delivered(self, frame: Frame) -> Frame:
        """A frame as the on-board software gets it."""
        return damaged_frame(frame, self.scenario.faults, self.scenario.seed)

    def _write_calibration(self, make: Callable[[], object]) -> None:
        """Calibration is made once, and again where other code made it or one of its four files is missing or damaged."""
        other_code = self._other_code("simulate") is not None
        if other_code and "simulate" in self.manifest.stages:
            # If this is interrupted, no stage may count as done on a calibration that is not its own.
            self.manifest.forget(STAGES)
            self.manifest.save()
        if other_code or not calibration_files.is_whole(self.directory.calibration):
            calibration_files.write(self.directory.calibration, make())  # type: ignore[arg-type]

    def _onboard_stage(self) -> OnboardStage:
        calibration = calibration_files.read(self.directory.calibration)
        camera = calibration_files.read_camera(self.directory.calibration)
        chain = onboard_chain(self.scenario, calibration=calibration, camera=camera, run_id=self.manifest.run_id)
        return OnboardStage(run=self.directory, chain=chain)

    def _begin_onboard(self, stage: OnboardStage) -> None:
        self.manifest.forget(("ground", "score", "report"))
        self.directory.clear_work("ground")
        self._begin("onboard")
        self.progress.stage("simulate + onboard", len(self._plan()), stage.first)

    def _finish_onboard(self, stage: OnboardStage, n_frames: int) -> None:
        onboard_stage.join(self.directory, n_frames, self.scenario.faults, self.scenario.seed)
        self.manifest.finish("onboard", **stage.figures())
        self.directory.clear_work("onboard")

    def _finish_simulation(self, maker: FrameMaker, objects: object, population: object, cost: SimulationCost) -> None:
        truth_files.write(self.directory, maker.truth, self.manifest.n_frames, objects, population)  # type: ignore[arg-type]
        self.manifest.finish("simulate", **cost.figures())
        self.directory.clear_work("simulate")


def run(request: RunRequest, progress: Progress | None = None) -> Run:
    """All stages of a scenario, from where an earlier attempt stopped when `resume` is set."""
    shown = progress or Silent()
    workers = simulation_processes(request.workers, request.scenario)
    directory = RunDirectory(path=request.out)
    wanted = Manifest.of(directory.manifest, request.scenario)
    directory.check(resume=request.resume, force=request.force)
    require_files(request.scenario)
    require_decoder(request.scenario)
    disk.check(request.out, request.scenario, shown)
    made = Run(directory=directory, manifest=wanted, scenario=request.scenario, workers=workers, progress=shown, present=wanted)
    # What the simulator refuses leaves no folder behind, and with --force the earlier run stays.
    simulator = None if request.resume else made.open_simulator()
    if directory.prepare(resume=request.resume, force=request.force):
        made.manifest = Manifest.read(directory.manifest)
        _same_run(made.manifest, wanted)
    else:
        made.manifest.save()
    if not made.manifest.done("onboard"):
        made.simulate_and_onboard(simulator)
    for stage, execute in (("ground", made.ground), ("score", made.score), ("report", made.report)):
        if not made.manifest.done(stage):
            execute()
    return made


def _next_to_make(plan: tuple[int, ...], first: int) -> int:
    """The first frame to make so that the on-board stage can go on at position `first` and no dropped frame lacks its truth."""
    after_last = plan[first - 1] + 1 if first > 0 else 0
    return min(after_last, plan[first]) if first < len(plan) else after_last


def _same_run(found: Manifest, wanted: Manifest) -> None:
    """Refuse to resume a run of another scenario or of other versions."""
    difference = found.difference(wanted)
    if difference:
        raise UserError(f"{found.path.parent}: belongs to another run ({difference}); --force replaces it, --out goes elsewhere")
