"""The order of the ground segment:

packets -> frames -> camera solution -> zero point -> streak fits -> vetting -> sky and magnitude
        -> tracklets -> directions, epochs, joint refit -> orbits
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry.header_wcs import identify_by_header
from ground.guard import fault, guarded, links_of, probabilities_of
from ground.ingest import IngestReport, decode_downlink
from ground.link import Member, apply_links, measured_tracklet
from ground.link.shake import SeenTrail, Sway, shake_factor, sway_of
from ground.on_demand import OnDemand
from ground.options import GroundOptions
from ground.photometry.known_stars import FrameLight, frame_light
from ground.photometry.magnitude import crossing_time_s, magnitude_at_1deg_s, streak_magnitude
from ground.photometry.psf_width import in_frame, with_star_list
from ground.photometry.sky_memory import filtered_sky
from ground.photometry.star_memory import with_hidden_stars
from ground.photometry.streak_pixels import streak_pixels
from ground.photometry.tracklet_light import with_mean_light
from ground.photometry.zero_point import flat_at
from ground.records import FrameProducts, GroundProducts, GroundState
from ground.refit import SharedErrors, refit_streaks
from ground.sky.bend import bent
from ground.sky.measure import initial_epochs_ns, jacobian_arcsec, middle_of, pointing_sigma_arcsec, with_sky
from ground.sky.pixel_sky import HeaderSky, PixelSky, SolvedSky
from ground.sky.sphere import ARCSEC_RAD
from ground.sky.turning import Attitude, Rate, attitude_of, rates_of
from ground.streak_rows import STREAKS_PER_FRAME, LinkedStreaks, RunStreaks, StreakRows
from ground.streaks.psf_field import PsfField
from ground.vetting.pieces import with_joined_pieces
from ground.vetting.repeated import repeated
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader, NominalCamera
from sboc_e2e.icd.products import (
    FrameSolution,
    OrbitEstimate,
    PhotometricSolution,
    StreakFit,
    StreakMeasurement,
    StreakPixels,
    Tracklet,
)
from sboc_e2e.icd.signals import RoiGroup
from sboc_e2e.icd.steps import Astrometer, Decoder, Linker, OrbitDeterminer, Photometer, StreakFitter, Vetter

FRAMES_REMEMBERED: Final = 64
"""Frames that are kept with their stars while tracklets are refitted."""

FRAMES_TURNED: Final = 16
"""Frames that are kept with the rates of the whole run."""

LEAST_SNR_ALONE: Final = 6.0
"""Noise alone has 46 maxima above it in a frame of 4096 x 4096, 0.1 above 7 (Euler characteristic of the S/N over all segments,
Adler & Taylor 2007): what was detected above 7 and fits below 6 is left to frames that support each other."""


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
    """Runs the steps in order; holds no state of its own besides what it was made with.

    calibration : None for frames from outside; then dark is 0, the flat 1 and no pixel is defective.
    run_id : the run whose packets are used; None for the one with most packets.
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
    ) -> None:
        self._options = options
        self._steps = steps
        self._calibration = calibration
        self._camera = camera
        self._catalogue = catalogue
        self._run_id = run_id

    @property
    def camera(self) -> NominalCamera:
        """The camera as ground believes it to be."""
        return self._camera

    def ingest(self, downlink: bytes) -> tuple[tuple[DownlinkFrame, ...], IngestReport]:
        """Frames rebuilt from all intact packets of the run, by frame number, and what was missing."""
        return decode_downlink(downlink, self._steps.decoders, run_id=self._run_id)

    def initial_state(self) -> GroundState:
        """State before the first frame; picklable."""
        camera = self._camera
        step = self._steps.astrometry
        first = guarded("astrometry", step, "", object, step.initial_state, self._calibration_of(None), self._catalogue)
        return GroundState(
            astrometry=first,
            psf=PsfField.nominal(camera.psf_sigma_px, (camera.rows, camera.cols)),
        )

    def process_frame(self, state: GroundState, frame: DownlinkFrame, *, wcs: Any = None) -> tuple[GroundState, FrameProducts]:
        """Camera solution, zero point and measured streaks of one frame; frames come in order.

        wcs : an astropy WCS (ICRS) that came with the frame and is used for directions instead of a solution.
        """
        calibration = self._calibration_of(frame.header)
        astrometry, psf = state.astrometry, state.psf
        sky_memory, frame = filtered_sky(state.sky, frame)
        if not state.growth_known:
            psf = with_star_list(psf, frame)
        growth_known = state.growth_known or psf is not state.psf
        psf = in_frame(psf, frame)
        if wcs is None:
            astrometry, solution = self._solved(astrometry, frame)
        else:
            solution = identify_by_header(frame, wcs, self._catalogue, self._camera)
        steps, where = self._steps, f"frame {frame.header.frame}"
        calibrate = steps.photometry.calibrate
        photometry = guarded("photometry", steps.photometry, where, PhotometricSolution, calibrate, frame, solution, calibration)
        sky = _sky_of(frame.header, solution, wcs)
        star_memory, frame = with_hidden_stars(state.stars, frame, solution)
        fits, flats = self._fit_streaks(frame, solution, photometry, calibration, psf)
        fits = with_joined_pieces(fits, frame.psf_sigma_px or self._camera.psf_sigma_px)
        judged = guarded("vetter", steps.vetter, where, object, steps.vetter.probability, fits, self._with_known_width(frame))
        probabilities = probabilities_of(steps.vetter, where, judged, len(fits))
        probabilities = np.where(repeated(fits, probabilities), 0.0, probabilities)
        streaks = tuple(
            self._measurement(number, fit, float(probabilities[number]), frame, solution, photometry, sky, flats[number])
            for number, fit in enumerate(fits)
        )
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

        Both are gone through more than once and asked for single items, none of which is kept for long: they may make their
        items on demand (`ground.on_demand`), and then the result does so too.
        """
        small = [(p.header, p.photometry, len(p.streaks), attitude_of(p.header, p.solution), p.fit_failures) for p in products]
        headers, counts = tuple(header for header, *_ in small), [count for _, _, count, *_ in small]
        products, rates = _turning(products, [attitude for *_, attitude, _ in small])
        failures = Counter(reason for *_, reasons in small for reason in reasons)
        linker = self._steps.linker
        measured = RunStreaks(counts, lambda k: products[k].streaks)
        given = {header.frame: count for header, count in zip(headers, counts, strict=True)}
        found = links_of(linker, guarded("linker", linker, "", object, linker.link, headers, measured), given)
        place = {header.frame: k for k, header in enumerate(headers)}
        pixels_of = self._pixel_source(frames, products, place)
        tracklets, linked = list(found), LinkedStreaks(place, len(found))
        # by time, so that tracklets of the same frames follow each other
        in_order = sorted(range(len(found)), key=lambda k: int(found[k].frames.min()))
        factor = shake_factor(self._sway(found[number], linked, headers, products, rates) for number in in_order)
        rates = [rate._replace(sigma_rad_s=factor * rate.sigma_rad_s) for rate in rates]
        for number in in_order:
            tracklets[number], members = self._resolved(found[number], linked, headers, products, rates, pixels_of)
            linked.put(number, members)
        orbits: tuple[OrbitEstimate, ...] = ()
        if self._options.orbits:
            located = [t for t in tracklets if not t.flags & StreakFlag.NO_SKY and t.direction_resolved]
            orbits = tuple(self._orbit_of(tracklet, headers) for tracklet in located)
        final = OnDemand(len(products), lambda k: self._final(products[k].streaks, linked.of_frame(k)))
        return GroundProducts(
            headers=headers,
            solutions=OnDemand(len(products), lambda k: products[k].solution),
            photometry=tuple(photometry for _, photometry, *_ in small),
            streaks=RunStreaks(counts, final.__getitem__),
            tracklets=tuple(tracklets),
            members=linked.members,
            orbits=orbits,
            ingest=None if ingest is None else replace(ingest, fit_failures=dict(sorted(failures.items()))),
        )

    def _resolved(
        self,
        tracklet: Tracklet,
        linked: LinkedStreaks,
        headers: Sequence[FrameHeader],
        products: Sequence[FrameProducts],
        rates: Sequence[Rate],
        pixels_of: Callable[[StreakMeasurement], StreakPixels],
    ) -> tuple[Tracklet, Sequence[StreakMeasurement]]:
        """A tracklet as its members measure it, and these in frame order: directions, epochs, joint refit, brightness."""
        single, own, at = _single(tracklet, linked, headers, products)
        members = single
        shared: SharedErrors = {}
        if self._options.joint_refit:
            members, shared = refit_streaks(
                single,
                tracklet,
                own,
                lambda frame: products[linked.place[frame]].solution,
                pixels_of,
                lambda frame: rates[linked.place[frame]].sigma_rad_s,
            )
        frames = [products[k] for k in at]
        placed = [_placed(member, frame) for member, frame in zip(members, frames, strict=True)]
        measured = measured_tracklet(
            tracklet,
            [
                _member(one, streak, frame, rates[k].sigma_rad_s, shared.get(streak.streak_id))
                for one, streak, frame, k in zip(single, placed, frames, at, strict=True)
            ],
        )
        final = [_finally_bright(streak, frame, measured.rate_deg_s) for streak, frame in zip(placed, frames, strict=True)]
        return with_mean_light(measured, final), final

    def _sway(
        self,
        tracklet: Tracklet,
        linked: LinkedStreaks,
        headers: Sequence[FrameHeader],
        products: Sequence[FrameProducts],
        rates: Sequence[Rate],
    ) -> Sway:
        """What the members of a tracklet, as single frames show them, tell of the camera's shake."""
        members, _, at = _single(tracklet, linked, headers, products)
        return sway_of(
            tracklet,
            [
                SeenTrail(
                    streak=member,
                    scale_arcsec=1.0 / (self._camera.focal_px * ARCSEC_RAD),
                    sigma_rate_arcsec_s=0.0 if products[k].wcs is not None else rates[k].sigma_rad_s / ARCSEC_RAD,
                )
                for member, k in zip(members, at, strict=True)
            ],
        )

    def _final(
        self, streaks: Sequence[StreakMeasurement], members: Mapping[int, StreakMeasurement]
    ) -> Sequence[StreakMeasurement]:
        """All streaks of a frame as published; members : those of tracklets, by number."""
        return [members[k] if k in members else self._judged_alone(streak) for k, streak in enumerate(streaks)]

    def _with_known_width(self, frame: DownlinkFrame) -> DownlinkFrame:
        """The frame with the camera's PSF where its own stars did not tell one and the camera's is more than a guess."""
        if frame.psf_sigma_px is not None or not self._camera.psf_known:
            return frame
        return replace(frame, psf_sigma_px=self._camera.psf_sigma_px)

    def _solved(self, state: Any, frame: DownlinkFrame) -> tuple[Any, FrameSolution]:
        """Next state of the astrometry and the frame's solution."""
        step, where = self._steps.astrometry, f"frame {frame.header.frame}"
        result = guarded("astrometry", step, where, tuple, step.solve, state, frame)
        if len(result) != 2 or not isinstance(result[1], FrameSolution):
            raise fault("astrometry", step, where, "expected a state and a FrameSolution")
        return result

    def _orbit_of(self, tracklet: Tracklet, headers: Sequence[FrameHeader]) -> OrbitEstimate:
        """Orbit of one tracklet."""
        step, where = self._steps.orbit, f"tracklet {tracklet.tracklet_id} from frame {int(tracklet.frames.min())}"
        estimate: OrbitEstimate = guarded("orbit", step, where, OrbitEstimate, step.estimate, tracklet, headers)
        return estimate

    def _judged_alone(self, streak: StreakMeasurement) -> StreakMeasurement:
        """A streak that no other frame supports is published on its own probability, which must be higher."""
        alone_enough = streak.probability >= self._options.veto_unlinked_below and streak.fit.snr >= LEAST_SNR_ALONE
        veto = StreakFlag(0) if alone_enough else StreakFlag.VETOED
        return replace(streak, tracklet_id=-1, flags=streak.flags | StreakFlag.SINGLE_FRAME | veto)

    def _pixel_source(
        self, frames: Sequence[DownlinkFrame], products: Sequence[FrameProducts], place: Mapping[int, int]
    ) -> Callable[[StreakMeasurement], StreakPixels]:
        """Calibrated pixels of single streaks; the last frames asked for are kept with their stars. place : of frame numbers."""

        @lru_cache(maxsize=FRAMES_REMEMBERED)
        def lit(number: int) -> tuple[DownlinkFrame, FrameLight]:
            frame, product = frames[place[number]], products[place[number]]
            light = self._light(frame, product.solution, product.photometry, product.psf)
            return replace(frame, background=product.background), light

        def pixels_of(streak: StreakMeasurement) -> StreakPixels:
            frame, light = lit(streak.frame)
            return self._pixels(frame.rois[streak.streak_id - streak.frame * STREAKS_PER_FRAME], frame, light)[0]

        return pixels_of

    def _light(self, frame: DownlinkFrame, solution: FrameSolution, photometry: PhotometricSolution, psf: PsfField) -> FrameLight:
        return frame_light(frame, solution, photometry, self._calibration_of(frame.header), self._catalogue, psf)

    def _pixels(self, group: RoiGroup, frame: DownlinkFrame, light: FrameLight) -> tuple[StreakPixels, bool]:
        error = self._options.streak_photometry.star_model_error
        return streak_pixels(group, frame, self._calibration_of(frame.header), light, star_model_error=error)

    def _fit_streaks(
        self,
        frame: DownlinkFrame,
        solution: FrameSolution,
        photometry: PhotometricSolution,
        calibration: Calibration,
        psf: PsfField,
    ) -> tuple[list[StreakFit], list[float]]:
        """Fit of each ROI group, with the flags that the pixels and the packets say; and the mean flat under each."""
        if not frame.rois:
            return [], []
        gain_assumed = StreakFlag.GAIN_ASSUMED if frame.header.gain_e_adu is None else StreakFlag(0)
        light = self._light(frame, solution, photometry, psf)
        fits, flats = [], []
        fitter = self._steps.streak_fitter
        for group in frame.rois:
            where = f"frame {frame.header.frame}, region {group.roi_id}"
            pixels, crossed = self._pixels(group, frame, light)
            fit = guarded("streak_fitter", fitter, where, StreakFit, fitter.fit, pixels, group.detection)
            flags = fit.flags | group.detection.flags & _KEPT_FROM_BOARD | gain_assumed
            if crossed:
                flags |= StreakFlag.CROSSES_STAR
            if len(group.strips) < group.n_strips:
                flags |= StreakFlag.PIXELS_MISSING
            fits.append(replace(fit, flags=flags))
            flats.append(_mean_flat(calibration, fit))
        return fits, flats

    def _measurement(
        self,
        number: int,
        fit: StreakFit,
        probability: float,
        frame: DownlinkFrame,
        solution: FrameSolution,
        photometry: PhotometricSolution,
        sky: PixelSky | None,
        mean_flat: float,
    ) -> StreakMeasurement:
        """A streak as it stands before linking."""
        header = frame.header
        row_mid, col_mid = middle_of(fit)
        unknown = np.full(3, np.nan)
        track = frame.rois[number].track
        # a member of a track was judged with the frames around it; if these do not bear it out, it is judged alone
        veto = StreakFlag.VETOED if probability < self._options.veto_below and track < 0 else StreakFlag(0)
        streak = StreakMeasurement(
            frame=header.frame,
            streak_id=header.frame * STREAKS_PER_FRAME + number,
            roi_id=frame.rois[number].roi_id,
            fit=fit,
            row_mid=row_mid,
            col_mid=col_mid,
            ra_deg=unknown,
            dec_deg=unknown,
            t_tai_ns=initial_epochs_ns(fit, row_mid, header),
            sigma_along_arcsec=float("nan"),
            sigma_cross_arcsec=float("nan"),
            mag=float("nan"),
            mag_err=float("nan"),
            probability=probability,
            tracklet_id=-1,
            flags=fit.flags | veto,
            track=track,
        )
        return _with_brightness(with_sky(streak, header, sky, solution.covariance_rad2), header, photometry, mean_flat, None)

    def _calibration_of(self, header: FrameHeader | None) -> Calibration:
        """Calibration of the window that a frame covers, or an ideal one where none was given."""
        if self._calibration is None:
            rows, cols = (self._camera.rows, self._camera.cols) if header is None else (header.rows, header.cols)
            return ideal_calibration(replace(self._camera, rows=rows, cols=cols))
        rows, cols = self._calibration.dark_adu.shape
        if header is None or (header.rows, header.cols) == (rows, cols):
            return self._calibration
        camera, (row0, col0) = self._calibration.camera, header.corner_in((rows, cols))
        window = np.s_[row0 : row0 + header.rows, col0 : col0 + header.cols]
        return Calibration(
            camera=replace(
                camera,
                rows=header.rows,
                cols=header.cols,
                center_row=camera.center_row - row0,
                center_col=camera.center_col - col0,
            ),
            dark_adu=self._calibration.dark_adu[window],
            flat=self._calibration.flat[window],
            defects=self._calibration.defects[window],
            provenance=self._calibration.provenance,
        )


_KEPT_FROM_BOARD: Final = (
    StreakFlag.STATIC
    | StreakFlag.SPIKE_LIKE
    | StreakFlag.ROI_CUT
    | StreakFlag.LOSSY
    | StreakFlag.COSMIC_LIKE
    | StreakFlag.SATURATED
)
"""Flags of the on-board detection that ground cannot find out again."""


def ideal_calibration(camera: NominalCamera) -> Calibration:
    """No dark, a flat of 1, no defects, without holding a frame's worth of memory."""
    shape = (camera.rows, camera.cols)
    return Calibration(
        camera=camera,
        dark_adu=np.broadcast_to(np.float32(0.0), shape),
        flat=np.broadcast_to(np.float32(1.0), shape),
        defects=np.broadcast_to(np.uint8(0), shape),
        provenance="none",
    )


def _sky_of(header: FrameHeader, solution: FrameSolution, wcs: Any) -> PixelSky | None:
    """Directions of a frame's pixels, if any are known."""
    if wcs is not None:
        return HeaderSky(header=header, wcs=wcs)
    if solution.flags & FrameFlag.NO_SOLUTION:
        return None
    return SolvedSky(header=header, solution=solution)


def _mean_flat(calibration: Calibration, fit: StreakFit) -> float:
    """Mean response along the trail, relative to the axis."""
    share = np.linspace(0.02, 0.98, 25)
    row, col = fit.row0 + share * (fit.row1 - fit.row0), fit.col0 + share * (fit.col1 - fit.col0)
    return float(np.mean(flat_at(calibration, row, col)))


def _with_brightness(
    streak: StreakMeasurement, header: FrameHeader, photometry: PhotometricSolution, mean_flat: float, crossing_s: float | None
) -> StreakMeasurement:
    """The streak with its magnitude, NaN and NO_MAGNITUDE where there is none."""
    mag, mag_err = streak_magnitude(streak, header, photometry, mean_flat, crossing_s)
    flags = streak.flags & ~StreakFlag.NO_MAGNITUDE
    if not np.isfinite(mag):
        flags |= StreakFlag.NO_MAGNITUDE
    at_rate, at_rate_err = magnitude_at_1deg_s(streak, header, photometry, mean_flat)
    return replace(streak, mag=mag, mag_err=mag_err, mag_at_1deg_s=at_rate, mag_at_1deg_s_err=at_rate_err, flags=flags)


def _single(
    tracklet: Tracklet, linked: LinkedStreaks, headers: Sequence[FrameHeader], products: Sequence[FrameProducts]
) -> tuple[tuple[StreakMeasurement, ...], list[FrameHeader], list[int]]:
    """Members of a tracklet as their frames show them alone, in time order and dated; headers, and places of their frames."""
    places = linked.places_of(tracklet)
    own = [headers[k] for k in dict.fromkeys(place for place, _ in places)]
    members = apply_links([products[k].streaks[number] for k, number in places], (tracklet,), own)
    at = [linked.place[member.frame] for member in members]
    return tuple(_bent(member, products[k]) for member, k in zip(members, at, strict=True)), own, at


def _bent(streak: StreakMeasurement, product: FrameProducts) -> StreakMeasurement:
    """A member of a tracklet with its ends on the arc that the camera's turning makes of a straight motion."""
    if product.wcs is not None or product.solution.flags & FrameFlag.NO_SOLUTION:
        return streak
    return _placed(bent(streak, product.header, product.solution), product)


def _placed(streak: StreakMeasurement, product: FrameProducts) -> StreakMeasurement:
    """A member of a tracklet with directions at its final epochs."""
    sky = _sky_of(product.header, product.solution, product.wcs)
    return with_sky(streak, product.header, sky, product.solution.covariance_rad2)


def _turning(products: Sequence[FrameProducts], attitudes: Sequence[Attitude]) -> tuple[Sequence[FrameProducts], Sequence[Rate]]:
    """The frames with the rates that the attitudes of the whole run give, in their solutions and streaks; and these rates."""
    order = sorted(range(len(attitudes)), key=lambda k: attitudes[k].tai_ns)
    in_order = dict(zip(order, rates_of([attitudes[k] for k in order]), strict=True))
    rates = [in_order[k] for k in range(len(attitudes))]

    def turned(k: int) -> FrameProducts:
        product, rate = products[k], rates[k].rate_rad_s
        if product.wcs is not None or not attitudes[k].solved:
            return product
        solution = replace(product.solution, rate_rad_s=rate)
        turn_rad_s = SolvedSky(header=product.header, solution=solution).turn_rad_s
        return replace(product, solution=solution, streaks=[replace(s, turn_rad_s=turn_rad_s) for s in product.streaks])

    return OnDemand(len(products), turned, keep=FRAMES_TURNED), rates


def _member(
    single: StreakMeasurement,
    final: StreakMeasurement,
    product: FrameProducts,
    sigma_rate_rad_s: float,
    shared: tuple[int, NDArray[np.float64]] | None,
) -> Member:
    """What a tracklet is measured on of one member."""
    sky = _sky_of(product.header, product.solution, product.wcs)
    group, errors = (-1, np.zeros((2, 3))) if shared is None else shared
    return Member(
        single=single,
        final=final,
        jacobian_arcsec=jacobian_arcsec(final, product.header, sky),
        pointing_arcsec=pointing_sigma_arcsec(product.solution.covariance_rad2),
        sigma_rate_arcsec_s=0.0 if product.wcs is not None else sigma_rate_rad_s / ARCSEC_RAD,
        group=group,
        shared_arcsec=errors,
    )


def _finally_bright(streak: StreakMeasurement, product: FrameProducts, rate_deg_s: float) -> StreakMeasurement:
    """A member of a tracklet with a magnitude for its final exposed time."""
    number = streak.streak_id - streak.frame * STREAKS_PER_FRAME
    crossing_s = crossing_time_s(streak, rate_deg_s)
    return _with_brightness(streak, product.header, product.photometry, product.mean_flat[number], crossing_s)
