"""`sboc process`: frames from outside through the on-board and the ground chain; products, and no score without truth."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from ground.astrometry import lost_in_space
from ground.vetting.short_lines import SHORTEST_PX
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files import calibration_files
from sboc_e2e.outside import second_processor
from sboc_e2e.outside.aboard import InTurn, Orders
from sboc_e2e.outside.camera import camera_of_preset, focal_px_by_stars, focal_px_of_frame, refuse_narrow_field
from sboc_e2e.outside.first_frame import FirstFrame
from sboc_e2e.outside.frame_source import FrameSource
from sboc_e2e.outside.limits import MOST_DETECTIONS, MOST_HITS
from sboc_e2e.outside.lone_frame import LoneFrame
from sboc_e2e.outside.look_alikes import counts_of
from sboc_e2e.outside.rehearsal import are_own
from sboc_e2e.registry import Registry
from sboc_e2e.run.decoders import require_decoder
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.manifest import Manifest, run_id
from sboc_e2e.run.onboard_stage import join, onboard_steps
from sboc_e2e.run.progress import Progress
from sboc_e2e.scenario import Scenario

MODEL_ERROR: Final = 0.2
"""Share of a trail's light by which telescopes on the ground differ from the fit's model: turbulence, tracking, tumbling."""


def base_document(wcs: str) -> dict[str, Any]:
    """Scenario tables of frames from outside: no downlink to fit into, and what ``--wcs`` says of attitudes.

    "header" uses the WCS of headers, "solve" solves the attitude from stars, "none" gives pixel positions only.
    Frames without EXPTIME or with one DATE-OBS for all would earn no bytes.
    """
    return {
        "onboard": {
            "downlink": {"budget": "0 Mbit/s"},
            "roi": {"max_per_frame": MOST_DETECTIONS, "max_cosmic_like": MOST_HITS, "follow_light": True},
            "detector": {"max_detections": MOST_DETECTIONS, "held_beside": True, "blend": f"{SHORTEST_PX:g} px"},
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
    begun: LoneFrame | FirstFrame | None = None,
    force: bool,
    registry: Registry,
    progress: Progress,
) -> None:
    """Products of all frames of a source in a run directory.

    camera : an instrument preset, which counts for all frames; None to guess one from the first frame of each camera.
    solve : `--wcs solve`; an unknown camera's focal length then comes from its stars. folder : where the files lie, for
    `sboc view`. begun : of the source, by `lone_frame.begun`.
    """
    directory = RunDirectory(path=out)
    require_decoder(scenario)
    if solve:
        lost_in_space.required_solver()
    known = camera_of_preset(camera, registry) if camera else None
    steps = onboard_steps(scenario)
    half: LoneFrame | InTurn
    if isinstance(begun, LoneFrame) and are_own(vars(steps).values()):
        half = begun
    else:  # somebody else's step works in this process
        half = InTurn(first=begun if isinstance(begun, FirstFrame) else FirstFrame.of(source))
    half.begin(Orders(options=scenario.onboard, steps=steps, run_id=run_id(scenario.document()), known=known, run=directory))
    from sboc_e2e.run.ground_stage import GroundStage, Outside, ground_chain  # while the frame is processed on board

    with second_processor.threaded(worth=half.threaded) as begin:
        files = begin(_files, scenario)
        manifest = Manifest.of(directory.manifest, scenario)
        catalogue = files()
        half.rehearse(begin, scenario, catalogue)
        nominal = half.camera()
        if solve and known is None:
            nominal = replace(nominal, focal_px=focal_px_by_stars(half.source, catalogue))
        if solve:
            refuse_narrow_field(nominal)
        # Only now: what is wrong with frames or camera costs no earlier products.
        directory.prepare(resume=None, force=force)
        manifest.n_frames = half.source.n_frames
        if folder is not None:
            manifest.sources["frames"] = str(folder.resolve())
        manifest.save()
        calibration_files.write_camera(
            directory.calibration, nominal, f"preset {camera}" if camera else "guessed from the first frame"
        )
        manifest.begin("onboard")
        progress.stage("onboard", manifest.n_frames)
        scale = partial(focal_px_of_frame, catalogue=catalogue, otherwise=nominal.focal_px) if solve else None
        flight = half.fly(nominal, progress, scale)
    seen, manifest.n_frames = flight.seen, flight.n_frames
    others = {number: place for number, place in seen.camera_of.items() if place}
    if others:
        calibration_files.write_cameras(directory.calibration, seen.cameras, seen.camera_of)
    join(directory, flight.n_frames, scenario.faults, scenario.seed)
    manifest.finish("onboard", **flight.figures)
    directory.clear_work("onboard")
    for texts in seen.notes.values():
        progress.note(f"{len(texts)} of {flight.n_frames} frames: {texts[0]}")
    for text in flight.left_out:
        progress.note(f"left out: {text}")
    vetted = ground_chain(
        scenario,
        calibration=None,
        camera=nominal,
        cameras={number: seen.cameras[place] for number, place in others.items()},
        catalogue=catalogue,
        run_id=manifest.run_id,
        evidence={number: replace(each, circle=seen.circles.get(number)) for number, each in flight.evidence.items()},
    )
    counts = {number: counts_of(each.look_alikes) for number, each in flight.evidence.items()}
    ground = GroundStage(
        run=directory,
        chain=vetted,
        options=scenario.ground,
        catalogue=catalogue,
        resumed=False,
        outside=Outside(
            origin=seen.origin,
            wcs=seen.wcs,
            notes=seen.of_frame,
            left_out=flight.left_out,
            look_alikes=counts,
            cameras=seen.camera_of,
        ),
    )
    manifest.begin("ground")
    ground.execute(progress)
    manifest.finish("ground", **ground.figures())
    directory.clear_work("ground")


def _files(scenario: Scenario) -> StarCatalogue:
    """Open what ground is to read; its catalogue."""
    from sboc_e2e.run.ground_stage import require_files, star_catalogue

    require_files(scenario)
    return star_catalogue(scenario)
