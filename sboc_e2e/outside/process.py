"""`sboc process`: frames from outside through the on-board and the ground chain; products, and no score without truth."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from ground.astrometry import lost_in_space
from ground.vetting.rim import ImageCircle
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files import calibration_files
from sboc_e2e.icd.frame import Frame, NominalCamera
from sboc_e2e.outside import beside
from sboc_e2e.outside.camera import camera_of_frame, camera_of_preset, focal_px_by_stars, refuse_narrow_field
from sboc_e2e.outside.first_frame import FirstFrame
from sboc_e2e.outside.frame_source import FrameSource, SourcedFrame
from sboc_e2e.outside.limits import MOST_DETECTIONS, MOST_HITS
from sboc_e2e.outside.look_alikes import CountingChain, counts_of
from sboc_e2e.outside.rehearsal import rehearse
from sboc_e2e.registry import Registry
from sboc_e2e.run.decoders import require_decoder
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.ground_stage import GroundStage, Outside, ground_chain, require_files, star_catalogue
from sboc_e2e.run.manifest import Manifest
from sboc_e2e.run.onboard_stage import OnboardStage, onboard_steps
from sboc_e2e.run.progress import Progress
from sboc_e2e.scenario import Scenario

MODEL_ERROR: Final = 0.2
"""Share of a trail's light by which telescopes on the ground differ from the fit's model: turbulence, tracking, tumbling."""


@dataclass(kw_only=True)
class Seen:
    """What was learned of the frames as they went by."""

    origin: dict[int, tuple[str, int]] = field(default_factory=dict)
    wcs: dict[int, object] = field(default_factory=dict)
    notes: dict[str, list[str]] = field(default_factory=dict)
    """Texts of the notes by kind."""
    of_frame: dict[int, tuple[str, ...]] = field(default_factory=dict)
    """Texts of the notes by frame."""
    circles: dict[int, ImageCircle] = field(default_factory=dict)
    """Image circles of lenses that do not fill their frame, by frame."""


def base_document(wcs: str) -> dict[str, Any]:
    """Scenario tables of frames from outside: no downlink to fit into, and what ``--wcs`` says of attitudes.

    "header" uses the WCS of headers, "solve" solves the attitude from stars, "none" gives pixel positions only.
    Frames without EXPTIME or with one DATE-OBS for all would earn no bytes.
    """
    return {
        "onboard": {
            "downlink": {"budget": "0 Mbit/s"},
            "roi": {"max_per_frame": MOST_DETECTIONS, "max_cosmic_like": MOST_HITS},
            "detector": {"max_detections": MOST_DETECTIONS},
        },
        "ground": {
            "astrometry": {"lost_in_space": "required" if wcs == "solve" else "never"},
            "streak_fitter": {"fading_ends": True},
            "vetter": {"model_error": MODEL_ERROR},
        },
    }


def process(
    source: FrameSource,
    scenario: Scenario,
    out: Path,
    *,
    camera: str | None,
    solve: bool = False,
    folder: Path | None = None,
    first: FirstFrame | None = None,
    force: bool,
    registry: Registry,
    progress: Progress,
) -> None:
    """Products of all frames of a source in a run directory.

    camera : an instrument preset, None to guess one from the first frame. solve : `--wcs solve`; an unknown camera's focal
    length then comes from its stars. folder : where the files lie, for `sboc view`. first : of the source, if begun.
    """
    directory = RunDirectory(path=out)
    require_decoder(scenario)
    if solve:
        lost_in_space.required_solver()
    known = camera_of_preset(camera, registry) if camera else None
    if first is None:
        first = FirstFrame.of(source)
    source = first.source
    # a process is forked before there are threads
    star_sigma_px = first.star_sigma_px() if known is None else lambda: None
    with beside.threaded(worth=first.is_beside) as begin:
        files = begin(_files, scenario)
        manifest = Manifest.of(directory.manifest, scenario)
        catalogue = files()
        if first.is_beside:
            begin(rehearse, scenario, first.frame, catalogue)
        nominal = _fitting(known, first.frame.frame) if known else camera_of_frame(first.frame, star_sigma_px())
        del star_sigma_px  # it holds a copy of the frame
        if solve and known is None:
            nominal = replace(nominal, focal_px=focal_px_by_stars(source, catalogue))
        if solve:
            refuse_narrow_field(nominal)
        # Only now: what is wrong with frames or camera costs no earlier products.
        directory.prepare(resume=False, force=force)
        manifest.n_frames = n_frames = source.n_frames
        if folder is not None:
            manifest.sources["frames"] = str(folder.resolve())
        manifest.save()
        calibration_files.write_camera(
            directory.calibration, nominal, f"preset {camera}" if camera else "guessed from the first frame"
        )
        seen = Seen()
        chain = CountingChain(scenario.onboard, onboard_steps(scenario), camera=nominal, run_id=manifest.run_id)
        board = OnboardStage(run=directory, chain=chain, resumed=False)
        manifest.begin("onboard")
        progress.stage("onboard", n_frames)
        manifest.n_frames = n_frames = board.take(_noted(first.frames(), seen), progress)
        board.join(n_frames, scenario.faults, scenario.seed)
        manifest.finish("onboard", **board.figures())
        directory.clear_work("onboard")
        for texts in seen.notes.values():
            progress.note(f"{len(texts)} of {n_frames} frames: {texts[0]}")
        for text in source.left_out:
            progress.note(f"left out: {text}")
    vetted = ground_chain(
        scenario,
        calibration=None,
        camera=nominal,
        catalogue=catalogue,
        run_id=manifest.run_id,
        evidence={number: replace(each, circle=seen.circles.get(number)) for number, each in chain.evidence.items()},
    )
    counts = {number: counts_of(each.look_alikes) for number, each in chain.evidence.items()}
    ground = GroundStage(
        run=directory,
        chain=vetted,
        options=scenario.ground,
        catalogue=catalogue,
        resumed=False,
        outside=Outside(origin=seen.origin, wcs=seen.wcs, notes=seen.of_frame, left_out=source.left_out, look_alikes=counts),
    )
    manifest.begin("ground")
    ground.execute(progress)
    manifest.finish("ground", **ground.figures())
    directory.clear_work("ground")


def _files(scenario: Scenario) -> StarCatalogue:
    """Open what ground is to read; its catalogue."""
    require_files(scenario)
    return star_catalogue(scenario)


def _noted(frames: Iterator[SourcedFrame], seen: Seen) -> Iterator[Frame]:
    """Frames, while what is known of each is noted."""
    for sourced in frames:
        number = sourced.frame.header.frame
        seen.origin[number] = (sourced.file, sourced.hdu)
        if sourced.wcs is not None:
            seen.wcs[number] = sourced.wcs
        if sourced.circle is not None:
            seen.circles[number] = sourced.circle
        seen.of_frame[number] = tuple(note.text for note in sourced.notes)
        for note in sourced.notes:
            seen.notes.setdefault(note.kind, []).append(note.text)
        yield sourced.frame


def _fitting(camera: NominalCamera, frame: Frame) -> NominalCamera:
    """A preset's camera for a frame of another size: same scale, axis in the middle."""
    header = frame.header
    if (camera.rows, camera.cols) == (header.rows, header.cols):
        return camera
    return replace(
        camera, rows=header.rows, cols=header.cols, center_row=0.5 * (header.rows - 1), center_col=0.5 * (header.cols - 1)
    )
