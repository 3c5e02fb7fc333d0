"""Packets -> products: the ground chain frame by frame, then linking and orbits, then the tables.

Reads downlink.bin, calibration/ and the star catalogue; nothing else of a run.
"""

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Column, Table

from ground.astrometry.header_wcs import doubt_of
from ground.astrometry.wcs_export import pixel_icrs
from ground.chain import GroundChain, GroundSteps
from ground.ingest import IngestReport
from ground.on_demand import OnDemand
from ground.options import GroundOptions
from ground.orbit.catalogue_match import KnownObjects
from ground.orbit.reference import PreciseOrbit
from ground.products import tables
from ground.products.images import frame_images, has_images
from ground.products.lacking import lacking
from ground.products.oem import oem_text
from ground.products.opm import SAMPLES_NAME, opm_text
from ground.products.orbit_samples import orbit_samples_tables
from ground.products.population import population, population_table
from ground.products.tdm import tdm_text
from ground.products.tdm_angles import TDM_ANGLES_NAME, tdm_angles_table
from ground.products.trail_light import trail_light_tables
from ground.records import FrameProducts, GroundProducts, GroundState
from ground.vetting.look_alikes import LookAlikeVetter, OwnEvidence
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files import checkpoint, ecsv
from sboc_e2e.files.atomic import replacing, write_json, write_text
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Calibration, NominalCamera
from sboc_e2e.run import known_objects
from sboc_e2e.run.decoders import decoders_of
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.measure import Meter, peak_rss_mb, reset_peak, stage_figures
from sboc_e2e.run.progress import Progress
from sboc_e2e.run.states import StateKeeper
from sboc_e2e.scenario import Scenario
from simulator.scene.stars import sky_catalogue

STAGE = "ground"
TDM_NAME: Final = "tracklets.tdm"
OEM_NAME: Final = "observer.oem"
PRODUCTS_KEPT: Final = 64
"""Frames whose products stay in memory after they were asked for: as long as most tracklets last."""

RUNS_NAMED: Final = 5
"""Other runs that a line names; `ingest.json` has all of them."""


@dataclass(frozen=True, kw_only=True)
class Outside:
    """What is known of frames from outside: file and HDU, the WCS of its header, and notes on it, by frame number.

    left_out : what could not be taken as a frame. look_alikes : counts of lines in the negative of each frame, by least S/N.
    cameras : numbers of the cameras of frames; frames of another camera tell nothing of one's sky or PSF.
    """

    origin: Mapping[int, tuple[str, int]] = field(default_factory=dict)
    wcs: Mapping[int, Any] = field(default_factory=dict)
    notes: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    look_alikes: Mapping[int, Mapping[str, int]] = field(default_factory=dict)
    cameras: Mapping[int, int] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """What ingest.json says of them; nothing of frames that were simulated."""
        if not self.origin:
            return {}
        frames = [
            {
                "frame": number,
                "file": file,
                "hdu": hdu,
                "notes": list(self.notes.get(number, ())),
                "look_alikes": dict(self.look_alikes.get(number, {})),
            }
            for number, (file, hdu) in sorted(self.origin.items())
        ]
        return {"outside": {"frames": frames, "left_out": list(self.left_out)}}


def ground_chain(
    scenario: Scenario,
    *,
    calibration: Calibration | None,
    camera: NominalCamera,
    catalogue: StarCatalogue,
    run_id: int | None = None,
    cameras: Mapping[int, NominalCamera] | None = None,
    evidence: Mapping[int, OwnEvidence] | None = None,
) -> GroundChain:
    """The ground chain of a scenario for the packets of a run. It has the chosen decoder and every shipped one.

    cameras : see `GroundChain`. evidence : by frame number, what frames that nobody calibrated say of their own false lines.
    """
    vetter = scenario.step("ground.vetter")
    steps = GroundSteps(
        decoders=decoders_of(scenario),
        streak_fitter=scenario.step("ground.streak_fitter"),
        vetter=LookAlikeVetter(vetter=vetter, evidence=evidence) if evidence else vetter,
        astrometry=scenario.step("ground.astrometry"),
        photometry=scenario.step("ground.photometry"),
        linker=scenario.step("ground.linker"),
        orbit=scenario.step("ground.orbit"),
    )
    return GroundChain(
        scenario.ground, steps, calibration=calibration, camera=camera, catalogue=catalogue, run_id=run_id, cameras=cameras
    )


def star_catalogue(scenario: Scenario) -> StarCatalogue:
    """The star catalogue of ground: its own, else the one of the simulated sky. Raises `UserError` for a file that is no
    catalogue."""
    path = scenario.ground.catalogue_file
    try:
        return StarCatalogue.open(path) if path else sky_catalogue(scenario.simulator.stars)
    except UserError as error:
        raise UserError(f"ground.catalogue_file: {error}" if path else str(error)) from error


def require_files(scenario: Scenario) -> None:
    """Open what ground is to read beside a run, so that a bad file is refused before hours of simulation, not after."""
    star_catalogue(scenario)
    known_objects.known_objects(scenario.ground)
    known_objects.precise_orbits(scenario.ground)


@dataclass(kw_only=True)
class GroundStage:
    """The ground stage of a run."""

    run: RunDirectory
    chain: GroundChain
    options: GroundOptions
    catalogue: StarCatalogue
    outside: Outside = field(default_factory=Outside)
    resumed: bool = True
    """Whether the run can be resumed."""
    meter: Meter = field(default_factory=Meter)
    frame_meter: Meter = field(default_factory=Meter)
    """Per-frame share of `meter`."""
    peak_rss_mb: float = 0.0
    _doubts: dict[int, str] = field(default_factory=dict)
    """What stars say against the WCS of headers, by frame number."""
    _received: tuple[tuple[DownlinkFrame, ...], IngestReport] | None = None
    """What `receive` returned."""
    _known: KnownObjects | None = None
    _precise: tuple[PreciseOrbit, ...] = ()

    def receive(self, progress: Progress) -> tuple[tuple[DownlinkFrame, ...], IngestReport]:
        """Frames of the downlink, and what ingest says of it; reads the files beside it too, and writes nothing.

        Raises `UserError` for what gives no products.
        """
        reset_peak()
        self._known, self._precise = known_objects.known_objects(self.options), known_objects.precise_orbits(self.options)
        try:
            downlink = self.run.downlink.read_bytes()
        except FileNotFoundError as error:
            raise UserError(f"{self.run.downlink}: not found; the onboard stage writes it") from error
        with self.meter:
            self._received = self.chain.ingest(downlink)
        _judge(self.run.downlink, self._received[1], progress)
        return self._received

    def execute(self, progress: Progress) -> None:
        """Make all products."""
        frames, ingest = self._received or self.receive(progress)
        known, precise = self._known, self._precise
        self._process_frames(frames, progress)
        products = OnDemand(len(frames), self._stored, keep=PRODUCTS_KEPT)
        with self.meter:
            result = self.chain.finish(frames, products, ingest)
            debris = population(result, frames, self.chain.camera)
        made = self.run.work(STAGE) / "products"
        shutil.rmtree(made, ignore_errors=True)
        self._write(made, frames, result)
        flux = population_table(debris)
        ecsv.write_table(made / "population.ecsv", flux)
        if self.options.products.tracklet_plots:
            # here, since matplotlib takes longer to load than a frame to process
            from sboc_e2e.run.population_plot import population_svg

            write_text(made / "plots" / "population.svg", population_svg(flux))
        if known is not None:
            ecsv.write_table(made / "known.ecsv", known_objects.matches(result, known))
        if precise:
            write_json(made / "bias.json", known_objects.bias(result, precise))
        self._publish(made)
        self.peak_rss_mb = peak_rss_mb()

    def figures(self) -> dict[str, float]:
        """What the stage cost, for the manifest."""
        meter, frames = self.meter, self.frame_meter
        return stage_figures(
            wall_s=meter.wall_s,
            cpu_s=meter.cpu_s,
            frames_cpu_s=frames.blocks_cpu_s,
            peak_mb=self.peak_rss_mb,
            compile_cpu_s=meter.compile_cpu_s,
        )

    def _publish(self, made: Path) -> None:
        """Finished products take the place of earlier ones, which stay until then; nothing stale is left among them."""
        earlier = self.run.work(STAGE) / "earlier"
        shutil.rmtree(earlier, ignore_errors=True)
        if self.run.products.is_dir():
            self.run.products.rename(earlier)
        made.rename(self.run.products)

    def _process_frames(self, frames: Sequence[DownlinkFrame], progress: Progress) -> None:
        """Products of each frame into the work folder, from where an earlier attempt stopped."""
        keeper = StateKeeper(run=self.run, stage=STAGE, shared={"catalogue": self.catalogue}, resumed=self.resumed)
        last = keeper.last()
        states: dict[int, GroundState]  # by camera
        first, states = (0, {}) if last is None else (last[0] + 1, last[1])
        progress.stage(STAGE, len(frames), first)
        for position in range(first, len(frames)):
            frame = frames[position]
            camera = self.outside.cameras.get(frame.header.frame, 0)
            with self.meter, self.frame_meter:
                state = states.get(camera) or self.chain.initial_state(frame.header)
                states[camera], made = self.chain.process_frame(state, frame, wcs=self.outside.wcs.get(frame.header.frame))
            doubt = None if made.wcs is None else doubt_of(made.solution, self.chain.camera.psf_sigma_px)
            if doubt is not None:
                self._doubts[frame.header.frame] = doubt
            checkpoint.save(self.run.work_file(STAGE, position, "result"), dataclasses.replace(made, wcs=None))
            keeper.offer(position, states)
            progress.advance()
        if self._doubts:
            progress.note(f"{len(self._doubts)} of {len(frames)} frames: {next(iter(self._doubts.values()))}")

    def _stored(self, position: int) -> FrameProducts:
        """Products of a frame from the work folder."""
        products: FrameProducts = checkpoint.load(self.run.work_file(STAGE, position, "result"))
        wcs = self.outside.wcs.get(products.header.frame)
        return products if wcs is None else dataclasses.replace(products, wcs=wcs)

    def _write(self, folder: Path, frames: Sequence[DownlinkFrame], result: GroundProducts) -> None:
        """The tables and messages of products/."""
        options, outside = self.options, self.outside
        doubts = {number: (*outside.notes.get(number, ()), doubt) for number, doubt in self._doubts.items()}
        outside = dataclasses.replace(outside, notes={**outside.notes, **doubts})
        pieces = (_with_origin(table, outside) for table in tables.frames_tables(result, frames))
        ecsv.write_pieces(folder / "frames.ecsv", pieces)
        ecsv.write_pieces(folder / "stars.ecsv", tables.stars_tables(result, frames))
        ecsv.write_pieces(folder / "streaks.ecsv", tables.streaks_tables(result))
        ecsv.write_pieces(folder / "light_curves.ecsv", trail_light_tables(result))
        ecsv.write_table(folder / "tracklets.ecsv", tables.tracklets_table(result))
        ecsv.write_table(folder / "orbits.ecsv", tables.orbits_table(result))
        ecsv.write_pieces(folder / SAMPLES_NAME, orbit_samples_tables(result.orbits, result.headers))
        for orbit in result.orbits:
            opm = opm_text(orbit, options.products, max(header.t_start_tai_ns for header in result.headers))
            if opm is not None:
                write_text(folder / "states" / f"tracklet_{orbit.tracklet_id:06d}.opm", opm)
        oem = oem_text(result.headers, options.products)
        if oem is not None:
            write_text(folder / OEM_NAME, oem)
        if result.headers:  # a message says when it was made, which is when the last frame was
            oem_name = OEM_NAME if oem else None
            tdm = tdm_text(result.tracklets, result.members, result.headers, options.products, oem_name=oem_name)
            write_text(folder / TDM_NAME, tdm)
            errors = tdm_angles_table(result.tracklets, result.members, result.headers, options.products, oem_name=oem_name)
            ecsv.write_table(folder / TDM_ANGLES_NAME, errors)
        lacks = {"products_lack": lacking(result, orbits_wanted=options.orbits)}
        write_json(folder / "ingest.json", (result.ingest.as_dict() if result.ingest else {}) | lacks | outside.as_dict())
        self._write_images(folder / "images", frames, result)
        if options.products.tracklet_plots:
            # here, since matplotlib takes longer to load than a frame to process
            from sboc_e2e.run.tracklet_plot import tracklet_svg

            for tracklet, members in zip(result.tracklets, result.members, strict=True):
                path = folder / "plots" / f"tracklet_{tracklet.tracklet_id:06d}.svg"
                write_text(path, tracklet_svg(tracklet, members))

    def _write_images(self, folder: Path, frames: Sequence[DownlinkFrame], result: GroundProducts) -> None:
        """Pixels that came down, as FITS, a frame at a time."""
        wanted = self.options.products.images
        for position, frame in enumerate(frames):
            if has_images(frame, wanted):
                number = frame.header.frame
                icrs = pixel_icrs(frame.header, result.solutions[position], self.outside.wcs.get(number))
                with replacing(folder / f"{number:06d}.fits") as stream:
                    frame_images(frame, icrs, wanted).writeto(stream)


def _judge(path: Path, ingest: IngestReport, progress: Progress) -> None:
    """Say what a downlink lacks of this run and holds of others. Raises `UserError` when it holds nothing of this run."""
    others = sorted(ingest.foreign_runs.items(), key=lambda pair: (-pair[1], pair[0]))
    listed = ", ".join(f"{run} ({n} packets)" for run, n in others[:RUNS_NAMED]) + (", ..." if len(others) > RUNS_NAMED else "")
    if ingest.run_id is None and others:
        raise UserError(
            f"{path}: no intact packet of the run asked for, only of others: {listed}; --run-id NUMBER takes one of them"
        )
    if ingest.run_id is None and ingest.n_bytes > 0:
        unread = f" and {ingest.other_contract} of other versions of the contract" if ingest.other_contract else ""
        raise UserError(f"{path}: {ingest.n_bytes} bytes without an intact packet{unread}; the onboard stage writes it")
    if ingest.run_id is None:
        raise UserError(f"{path}: empty; the onboard stage writes it")
    if ingest.n_decode_failures:
        progress.note(f"{path}: {ingest.n_decode_failures} packets could not be decoded, such as {ingest.decode_failures[0]}")
    if others:
        progress.note(f"{path}: packets of other runs were left out: {listed}; --run-id NUMBER takes one of them")
    if ingest.frames_unusable:
        progress.note(f"{path}: no intact header packet, without which none of {len(ingest.frames_unusable)} frames can be built")


def _with_origin(table: Table, outside: Outside) -> Table:
    """The frames table with the file and HDU that each frame came from, and notes on it, where frames came from files."""
    origin = outside.origin
    if origin:
        places = [origin.get(int(frame), ("-", -1)) for frame in table["frame"]]
        names = np.array([name for name, _ in places], dtype=str) if places else np.zeros(0, dtype="U1")
        table["file"] = Column(names, description="file that the frame came from")
        table["hdu"] = Column(np.array([hdu for _, hdu in places], dtype=np.int64), description="header-data unit in that file")
        notes = np.array(["; ".join(outside.notes.get(int(frame), ())) or "-" for frame in table["frame"]], dtype=str)
        table["notes"] = Column(notes, description="what its header lacks, and which planes beside it were used")
    return table
