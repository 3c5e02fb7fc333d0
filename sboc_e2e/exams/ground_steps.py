"""The exams of a vetter, a photometer and an orbit determiner: each is called on a synthetic trial, and its answer judged by the
contract. How near it is to the truth is the text of a verdict.
"""

import dataclasses
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from ground.astrometry.astrometer import CameraFit
from ground.guard import probabilities_of
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.exams.astrometry import ZERO_POINT_E_S, star_frame
from sboc_e2e.exams.linker import LINE_TIME_NS, START_TAI_NS, linker_trial
from sboc_e2e.exams.verdict import Verdict, asked, expect
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.products import OrbitEstimate, PhotometricSolution, Tracklet

FITS: Final = 8  # Streaks that a vetter judges: a shape that is neither that of the frame nor 0 or 1. Chosen.
ZERO_POINT_OFF_MAG: Final = 0.05
"""Largest error of a zero point of noiseless stars without a colour term. Chosen: more than the 0.02 mag by which magnitudes of
catalogues are trusted; a mistaken exposure or flat is off by far more."""
MU_KM3_S2: Final = 398600.4418
"""Gravitational parameter of the Earth (km^3/s^2, IERS 2010)."""
OBSERVER_KM: Final = 7000.0  # Radius of the camera's circular orbit: a low one, as those of the shipped scenarios.
OBJECT_KM: Final = 7300.0  # Radius of the object's: 300 km above the camera, where most debris is.
APART_RAD: Final = 0.06  # Angle between both, seen from the Earth's middle: with the radii a range of 523 km at first.
EPOCHS_S: Final = (0.0, 0.2, 0.5, 0.7, 1.0, 1.2)  # Both ends of three trails of 0.2 s.
SIGMA_ARCSEC: Final = 2.0  # Error of a direction: that of the trial of linkers, rounded.
DENSITY_OFF: Final = 0.05
"""Largest error of the integral of a range's density: room for coarse grids, and far from that of a density per other unit."""


def vetter_questions(step: Any) -> Iterator[Verdict]:
    """Questions to a vetter."""
    _, frame = star_frame(StarCatalogue.embedded())
    fits = tuple(s.fit for s in linker_trial(turn_rad_s=0.0, exposure_s=0.2).streaks[:FITS])

    def judged(n: int) -> Any:
        return probabilities_of(step, "", step.probability(fits[:n], frame), n)

    yield asked("gives a probability from 0 to 1 for each fit", lambda: " ".join(f"{p:.2f}" for p in judged(FITS)))
    yield asked("survives a frame without a fit", lambda: judged(0))
    yield asked("gives the same twice", lambda: expect(np.array_equal(judged(FITS), judged(FITS)), "two calls differ"))


def photometer_questions(step: Any) -> Iterator[Verdict]:
    """Questions to a photometer, on stars of a known zero point and no colour term."""
    catalogue = StarCatalogue.embedded()
    calibration, frame = star_frame(catalogue)
    solver = CameraFit()
    _, solution = solver.solve(solver.initial_state(calibration, catalogue), frame)
    none = {name: getattr(solution, name)[:0] for name in ("star_index", "star_v_mag", "star_b_v", "star_residual_px")}
    truth_mag = 2.5 * float(np.log10(ZERO_POINT_E_S))

    def calibrated(**changed: Any) -> PhotometricSolution:
        found = step.calibrate(frame, dataclasses.replace(solution, **changed), calibration)
        expect(isinstance(found, PhotometricSolution), f"returned a {type(found).__name__}, expected a PhotometricSolution")
        expect(found.frame == frame.header.frame, f"is of frame {found.frame}, expected {frame.header.frame}")
        expect(np.shape(found.field_mag) == (5,), f"field_mag: expected five coefficients, got {found.field_mag!r}")
        return found

    def zero_point() -> str:
        found = calibrated()
        off = found.zero_point_mag - truth_mag
        expect(abs(off) <= ZERO_POINT_OFF_MAG, f"is off by {off:+.3f} mag, allowed are {ZERO_POINT_OFF_MAG:g}")
        expect(found.zero_point_err_mag > 0.0, f"zero_point_err_mag: expected more than 0, got {found.zero_point_err_mag}")
        return f"off by {off:+.4f} mag, said to be known to {found.zero_point_err_mag:.4f}, {found.n_stars} stars"

    def without_stars() -> None:
        found = calibrated(**none, n_stars=0)
        err = found.zero_point_err_mag
        expect(not np.isfinite(err), f"zero_point_err_mag: expected NaN without a star, got {err}")

    def same_twice() -> None:
        expect(checkpoint.to_bytes(calibrated()) == checkpoint.to_bytes(calibrated()), "two calls gave different results")

    yield asked("finds the zero point of stars", zero_point)
    yield asked("says so where no star is identified", without_stars)
    yield asked("gives the same twice", same_twice)


def orbit_questions(step: Any) -> Iterator[Verdict]:
    """Questions to an orbit determiner, on an arc of a second of an object in a circular low orbit."""
    tracklet, headers, range_km = orbit_trial()
    one = _arc(np.array(tracklet.t_tai_ns[:1]), tracklet.ra_deg[:1], tracklet.dec_deg[:1])

    def found() -> str:
        estimate = _sound(step.estimate(tracklet, headers), tracklet)
        if not estimate.converged:
            return f"estimates nothing: {estimate.lacks}"
        low, middle, high = estimate.range_km
        return f"range {middle:.0f} km, 90 % from {low:.0f} to {high:.0f}, true {range_km:.0f}"

    def says_nothing() -> None:
        estimate = _sound(step.estimate(one, headers), one)
        expect(not estimate.converged, "converged on one direction, which no orbit follows from")

    def same_twice() -> None:
        once, again = (checkpoint.to_bytes(step.estimate(tracklet, headers)) for _ in range(2))
        expect(once == again, "two calls gave different results")

    yield asked("gives intervals of range and orbit", found)
    yield asked("says so where the arc tells nothing", says_nothing)
    yield asked("survives a run without observer states", lambda: _sound(step.estimate(tracklet, ()), tracklet))
    yield asked("gives the same twice", same_twice)


def orbit_trial() -> tuple[Tracklet, tuple[FrameHeader, ...], float]:
    """A tracklet, headers with the observer's states, and the range (km) at the middle of the arc. Both orbits are circles."""
    up, ahead, aside = np.eye(3)
    t_s = np.array(EPOCHS_S)

    def orbit(radius_km: float, start: np.ndarray, way: np.ndarray, at_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rate = np.sqrt(MU_KM3_S2 / radius_km**3)
        c, s = np.cos(rate * at_s)[:, None], np.sin(rate * at_s)[:, None]
        return radius_km * (c * start + s * way), radius_km * rate * (c * way - s * start)

    start = np.cos(APART_RAD) * up + np.sin(APART_RAD) * ahead
    along = np.cos(APART_RAD) * ahead - np.sin(APART_RAD) * up
    way = np.cos(0.7) * along + np.sin(0.7) * aside
    line = orbit(OBJECT_KM, start, way, t_s)[0] - orbit(OBSERVER_KM, up, ahead, t_s)[0]
    ra_deg = np.degrees(np.arctan2(line[:, 1], line[:, 0])) % 360.0
    dec_deg = np.degrees(np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1])))
    headers = []
    for frame, at_s in enumerate(t_s[::2]):
        place_km, speed_km_s = orbit(OBSERVER_KM, up, ahead, np.array([at_s]))
        t_ns = START_TAI_NS + round(at_s * 1e9)
        state = ObserverState(
            tai_ns=t_ns, position_m=1e3 * place_km[0], velocity_m_s=1e3 * speed_km_s[0], sigma_position_m=10.0,
            sigma_velocity_m_s=0.1,
        )  # fmt: skip
        headers.append(
            FrameHeader(
                frame=frame, t_start_tai_ns=t_ns, exposure_ns=200_000_000, line_time_ns=LINE_TIME_NS, rows=2048, cols=2048,
                observer=state,
            )
        )  # fmt: skip
    tracklet = _arc(START_TAI_NS + np.rint(t_s * 1e9).astype(np.int64), ra_deg, dec_deg)
    return tracklet, tuple(headers), float(np.linalg.norm(line, axis=1).mean())


def _arc(t_tai_ns: np.ndarray, ra_deg: np.ndarray, dec_deg: np.ndarray) -> Tracklet:
    """A tracklet of directions without errors, two of each frame."""
    n = len(t_tai_ns)
    seconds = max(1e-9 * float(t_tai_ns[-1] - t_tai_ns[0]), 1e-9)
    north, east = dec_deg[-1] - dec_deg[0], (ra_deg[-1] - ra_deg[0]) * np.cos(np.radians(dec_deg[0]))
    frames = np.unique(np.arange(n) // 2)
    sigma = np.full(n, SIGMA_ARCSEC)
    return Tracklet(
        tracklet_id=3, streak_ids=frames * 65536, frames=frames, t_tai_ns=t_tai_ns, ra_deg=ra_deg, dec_deg=dec_deg,
        sigma_along_arcsec=sigma, sigma_cross_arcsec=sigma, t_ref_tai_ns=int(t_tai_ns[n // 2]), ra_ref_deg=float(ra_deg[n // 2]),
        dec_ref_deg=float(dec_deg[n // 2]), rate_deg_s=float(np.hypot(north, east)) / seconds, rate_err_deg_s=1e-3,
        position_angle_deg=float(np.degrees(np.arctan2(east, north))) % 360.0, mag=10.0, mag_err=0.1, chi2_nu=1.0,
        probability=0.99, direction_resolved=n > 1, flags=StreakFlag(0), row_streak_ids=(np.arange(n) // 2) * 65536,
        row_points=2 * (np.arange(n) % 2), correlation=np.zeros(n),
        motion_angle_deg=np.full(n, float(np.degrees(np.arctan2(east, north))) % 360.0), half68_along_arcsec=sigma,
        shared_arcsec=np.zeros((n, 3)), shared_group=np.full(n, -1), pointing_arcsec=np.zeros(n),
    )  # fmt: skip


def _sound(found: Any, tracklet: Tracklet) -> OrbitEstimate:
    """An estimate that keeps its contract."""
    expect(isinstance(found, OrbitEstimate), f"returned a {type(found).__name__}, expected an OrbitEstimate")
    expect(found.tracklet_id == tracklet.tracklet_id, f"is of tracklet {found.tracklet_id}, expected {tracklet.tracklet_id}")
    for name in ("range_km", "altitude_km", "a_km", "e", "i_deg", "size_m"):
        value = np.asarray(getattr(found, name))
        expect(value.shape == (3,), f"{name}: expected (5 %, median, 95 %), got shape {value.shape}")
        if found.converged and (np.isfinite(value).all() or name != "size_m"):
            expect(bool((np.diff(value) >= 0.0).all()), f"{name}: expected rising numbers, got {value}")
    if not found.converged:
        expect(bool(found.lacks), "lacks: expected why nothing was estimated, got an empty text")
        return found
    modes, grid, density = (np.asarray(values) for values in (found.modes, found.range_grid_km, found.range_posterior))
    expect(modes.ndim == 2 and modes.shape[1] == 5, f"modes: expected (k, 5), got shape {modes.shape}")
    expect(grid.ndim == 1 and grid.shape == density.shape, f"range_posterior: expected {grid.shape}, got {density.shape}")
    expect(
        bool((np.diff(grid) > 0.0).all() and (density >= 0.0).all()), "expected a rising range_grid_km, densities of 0 or more"
    )
    whole = float(np.trapezoid(density, grid))
    expect(abs(whole - 1.0) <= DENSITY_OFF, f"range_posterior: expected an integral of 1 over range_grid_km, got {whole:.3g}")
    return found
