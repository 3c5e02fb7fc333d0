"""From a linked tracklet to the published one: joint refit, directions and epochs of its members, brightness."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.frame_streaks import with_final_brightness
from ground.link import Member, apply_links, measured_tracklet
from ground.link.common_line import CommonLine, PlacedTrail, on_common_line
from ground.link.foretold import with_track_errors
from ground.link.measured import turning_arcsec
from ground.link.shake import SeenTrail, Sway, shake_factor, sway_of
from ground.photometry.magnitude import crossing_time_s
from ground.photometry.tracklet_light import HALF_POINT_SNR, with_mean_light
from ground.photometry.usual_light import with_errors_of_usual_light
from ground.records import FrameProducts
from ground.refit import CutErrors, SharedErrors, refit_streaks
from ground.sky.bend import bent
from ground.sky.measure import jacobian_arcsec, pointing_sigma_arcsec, with_sky
from ground.sky.pixel_sky import sky_of
from ground.sky.shake_model import STEADY, EndShake, end_shake
from ground.sky.sphere import ARCSEC_RAD
from ground.sky.turning import Rate
from ground.streak_rows import LinkedStreaks
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, StreakPixels, Tracklet

FAINT_SHARE: Final = 0.05
"""Share of a run's trails that are below the half point of its detector because noise or a rolling threshold let them through."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkedRun:
    """Frames of a run in order of time, with the rates at which the camera turned, and where the streaks of tracklets belong.

    end_shake : expected errors of the attitude at shutter open and close, from errors of the rates. half_point_snr : S/N at which
    half of the trails are found, no higher than that of the faintest `FAINT_SHARE` of members: joint tracks go deeper.
    """

    headers: Sequence[FrameHeader]
    products: Sequence[FrameProducts]
    rates: Sequence[Rate]
    linked: LinkedStreaks
    end_shake: EndShake = STEADY
    half_point_snr: float = HALF_POINT_SNR

    def single(self, tracklet: Tracklet) -> list[StreakMeasurement]:
        """Members of a tracklet from their single-frame fits, in time order and dated."""
        places = self.linked.places_of(tracklet)
        own = [self.headers[k] for k in dict.fromkeys(place for place, _ in places)]
        members = apply_links([self.products[k].streaks[number] for k, number in places], (tracklet,), own)
        return [_bent(member, self.products[self.linked.place[member.frame]]) for member in members]

    def sigma_rate_arcsec_s(self, k: int) -> float:
        """Error of the camera's rate in a frame; 0 for a frame with a WCS of its own."""
        return 0.0 if self.products[k].wcs is not None else self.rates[k].sigma_rad_s / ARCSEC_RAD


def with_shake(run: LinkedRun, tracklets: Sequence[Tracklet], order: Sequence[int], focal_px: float) -> LinkedRun:
    """The run with the single-frame members of its tracklets, with errors of the rates and a half point estimated from them.

    order : numbers of the tracklets by time, so that those of the same frames follow each other.
    """
    sways, snr = [], list[float]()
    for number in order:
        members = run.single(tracklets[number])
        run.linked.put(number, members)
        snr += [member.fit.snr for member in members if not member.fit.is_foretold]
        sways.append(_sway(run, tracklets[number], members, 1.0 / (focal_px * ARCSEC_RAD)))
    factor = shake_factor(sways)
    rates = [rate._replace(sigma_rad_s=factor * rate.sigma_rad_s) for rate in run.rates]
    shake = end_shake(factor, *_exposure_and_step_s(run.headers))
    half_point = min(run.half_point_snr, float(np.quantile(snr, FAINT_SHARE))) if snr else run.half_point_snr
    return replace(run, rates=rates, end_shake=shake, half_point_snr=half_point)


def final_tracklet(
    run: LinkedRun, number: int, tracklet: Tracklet, pixels_of: Callable[[StreakMeasurement], StreakPixels] | None
) -> Tracklet:
    """The published tracklet, measured on its final members, which replace the stored ones. pixels_of : None for no joint
    refit."""
    single = tuple(run.linked.of_tracklet(number))
    at = [run.linked.place[member.frame] for member in single]
    own = [run.headers[k] for k in dict.fromkeys(at)]
    members: Sequence[StreakMeasurement] = single
    shared: SharedErrors = {}
    cut: CutErrors = {}
    if pixels_of is not None:
        place: Mapping[int, int] = run.linked.place
        members, shared, cut = refit_streaks(
            single,
            tracklet,
            own,
            lambda frame: run.products[place[frame]].solution,
            pixels_of,
            lambda frame: run.sigma_rate_arcsec_s(place[frame]) * ARCSEC_RAD,
            run.end_shake,
        )
    frames = [run.products[k] for k in at]
    _, frame_s = _exposure_and_step_s(run.headers)
    # errors are shared by number: windows of a track have numbers of their own beside the motions of a joint fit
    first = 1 + max((group for group, _ in shared.values()), default=-1)
    members, foretold = with_track_errors(members, {header.frame: header for header in own}, frame_s, first)
    placed = [_placed(member, frame, cut.get(member.streak_id)) for member, frame in zip(members, frames, strict=True)]
    shared |= {
        streak.streak_id: _in_arcsec(foretold[streak.streak_id], streak, frame)
        for streak, frame in zip(placed, frames, strict=True)
        if streak.streak_id in foretold
    }
    parts = [
        _member(one, streak, frame, run.sigma_rate_arcsec_s(k), run.end_shake, shared.get(streak.streak_id))
        for one, streak, frame, k in zip(single, placed, frames, at, strict=True)
    ]
    line = _common_line(placed, parts, frames, pixels_of)
    moved = {k: _placed(streak, frames[k], cut.get(streak.streak_id)) for k, streak in line.members.items()}
    measured = measured_tracklet(
        tracklet,
        [_member_on_line(p, moved[k], frames[k], line.shared_arcsec[k]) if k in moved else p for k, p in enumerate(parts)],
    )
    final = [
        with_final_brightness(streak, frame, crossing_time_s(streak, measured.rate_deg_s))
        for streak, frame in zip([moved.get(k, streak) for k, streak in enumerate(placed)], frames, strict=True)
    ]
    # the mean light takes fluxes with the errors of their own noise
    run.linked.put(number, with_errors_of_usual_light(final))
    return with_mean_light(measured, final, run.half_point_snr)


def _common_line(
    placed: Sequence[StreakMeasurement],
    parts: Sequence[Member],
    frames: Sequence[FrameProducts],
    pixels_of: Callable[[StreakMeasurement], StreakPixels] | None,
) -> CommonLine:
    """The members of on-board tracks on the line of all."""
    tracked = pixels_of is not None and any(streak.track >= 0 for streak in placed)
    trails = [
        PlacedTrail(
            streak=streak,
            jacobian_arcsec=part.jacobian_arcsec,
            pointing_arcsec=part.pointing_arcsec,
            turning_arcsec=turning_arcsec(streak, part.sigma_rate_arcsec_s, 2),
            pixels=pixels_of(streak) if pixels_of is not None and tracked else None,
        )
        for streak, part in zip(placed, parts, strict=True)
    ]
    return on_common_line(trails, frames[len(frames) // 2].header.observer)


def _member_on_line(part: Member, moved: StreakMeasurement, product: FrameProducts, shared_arcsec: NDArray[np.float64]) -> Member:
    """The part of a member that was moved onto a line. Its errors along stay those of the fit before."""
    final = replace(moved, flags=moved.flags & ~StreakFlag.REFIT | part.final.flags & StreakFlag.REFIT)
    sky = sky_of(product.header, product.solution, product.wcs)
    jacobian = jacobian_arcsec(final, sky)
    return replace(part, final=final, jacobian_arcsec=jacobian, shared_cross_arcsec=shared_arcsec)


def _in_arcsec(
    errors: tuple[int, NDArray[np.float64]], streak: StreakMeasurement, product: FrameProducts
) -> tuple[int, NDArray[np.float64]]:
    """A window's number and its shared errors on the sky, from those in px, which are alike along any axis."""
    sky = sky_of(product.header, product.solution, product.wcs)
    scale = np.sqrt(abs(float(np.linalg.det(jacobian_arcsec(streak, sky)[1]))))
    return errors[0], scale * errors[1]


def _exposure_and_step_s(headers: Sequence[FrameHeader]) -> tuple[float, float]:
    """Median exposure and frame step of the run, seconds. The step is 0 for fewer than two frames."""
    start_ns = np.sort(np.array([h.t_start_tai_ns for h in headers], dtype=np.int64))
    step_s = float(np.median(np.diff(start_ns))) * 1e-9 if len(start_ns) > 1 else 0.0
    return float(np.median([h.exposure_ns for h in headers])) * 1e-9 if headers else 0.0, step_s


def _sway(run: LinkedRun, tracklet: Tracklet, members: Sequence[StreakMeasurement], scale_arcsec: float) -> Sway:
    """Evidence of the camera's shake in the single-frame members of a tracklet."""
    sigma = [run.sigma_rate_arcsec_s(run.linked.place[member.frame]) for member in members]
    trails = [
        SeenTrail(streak=member, scale_arcsec=scale_arcsec, sigma_rate_arcsec_s=s)
        for member, s in zip(members, sigma, strict=True)
    ]
    return sway_of(tracklet, trails)


def _bent(streak: StreakMeasurement, product: FrameProducts) -> StreakMeasurement:
    """A member of a tracklet with its ends on the arc that the camera's turning makes of a straight motion."""
    if product.wcs is not None or product.solution.flags & FrameFlag.NO_SOLUTION:
        return streak
    return _placed(bent(streak, product.header, product.solution), product)


def _placed(streak: StreakMeasurement, product: FrameProducts, cut_arcsec: float | None = None) -> StreakMeasurement:
    """A member of a tracklet with directions at its final epochs. cut_arcsec : error along of the middle of a refitted trail that
    the frame's edge cuts."""
    sky = sky_of(product.header, product.solution, product.wcs)
    placed = with_sky(streak, product.header, sky, product.solution.covariance_rad2)
    if cut_arcsec is None:
        return placed
    return replace(
        placed, sigma_along_arcsec=float(np.hypot(cut_arcsec, pointing_sigma_arcsec(product.solution.covariance_rad2)))
    )


def _member(
    single: StreakMeasurement,
    final: StreakMeasurement,
    product: FrameProducts,
    sigma_rate_arcsec_s: float,
    shake: EndShake,
    shared: tuple[int, NDArray[np.float64]] | None,
) -> Member:
    """The part of a member that its tracklet is measured on."""
    sky = sky_of(product.header, product.solution, product.wcs)
    group, errors = (-1, np.zeros((2, 3))) if shared is None else shared
    return Member(
        single=single,
        final=final,
        jacobian_arcsec=jacobian_arcsec(final, sky),
        pointing_arcsec=pointing_sigma_arcsec(product.solution.covariance_rad2),
        sigma_rate_arcsec_s=sigma_rate_arcsec_s,
        end_shake=shake,
        group=group,
        shared_arcsec=errors,
    )
