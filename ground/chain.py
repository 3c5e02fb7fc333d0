"""The order of the ground segment:

frame by frame   packets -> frame -> sky level -> PSF -> camera solution -> zero point -> hidden stars
                 -> streak fits -> vetting -> directions and magnitudes
over the run     rates of turning -> tracklets -> camera shake -> joint refit -> final directions, epochs, magnitudes -> orbits
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.header_wcs import identify_by_header
from ground.calibration import calibration_of
from ground.final_tracklets import LinkedRun, final_tracklet, with_shake
from ground.frame_streaks import LitFrame, fitted, judged_alone, measured
from ground.guard import fault, guarded, links_of, probabilities_of
from ground.ingest import IngestReport, decode_downlink
from ground.on_demand import OnDemand
from ground.options import GroundOptions
from ground.photometry.psf_width import in_frame, with_star_list
from ground.photometry.sky_memory import filtered_sky
from ground.photometry.star_memory import with_hidden_stars
from ground.records import FrameProducts, GroundProducts, GroundState
from ground.sky.pixel_sky import sky_of
from ground.sky.turning import attitude_of
from ground.streak_rows import LinkedStreaks, RunStreaks, StreakRows
from ground.streaks.psf_field import PsfField
from ground.turned_frames import turned_frames
from ground.vetting.pieces import with_joined_pieces
from ground.vetting.repeated import repeated
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader, NominalCamera
from sboc_e2e.icd.products import FrameSolution, OrbitEstimate, PhotometricSolution, StreakFit, StreakMeasurement, Tracklet
from sboc_e2e.icd.steps import Astrometer, Decoder, Linker, OrbitDeterminer, Photometer, StreakFitter, Vetter

FRAMES_REMEMBERED: Final = 64
"""Frames that are kept with their stars while tracklets are refitted."""


@dataclass(frozen=True, kw_only=True)
class GroundSteps:
    """The swappable steps of the chain, configured."""

    decoders: tuple[Decoder, ...]
    streak_fitter: StreakFitter
    vetter: Vetter
    astrometry: Astrometer
    photometry: Photometer
    linker: Linker
    orbit: OrbitDeterminer


class GroundChain:
    """Runs the steps in order. The state between frames is an argument and a result (`GroundState`).

    calibration : None for frames from outside; then dark is 0, the flat 1 and no pixel is defective.
    run_id : the run whose packets are used; None for the run with most packets.
    cameras : by frame number, where frames are not of `camera`; the states of each camera's frames are then to be kept apart.
    """

    def __init__(
        self,
        options: GroundOptions,
        steps: GroundSteps,
        *,
        calibration: Calibration | None,
        camera: NominalCamera,
        catalogue: StarCatalogue,
        run_id: int | None = None,
        cameras: Mapping[int, NominalCamera] | None = None,
    ) -> None:
        self._options = options
        self._steps = steps
        self._calibration = calibration
        self._camera = camera
        self._cameras = cameras or {}
        self._catalogue = catalogue
        self._run_id = run_id

    @property
    def camera(self) -> NominalCamera:
        """The camera as ground believes it to be."""
        return self._camera

    def ingest(self, downlink: bytes) -> tuple[tuple[DownlinkFrame, ...], IngestReport]:
        """Frames rebuilt from all intact packets of the run, by frame number, and what was missing."""
        return decode_downlink(downlink, self._steps.decoders, run_id=self._run_id)

    def initial_state(self, header: FrameHeader | None = None) -> GroundState:
        """State before the first frame; picklable. header : of that frame, where frames are of several cameras."""
        camera = self._camera_of(header)
        step, calibration = self._steps.astrometry, calibration_of(self._calibration, camera, None)
        first = guarded("astrometry", step, "", object, step.initial_state, calibration, self._catalogue)
        return GroundState(astrometry=first, psf=PsfField.nominal(camera.psf_sigma_px, (camera.rows, camera.cols)))

    def process_frame(self, state: GroundState, frame: DownlinkFrame, *, wcs: Any = None) -> tuple[GroundState, FrameProducts]:
        """Camera solution, zero point and measured streaks of one frame; frames come in order.

        wcs : an astropy WCS (ICRS) that came with the frame and is used for directions instead of a solution.
        """
        sky_memory, frame = filtered_sky(state.sky, frame)
        psf = state.psf if state.growth_known else with_star_list(state.psf, frame)
        growth_known = state.growth_known or psf is not state.psf
        psf = in_frame(psf, frame)
        astrometry, solution = self._solved(state.astrometry, frame, wcs)
        photometry = self._zero_point(frame, solution)
        star_memory, frame = with_hidden_stars(state.stars, frame, solution)
        lit = self._lit(frame, solution, photometry, psf)
        fits, flats = fitted(lit, self._steps.streak_fitter)
        fits = with_joined_pieces(fits, frame.psf_sigma_px or self._camera_of(frame.header).psf_sigma_px)
        probabilities = self._probabilities(fits, frame)
        sky = sky_of(frame.header, solution, wcs)
        streaks = [
            measured(number, fit, float(probabilities[number]), lit, sky, flats[number], self._options.veto_below)
            for number, fit in enumerate(fits)
        ]
        likely = [s.fit for s in streaks if not s.flags & StreakFlag.VETOED]
        products = FrameProducts(
            header=frame.header,
            solution=solution,
            photometry=photometry,
            streaks=StreakRows.of(streaks),
            mean_flat=tuple(flats),
            psf=psf,
            background=frame.background,
            wcs=wcs,
            fit_failures=tuple(fit.failure or "no reason given" for fit in fits if fit.flags & StreakFlag.FIT_FAILED),
        )
        state = GroundState(
            astrometry=astrometry, psf=psf.updated(likely), growth_known=growth_known, sky=sky_memory, stars=star_memory
        )
        return state, products

    def finish(
        self, frames: Sequence[DownlinkFrame], products: Sequence[FrameProducts], ingest: IngestReport | None = None
    ) -> GroundProducts:
        """Tracklets, resolved streaks and orbits of a run; `frames` and `products` in the same order.

        Both sequences are read more than once and item by item, and no item is kept for long. They may therefore make their
        items on demand (`ground.on_demand`); the result then does so too.
        """
        small = [(p.header, p.photometry, len(p.streaks), attitude_of(p.header, p.solution), p.fit_failures) for p in products]
        headers, counts = tuple(header for header, *_ in small), [count for _, _, count, *_ in small]
        products, rates = turned_frames(products, [attitude for *_, attitude, _ in small])
        tracklets = list(self._linked(headers, RunStreaks(counts, lambda k: products[k].streaks), counts))
        linked = LinkedStreaks({header.frame: k for k, header in enumerate(headers)}, len(tracklets))
        run = LinkedRun(headers=headers, products=products, rates=rates, linked=linked)
        # by time, so that tracklets of the same frames follow each other
        in_order = sorted(range(len(tracklets)), key=lambda k: int(tracklets[k].frames.min()))
        run = with_shake(run, tracklets, in_order, self._camera.focal_px)
        lit = lru_cache(maxsize=FRAMES_REMEMBERED)(lambda number: self._lit_again(frames, run, linked.place[number]))
        pixels_of = (lambda streak: lit(streak.frame).pixels_of(streak)) if self._options.joint_refit else None
        for number in in_order:
            tracklets[number] = final_tracklet(run, number, tracklets[number], pixels_of)
        final = OnDemand(len(products), lambda k: self._published(products[k].streaks, linked.of_frame(k)))
        failures = Counter(reason for *_, reasons in small for reason in reasons)
        return GroundProducts(
            headers=headers,
            solutions=OnDemand(len(products), lambda k: products[k].solution),
            photometry=tuple(photometry for _, photometry, *_ in small),
            streaks=RunStreaks(counts, final.__getitem__),
            tracklets=tuple(tracklets),
            members=linked.members,
            orbits=self._orbits(tracklets, headers),
            ingest=None if ingest is None else replace(ingest, fit_failures=dict(sorted(failures.items()))),
        )

    def _solved(self, state: Any, frame: DownlinkFrame, wcs: Any) -> tuple[Any, FrameSolution]:
        """Next state of the astrometry and the frame's solution. A WCS that came with the frame replaces both."""
        if wcs is not None:
            return state, identify_by_header(frame, wcs, self._catalogue, self._camera_of(frame.header))
        step, where = self._steps.astrometry, f"frame {frame.header.frame}"
        result = guarded("astrometry", step, where, tuple, step.solve, state, frame)
        if len(result) != 2 or not isinstance(result[1], FrameSolution):
            raise fault("astrometry", step, where, "expected a state and a FrameSolution")
        return result

    def _zero_point(self, frame: DownlinkFrame, solution: FrameSolution) -> PhotometricSolution:
        """Zero point and colour term of a frame."""
        step, calibration = self._steps.photometry, self._calibration_of(frame.header)
        where = f"frame {frame.header.frame}"
        found: PhotometricSolution = guarded(
            "photometry", step, where, PhotometricSolution, step.calibrate, frame, solution, calibration
        )
        return found

    def _probabilities(self, fits: Sequence[StreakFit], frame: DownlinkFrame) -> NDArray[np.float64]:
        """Probability (n,) that each fit of a frame is a real object."""
        step, where = self._steps.vetter, f"frame {frame.header.frame}"
        camera = self._camera_of(frame.header)
        if frame.psf_sigma_px is None and camera.psf_known:
            # its own stars did not tell, and the camera's width is more than a guess
            frame = replace(frame, psf_sigma_px=camera.psf_sigma_px)
        judged = guarded("vetter", step, where, object, step.probability, fits, frame)
        probabilities = probabilities_of(step, where, judged, len(fits))
        return np.where(repeated(fits, probabilities), 0.0, probabilities)

    def _linked(self, headers: Sequence[FrameHeader], streaks: RunStreaks, counts: Sequence[int]) -> tuple[Tracklet, ...]:
        """Tracklets of a run as the linker returns them."""
        step = self._steps.linker
        given = {header.frame: count for header, count in zip(headers, counts, strict=True)}
        return links_of(step, guarded("linker", step, "", object, step.link, headers, streaks), given)

    def _orbits(self, tracklets: Sequence[Tracklet], headers: Sequence[FrameHeader]) -> tuple[OrbitEstimate, ...]:
        """Orbits of the tracklets that have directions."""
        step, orbits = self._steps.orbit, []
        for tracklet in tracklets if self._options.orbits else ():
            if not tracklet.flags & StreakFlag.NO_SKY and tracklet.direction_resolved:
                where = f"tracklet {tracklet.tracklet_id} from frame {int(tracklet.frames.min())}"
                orbits.append(guarded("orbit", step, where, OrbitEstimate, step.estimate, tracklet, headers))
        return tuple(orbits)

    def _published(
        self, streaks: Sequence[StreakMeasurement], members: Mapping[int, StreakMeasurement]
    ) -> Sequence[StreakMeasurement]:
        """All streaks of a frame as published. members : the streaks that belong to tracklets, by their number in the frame."""
        alone = self._options.veto_unlinked_below
        return [members[k] if k in members else judged_alone(streak, alone) for k, streak in enumerate(streaks)]

    def _lit(self, frame: DownlinkFrame, solution: FrameSolution, photometry: PhotometricSolution, psf: PsfField) -> LitFrame:
        """A frame with everything that its pixels are calibrated with."""
        return LitFrame(
            frame=frame,
            solution=solution,
            photometry=photometry,
            psf=psf,
            calibration=self._calibration_of(frame.header),
            catalogue=self._catalogue,
            star_model_error=self._options.streak_photometry.star_model_error,
        )

    def _lit_again(self, frames: Sequence[DownlinkFrame], run: LinkedRun, k: int) -> LitFrame:
        """The same for the k-th frame of a run that was processed."""
        product = run.products[k]
        return self._lit(replace(frames[k], background=product.background), product.solution, product.photometry, product.psf)

    def _calibration_of(self, header: FrameHeader | None) -> Calibration:
        return calibration_of(self._calibration, self._camera_of(header), header)

    def _camera_of(self, header: FrameHeader | None) -> NominalCamera:
        return self._camera if header is None else self._cameras.get(header.frame, self._camera)
