"""`ground.astrometry: camera_fit`: match the star list, fit the camera, learn its distortion over the run."""

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.astrometry import lost_in_space
from ground.astrometry.camera import SHARED, Camera
from ground.astrometry.camera_drift import FrameEvidence, SharedKnowledge
from ground.astrometry.camera_fit import CameraSolution, fit_camera
from ground.astrometry.matching import mutual_pairs, vote_offset
from ground.astrometry.star_turnover import focal_correlation
from ground.sky.apparent import apparent_directions, jyear_of, mid_frame_tai_ns, observer_at
from ground.sky.rotation import matrix_of, quaternion_of, rotation_by
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue, Stars
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StarFlag
from sboc_e2e.icd.frame import Calibration, FrameHeader, NominalCamera
from sboc_e2e.icd.products import FrameSolution

Array = NDArray[np.float64]
Match = tuple[CameraSolution, Stars, NDArray[np.intp], NDArray[np.intp]]
"""Fit, catalogue stars, and the matched indices into the star list and the catalogue."""

LOST_FRAMES_TRIED: Final = 5
"""Number of consecutive frames without a fitting star pattern after which the search stops."""

SAME_FIELD: Final = 0.02
"""Frames that are this share of the field apart or less show the same stars. Otherwise jitter of a pixel
in each of 600 frames would count as a move by a seventh of the field, and catalogue errors would seem to average out."""

UNUSABLE_LISTED: Final = int(StarFlag.SATURATED | StarFlag.EDGE | StarFlag.DEFECT | StarFlag.COSMIC_LIKE)
UNUSABLE_CATALOGUE: Final = int(CatalogueFlag.NO_PROPER_MOTION | CatalogueFlag.DOUBLE | CatalogueFlag.SYNTHETIC)


@dataclass(frozen=True, kw_only=True, eq=False)
class AstrometryState:
    """State before a frame: camera, knowledge of its shared parameters, last attitude."""

    catalogue: StarCatalogue
    camera: Camera
    shared: SharedKnowledge
    psf_sigma_px: float
    last: tuple[int, Array, Array] | None = None
    """Epoch (TAI ns), matrix and rate (rad/s) of the last solved frame."""
    seen_from: Array | None = None
    """Matrix of the frame since which the stars count as the same. Jitter of the pointing shows no new stars."""
    lost: int = 0
    """Number of consecutive frames whose star patterns did not fit. Frames without enough stars do not count."""

    def at(self, tai_ns: int) -> "AstrometryState":
        """The state with its knowledge of the camera propagated to a later epoch."""
        return self if self.last is None else replace(self, shared=self.shared.after(1e-9 * (tai_ns - self.last[0])))


SEARCH_ROLL_DEG: Final = 0.7
"""Error of the telemetered roll that is searched."""

MAX_STARS: Final = 600
"""List stars used, brightest first."""

MIN_STARS: Final = 8
"""Fewest matched stars that make a solution."""

PRIOR_FOCAL_PPM: Final = 1000.0
"""Error of the nominal focal length."""

PRIOR_DISTORTION_PX: Final = 5.0
"""Error of each nominal distortion term at the corner."""


@dataclass(frozen=True, kw_only=True)
class CameraFit:
    """Attitude for each frame, focal length and distortion shared over the run by an information filter."""

    search_radius_arcsec: float = field(
        default=400.0, metadata={"doc": "error of the telemetered pointing that is searched first", "min": 1.0, "max": 20000.0}
    )
    wide_search_arcsec: float = field(
        default=2500.0, metadata={"doc": "searched when the first radius gives nothing", "min": 1.0, "max": 40000.0}
    )
    v_max: float = field(default=99.0, metadata={"doc": "faintest reference stars", "min": 0.0, "max": 99.0})
    centroid_floor_px: float = field(
        default=0.01, metadata={"doc": "centroid error of the brightest stars", "min": 0.0, "max": 10.0}
    )
    lost_in_space: str = field(
        default="if_installed",
        metadata={
            "doc": "whether star patterns (extra `solve`) give the attitude where telemetry is absent or wrong by degrees",
            "choices": ("if_installed", "required", "never"),
        },
    )
    pattern_folder: str = field(
        default="", metadata={"doc": "folder that keeps the pattern database from run to run; empty: made anew in memory"}
    )
    focal_drift_ppm_s: float = field(
        default=0.1,
        metadata={
            "doc": "rate at which the focal length may drift: an aluminium tube (23 ppm/K) that warms by 0.26 K/min. Whether it "
            "drifts at all, and how fast, frames tell; 0: the camera is known to stay as it is",
            "min": 0.0,
            "max": 100.0,
        },
    )

    def initial_state(self, calibration: Calibration, catalogue: Any) -> AstrometryState:
        """The nominal camera with the prior that the options state."""
        camera = Camera.nominal(calibration.camera)
        return AstrometryState(
            catalogue=catalogue,
            camera=camera,
            shared=SharedKnowledge.prior(camera.shared(), self._prior_sigma(calibration.camera), 1e-6 * self.focal_drift_ppm_s),
            psf_sigma_px=calibration.camera.psf_sigma_px,
        )

    def solve(self, state: AstrometryState, frame: DownlinkFrame) -> tuple[AstrometryState, FrameSolution]:
        """The solution of a frame; NO_SOLUTION with a telemetered or unit attitude when there is none."""
        header = frame.header
        middle = mid_frame_tai_ns(header)
        start = _start_attitude(state, header, middle)
        matrix, rate = start if start is not None else (None, np.zeros(3))
        flags, lost = FrameFlag(0), state.lost
        known, state = state, state.at(middle)
        found = None if matrix is None else self._match_and_fit(state, frame, matrix, rate, middle)
        if found is None:
            flags = FrameFlag.ATTITUDE_FROM_SOLVER
            if self._star_patterns_may_tell(state, frame):
                lost += 1
                found = self._match_star_pattern(state, frame, rate, middle)
        if found is None:
            return replace(known, lost=lost), unsolved(frame, state.camera, FrameFlag.NO_SOLUTION, matrix=matrix, rate=rate)
        fit, stars, listed, chosen = found
        shift = (1.0, 1.0) if state.seen_from is None else _shift_in_sides(fit, state.seen_from, header)
        elsewhere = _new_share(*shift) > SAME_FIELD
        evidence = FrameEvidence(
            values=fit.camera.shared(),
            gradient=fit.gradient,
            information=fit.information,
            catalogue=fit.catalogue,
            lasting=focal_correlation(*shift) if elsewhere else 1.0,
        )
        shared = state.shared.seen(evidence)
        fit = fit.with_shared(shared.values, shared.errors)
        seen_from = fit.matrix if elsewhere else state.seen_from
        new_state = replace(state, camera=fit.camera, shared=shared, last=(middle, fit.matrix, rate), seen_from=seen_from, lost=0)
        return new_state, _solution_of(header.frame, flags, fit, rate, stars, listed, chosen)

    def _star_patterns_may_tell(self, state: AstrometryState, frame: DownlinkFrame) -> bool:
        """Whether to search for star patterns: no if switched off, after too many failures, or without enough stars."""
        hopeless = state.lost >= LOST_FRAMES_TRIED
        if self.lost_in_space == "never" or hopeless or len(frame.stars) < MIN_STARS:
            return False
        return self.lost_in_space != "if_installed" or lost_in_space.installed()

    def _match_star_pattern(self, state: AstrometryState, frame: DownlinkFrame, rate: Array, middle: int) -> Match | None:
        """As `_match_and_fit`, from the attitude and parity that star patterns give; None when they give none."""
        header = frame.header
        seen = lost_in_space.find_attitude(
            frame.stars, state.camera, header.cols, header.rows, state.catalogue, self.pattern_folder
        )
        if seen is None:
            return None
        as_seen = replace(state, camera=replace(state.camera, mirrored=seen.mirrored))
        return self._match_and_fit(as_seen, frame, seen.matrix, rate, middle)

    def _match_and_fit(
        self, state: AstrometryState, frame: DownlinkFrame, matrix: Array, rate: Array, middle: int
    ) -> Match | None:
        """The match from a start attitude; None without a credible one."""
        header, camera = frame.header, state.camera
        order = _matching_order(frame)[:MAX_STARS]
        measured = np.stack((frame.stars.row[order], frame.stars.col[order]), axis=1)
        if len(order) < MIN_STARS:
            return None
        turns = row_turns(header, measured[:, 0], rate, middle)
        for radius_arcsec in (self.search_radius_arcsec, self.wide_search_arcsec):
            stars, apparent = self._stars_around(state, header, matrix, camera, middle, radius_arcsec)
            trial = self._vote(camera, header, measured, apparent @ matrix.T, radius_arcsec)
            if trial is None:
                continue
            voted = trial @ matrix
            result = self._refine(state, frame, measured, order, turns, stars, apparent, voted, camera)
            if result is not None:
                fit, listed, chosen = result
                return fit, stars, listed, chosen
        return None

    def _stars_around(
        self, state: AstrometryState, header: FrameHeader, matrix: Array, camera: Camera, middle: int, margin_arcsec: float
    ) -> tuple[Stars, Array]:
        """Catalogue stars that may lie in the frame, and their apparent directions."""
        last_row, last_col = header.rows - 1.0, header.cols - 1.0
        corners = camera.unproject(np.array([0.0, 0.0, last_row, last_row]), np.array([0.0, last_col, 0.0, last_col])) @ matrix
        axis = corners.mean(axis=0)
        axis /= np.linalg.norm(axis)
        radius_deg = float(np.degrees(np.arccos(np.clip((corners @ axis).min(), -1.0, 1.0)))) + margin_arcsec / 3600.0 + 0.02
        stars = state.catalogue.cone(
            float(np.degrees(np.arctan2(axis[1], axis[0]))),
            float(np.degrees(np.arcsin(np.clip(axis[2], -1.0, 1.0)))),
            radius_deg,
            epoch_jyear=jyear_of(middle),
            v_max=self.v_max,
        )
        position, velocity = observer_at(header.observer, middle)
        return stars, apparent_directions(stars.ra_deg, stars.dec_deg, middle, position, velocity)

    def _vote(self, camera: Camera, header: FrameHeader, measured: Array, vectors: Array, radius_arcsec: float) -> Array | None:
        """Rotation (3, 3) of the camera frame from the vote; None if the vote is not significant."""
        row, col = camera.project(vectors)
        margin = radius_arcsec * ARCSEC_RAD * camera.focal_px
        near = (row > -margin) & (row < header.rows + margin) & (col > -margin) & (col < header.cols + margin)
        center = np.array([camera.center_row, camera.center_col])
        half_size = 0.5 * float(np.hypot(header.rows, header.cols))
        vote = vote_offset(
            measured,
            np.stack((row[near], col[near]), axis=1),
            center=center,
            reach_px=margin,
            bin_px=max(1.0, 3.0 * margin / 200.0, 2e-4 * half_size),
            roll_limit_rad=float(np.radians(SEARCH_ROLL_DEG)),
            half_size_px=half_size,
        )
        if not vote.significant:
            return None
        # list minus catalogue in px -> small rotation: d row = -f theta_x, d col = f theta_y, roll turns +col towards +row
        hand = -1.0 if camera.mirrored else 1.0
        theta = np.array([-vote.d_row_px / camera.focal_px, hand * vote.d_col_px / camera.focal_px, 0.0])
        return rotation_by(theta) @ rotation_by(np.array([0.0, 0.0, hand * vote.roll_rad]))

    def _refine(
        self,
        state: AstrometryState,
        frame: DownlinkFrame,
        measured: Array,
        order: NDArray[np.intp],
        turns: Array,
        stars: Stars,
        apparent: Array,
        matrix: Array,
        camera: Camera,
    ) -> tuple[CameraSolution, NDArray[np.intp], NDArray[np.intp]] | None:
        """Pairs within a shrinking radius, a fit after each; indices into the frame's list and the catalogue."""
        scale = 0.5 * float(np.hypot(frame.header.rows, frame.header.cols))
        radius = max(6.0, 5e-3 * scale)
        usable_listed = (frame.stars.flags[order] & UNUSABLE_LISTED) == 0
        usable_stars = (stars.flags & UNUSABLE_CATALOGUE) == 0
        floor = max(1.5, 3.0 * state.psf_sigma_px)
        prior = state.shared.as_prior()
        fit: CameraSolution | None = None
        for _ in range(7):
            row, col = camera.project(apparent @ matrix.T)
            inside = np.isfinite(row)
            visible = np.flatnonzero(inside)
            listed, chosen = mutual_pairs(measured, np.stack((row[inside], col[inside]), axis=1), radius)
            chosen = visible[chosen]
            good = usable_listed[listed] & usable_stars[chosen]
            if good.sum() < MIN_STARS:
                good = np.ones(len(listed), dtype=bool)
            if good.sum() < MIN_STARS:
                return None
            listed, chosen = listed[good], chosen[good]
            catalogue = stars.sigma_mas[chosen].astype(np.float64) * 1e-3 * ARCSEC_RAD * camera.focal_px
            sigma = np.hypot(self._centroid_px(frame, order[listed], state.psf_sigma_px), catalogue)
            # Far from the solution all stars have the same weight. Near it they are weighted by their errors.
            sigma = np.maximum(sigma, 0.1 * radius if radius > floor else 0.0)
            fit = fit_camera(
                measured[listed],
                apparent[chosen],
                turns[listed],
                sigma,
                catalogue_px=catalogue,
                matrix=matrix,
                camera=camera,
                prior=prior,
            )
            matrix, camera = fit.matrix, fit.camera
            if radius <= floor:
                break
            spread = float(np.median(np.hypot(*fit.residual_px[fit.used].T)))
            radius = max(floor, min(0.5 * radius, 6.0 * spread))
        if fit is None or fit.used.sum() < MIN_STARS or not _credible(fit, radius, len(stars), frame.header):
            return None
        return fit, order[listed], chosen

    def _centroid_px(self, frame: DownlinkFrame, listed: NDArray[np.intp], psf_sigma_px: float) -> Array:
        """Error of each coordinate of list stars: PSF width over S/N, plus a floor."""
        return np.hypot(psf_sigma_px / np.maximum(frame.stars.snr[listed].astype(np.float64), 1.0), self.centroid_floor_px)

    def _prior_sigma(self, camera: NominalCamera) -> Array:
        """Errors (5,) of the shared parameters before any frame; distortion terms by their effect at the corner."""
        r = 0.5 * float(np.hypot(camera.rows, camera.cols)) / camera.focal_px
        tangent = max(PRIOR_DISTORTION_PX, 1e-6) / camera.focal_px
        return np.array([max(PRIOR_FOCAL_PPM, 1e-3) * 1e-6, tangent / r**3, tangent / r**5, tangent / r**2, tangent / r**2])


def row_turns(header: FrameHeader, row: Array, rate_rad_s: Array, middle_tai_ns: int) -> Array:
    """Rotation (n, 3) of the camera between the frame's epoch and mid-exposure of each row."""
    start = header.t_start_tai_ns + header.exposure_ns // 2 - middle_tai_ns
    return np.asarray(((start + header.line_time_ns * row) * 1e-9)[:, None] * rate_rad_s)


def unsolved(
    frame: DownlinkFrame, camera: Camera, flags: FrameFlag, *, matrix: Array | None = None, rate: Array | None = None
) -> FrameSolution:
    """The record of an unsolved frame. Its attitude is the best guess, else the unit quaternion."""
    return FrameSolution(
        frame=frame.header.frame,
        flags=flags,
        quaternion=np.array([0.0, 0.0, 0.0, 1.0]) if matrix is None else quaternion_of(matrix),
        rate_rad_s=np.zeros(3) if rate is None else rate,
        covariance_rad2=np.full((3, 3), np.nan),
        camera=camera,
        n_stars=0,
        rms_px=float("nan"),
        star_index=np.zeros(0, dtype=np.int32),
        star_v_mag=np.zeros(0, dtype=np.float32),
        star_b_v=np.zeros(0, dtype=np.float32),
        star_residual_px=np.zeros((0, 2), dtype=np.float32),
    )


def _start_attitude(state: AstrometryState, header: FrameHeader, middle: int) -> tuple[Array, Array] | None:
    """Attitude and rate to start from: telemetry, else the last solved frame moved by its rate."""
    if header.attitude is not None:
        return matrix_of(np.asarray(header.attitude.quaternion)), np.asarray(header.attitude.rate_rad_s)
    if state.last is None:
        return None
    last_ns, matrix, rate = state.last
    # directions turn against the camera: R(t) = rotation(-rate dt) R(then)
    return rotation_by(-rate * (middle - last_ns) * 1e-9) @ matrix, rate


def _matching_order(frame: DownlinkFrame) -> NDArray[np.intp]:
    """Star list by falling flux, cosmic-like and defective entries last."""
    doubtful = (frame.stars.flags & int(StarFlag.COSMIC_LIKE | StarFlag.DEFECT)) > 0
    return np.lexsort((-frame.stars.flux_e.astype(np.float64), doubtful))


def _shift_in_sides(fit: CameraSolution, before: Array, header: FrameHeader) -> tuple[float, float]:
    """By which share of its sides, rows and cols, the field lies off the one of the attitude `before` (3, 3), at most 1."""
    middle = np.array([0.5 * (header.rows - 1)]), np.array([0.5 * (header.cols - 1)])
    row, col = fit.camera.project(fit.camera.unproject(*middle) @ before @ fit.matrix.T)
    shift = abs(float(row[0] - middle[0][0])) / header.rows, abs(float(col[0] - middle[1][0])) / header.cols
    return shift if max(shift) < 1.0 else (1.0, 1.0)


def _new_share(moved_rows: float, moved_cols: float) -> float:
    """Share of the field that was not seen before; roll is left out."""
    return 1.0 - (1.0 - moved_rows) * (1.0 - moved_cols)


def _credible(fit: CameraSolution, radius_px: float, n_catalogue: int, header: FrameHeader) -> bool:
    """Residuals must crowd at zero: chance pairs fill the search circle evenly and have a median at 0.7 of its radius."""
    distance = np.hypot(*fit.residual_px.T)
    chance = n_catalogue * np.pi * (0.35 * radius_px) ** 2 / (header.rows * header.cols)
    close = int((distance < 0.35 * radius_px).sum())
    return close > 0.5 * len(distance) and close > 5.0 * chance


def _solution_of(
    frame: int,
    flags: FrameFlag,
    fit: CameraSolution,
    rate: Array,
    stars: Stars,
    listed: NDArray[np.intp],
    chosen: NDArray[np.intp],
) -> FrameSolution:
    """The contract's record of a fit."""
    used = fit.used
    camera = fit.camera
    if int(used.sum()) < 3 + len(SHARED):
        flags |= FrameFlag.FEW_STARS
    return FrameSolution(
        frame=frame,
        flags=flags,
        quaternion=quaternion_of(fit.matrix),
        rate_rad_s=rate,
        covariance_rad2=fit.covariance_rad2,
        camera=camera,
        n_stars=int(used.sum()),
        rms_px=float(np.sqrt(np.mean(fit.residual_px[used] ** 2))),
        star_index=listed[used].astype(np.int32),
        star_v_mag=stars.v_mag[chosen[used]],
        star_b_v=np.where(stars.flags[chosen[used]] & CatalogueFlag.ONE_BAND, np.float32(np.nan), stars.b_v[chosen[used]]),
        star_residual_px=fit.residual_px[used].astype(np.float32),
    )
