"""Ground products: frame solutions, streaks, tracklets, orbits."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import validate
from sboc_e2e.icd.camera import CameraModel
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import FrameFlag, StreakFlag


@dataclass(frozen=True, kw_only=True, eq=False)
class StreakPixels:
    """Pixels of one ROI group, calibrated, flat lists of equal length n, without duplicates.

    row, col : int32. value_e : float32, electrons above the background, stars subtracted where possible.
    variance_e2 : float32, noise variance without the object; infinite for pixels not to be used.
    psf_sigma_px : expected at the trail, without the pixel. frame_shape : (rows, cols).
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    value_e: NDArray[np.float32]
    variance_e2: NDArray[np.float32]
    psf_sigma_px: float
    frame_shape: tuple[int, int]

    def __post_init__(self) -> None:
        for name, dtype in (("row", "i4"), ("col", "i4"), ("value_e", "f4"), ("variance_e2", "f4")):
            object.__setattr__(self, name, validate.array(f"pixels.{name}", getattr(self, name), dtype, (None,)))
        validate.same_length("pixels", row=self.row, col=self.col, value_e=self.value_e, variance_e2=self.variance_e2)


@dataclass(frozen=True, kw_only=True, eq=False)
class StreakFit:
    """A trail in pixels. Ends are PSF-centre positions; by growing col (then row) until the direction is known.

    covariance_px2 : (4, 4) of (row0, col0, row1, col1).
    end_interval_px : (2, 2) 68 % intervals of end 0 and end 1 along the trail, relative to the quoted position,
    positive outwards. Use them instead of the covariance where `ENDS_NOT_GAUSSIAN` is set. They are the object's: where a trail
    fades it may go on unseen to the border.
    light_interval_px : (2, 2) the same of the ends of the light that is seen; empty: those of the object.
    flux_e : inside the frame, all of the trail. sagitta_px, gradient : curvature and linear brightness change
    (relative, end to end); 0 when the simpler model won. width_px : fitted PSF sigma.
    light_curve_e_px : (k,) flux density in equal bins along the trail from end 0 to end 1, may be empty; light_curve_err_e_px :
    (k,) one sigma, NaN when not given. period_fraction : of a periodic light curve, in fractions of the trail; None without one.
    flash_e : the part of flux_e that came in flashes shorter than what the PSF resolves along the trail.
    track_frames : frames that the place was taken from, together, by an on-board track of points; the covariance of the ends is
    then that track's, which all its members share. 0: the frame itself gave the place.
    failure : why a fit is flagged FIT_FAILED, in a few words that are the same for all of a kind; ingest.json counts them.
    psf_sigma_px : PSF sigma of a point at the trail's place, which the chain fills in for the vetter; NaN: not given.
    """

    row0: float
    col0: float
    row1: float
    col1: float
    covariance_px2: NDArray[np.float64]
    end_interval_px: NDArray[np.float64]
    sigma_cross_px: float
    flux_e: float
    flux_err_e: float
    snr: float
    sagitta_px: float
    sagitta_err_px: float
    gradient: float
    width_px: float
    width_err_px: float
    chi2_nu: float
    n_pixels: int
    flags: StreakFlag
    light_curve_e_px: NDArray[np.float32]
    light_curve_err_e_px: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, dtype=np.float32))
    period_fraction: float | None = None
    failure: str = ""
    psf_sigma_px: float = math.nan
    flash_e: float = 0.0
    track_frames: float = 0.0
    light_interval_px: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        light = validate.array("fit.light_interval_px", self.light_interval_px, "f8", (None, 2))
        object.__setattr__(self, "light_interval_px", light)
        object.__setattr__(self, "covariance_px2", validate.array("fit.covariance_px2", self.covariance_px2, "f8", (4, 4)))
        object.__setattr__(self, "end_interval_px", validate.array("fit.end_interval_px", self.end_interval_px, "f8", (2, 2)))
        object.__setattr__(self, "light_curve_e_px", validate.array("fit.light_curve_e_px", self.light_curve_e_px, "f4", (None,)))
        bins = self.light_curve_e_px.shape
        error = self.light_curve_err_e_px if len(self.light_curve_err_e_px) else np.full(bins, np.nan, dtype=np.float32)
        object.__setattr__(self, "light_curve_err_e_px", validate.array("fit.light_curve_err_e_px", error, "f4", bins))

    @property
    def light_ends_px(self) -> NDArray[np.float64]:
        """(2, 2) 68 % intervals of the ends of the light that is seen, those of the object where no others are given."""
        return self.light_interval_px if len(self.light_interval_px) else self.end_interval_px

    @property
    def length_px(self) -> float:
        """Length of the chord."""
        return float(np.hypot(self.row1 - self.row0, self.col1 - self.col0))

    @property
    def angle_deg(self) -> float:
        """atan2(drow, dcol) modulo 180 of the chord."""
        return float(np.degrees(np.arctan2(self.row1 - self.row0, self.col1 - self.col0)) % 180.0)

    @property
    def is_foretold(self) -> bool:
        """Whether the place is that of an on-board track over many frames, not that of this frame."""
        return self.track_frames > 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameSolution:
    """Camera and attitude of one frame, solved in apparent directions.

    quaternion : (4,) scalar last, apparent GCRS directions to the camera frame at mid-exposure of the middle row.
    rate_rad_s : (3,) angular velocity in camera axes, which moves the attitude to other epochs.
    covariance_rad2 : (3, 3) small rotation in the camera frame.
    camera : pixels to directions of the camera frame and back, of any model.
    matched stars: star_index into the frame's star list, with catalogue V and B-V (NaN: unknown) and residuals in px.
    """

    frame: int
    flags: FrameFlag
    quaternion: NDArray[np.float64]
    rate_rad_s: NDArray[np.float64]
    covariance_rad2: NDArray[np.float64]
    camera: CameraModel
    n_stars: int
    rms_px: float
    star_index: NDArray[np.int32]
    star_v_mag: NDArray[np.float32]
    star_b_v: NDArray[np.float32]
    star_residual_px: NDArray[np.float32]
    """(n, 2) row and col residual."""

    def __post_init__(self) -> None:
        if not isinstance(self.camera, CameraModel):
            raise ContractError(f"solution.camera: expected the methods of CameraModel, got {type(self.camera).__name__}")


@dataclass(frozen=True, kw_only=True)
class PhotometricSolution:
    """``V = zero_point_mag - 2.5 log10(e-/s on axis) + colour_term (B-V - 0.653)``, so a solar colour needs no term.

    field_mag : residual of the flat over the field, added to V: coefficients of x, y, x2, x y, y2 with x (col) and y (row)
    measured from the frame's middle in half diagonals. Zero-point error and rms come from the fit; NaN without stars.
    """

    frame: int
    zero_point_mag: float
    zero_point_err_mag: float
    colour_term: float
    n_stars: int
    rms_mag: float
    field_mag: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class StreakMeasurement:
    """A streak on the sky: the fit plus sky position, epoch, magnitude and probability.

    ra_deg, dec_deg : (3,) of end 0, middle, end 1, GCRS axes, aberration of the observer's geocentric velocity removed,
    annual aberration and light time not. t_tai_ns : (3,) int64 epochs of the same points: of the rows' mid-exposure
    until the direction is known, then true epochs of shutter open, middle, close. NaN and 0 where unknown.
    turn_rad_s : (3,) angular velocity of the camera, GCRS axes: the direction u of a pixel moves by turn x u, which gives its
    direction at another epoch of the exposure. 0 where the camera stands still or its rate is unknown.
    mag_at_1deg_s : of a trail that the frame's edge cuts, for a rate of 1 deg/s; at another it is
    ``mag_at_1deg_s - 2.5 log10(rate in deg/s)``. NaN for others.
    """

    frame: int
    streak_id: int
    roi_id: int
    fit: StreakFit
    row_mid: float
    col_mid: float
    ra_deg: NDArray[np.float64]
    dec_deg: NDArray[np.float64]
    t_tai_ns: NDArray[np.int64]
    sigma_along_arcsec: float
    sigma_cross_arcsec: float
    mag: float
    mag_err: float
    probability: float
    tracklet_id: int
    """-1 while unlinked."""
    flags: StreakFlag
    mag_at_1deg_s: float = float("nan")
    mag_at_1deg_s_err: float = float("nan")
    turn_rad_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    track: int = -1
    """Number of the on-board track over several frames that it is a member of; -1: of none."""
    track_snr: float = 0.0
    """Joint S/N of that track on board; 0: not known."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracklet:
    """One object over one or more frames, in time order.

    streak_ids, frames : (n,) of the streaks used. pieces : the streaks that are parts of a broken trail; their ends are not where
    the shutter opened and closed. probability : that all streaks are one real object.

    The chain measures the following fields on the final ends of the members, for any linker:
    t_tai_ns : (m,) epochs of the directions, rising; ra_deg, dec_deg : (m,) published directions, equal to those of the streaks;
    row_streak_ids, row_points : (m,) streak of each and which of its points (0: end 0, 1: middle, 2: end 1). Ends on the
    frame's edge and of pieces are left out: no shutter dates them.
    sigma_along_arcsec, sigma_cross_arcsec : (m,) one sigma along the motion and across it, correlation : (m,) of both;
    half68_along_arcsec : (m,) half of the 68 % interval along the motion: smaller than sigma where tails are heavy. May be empty.
    motion_angle_deg : (m,) position angle of the motion at each, from north by east; across is 90 deg further.
    shared_arcsec : (m, 3), shared_group : (m,). A joint fit gives its rows common errors along the motion: rows i and j of one
    group (-1: none) have the covariance ``shared[i] @ shared[j]``, which is part of sigma_along squared where i = j. Middles (row
    point 1) have it across the motion too: their place is that of one straight track of points.
    shared_cross_arcsec : (m, 3) the same across the motion for members on one line through all frames of the tracklet (zero for
    others), whatever their group: across, rows i and j have the covariance ``shared_cross[i] @ shared_cross[j]``.
    pointing_arcsec : (m,) part of both sigmas that the rows of one frame have in common. turning_arcsec : (m,) part of the sigma
    across, below 0 at shutter open, above at close: what the error of the camera's rate puts into rows of one frame. Both are
    zero where they are not given.
    ra_ref_deg, dec_ref_deg, t_ref_tai_ns, rate_deg_s, position_angle_deg : motion at the reference epoch.
    chi2_nu : of the motion model, against the ends of single-frame fits.
    mag : V of the object's mean light over its light curve at the mean epoch of the members; mag_err : one sigma, the unobserved
    part of the light curve included; mag_low, mag_high : 5 % and 95 % points of it, NaN when not given. mag_scatter : rms
    of the object's light about its mean (1.0857 x relative light), mag_scatter_err its error; mag_chi2_nu : of constant light.
    """

    tracklet_id: int
    streak_ids: NDArray[np.int64]
    frames: NDArray[np.int64]
    t_tai_ns: NDArray[np.int64]
    ra_deg: NDArray[np.float64]
    dec_deg: NDArray[np.float64]
    sigma_along_arcsec: NDArray[np.float64]
    sigma_cross_arcsec: NDArray[np.float64]
    t_ref_tai_ns: int
    ra_ref_deg: float
    dec_ref_deg: float
    rate_deg_s: float
    rate_err_deg_s: float
    position_angle_deg: float
    mag: float
    mag_err: float
    chi2_nu: float
    probability: float
    direction_resolved: bool
    flags: StreakFlag
    pieces: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    row_streak_ids: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    row_points: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    correlation: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    motion_angle_deg: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    half68_along_arcsec: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    shared_arcsec: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))
    shared_group: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    pointing_arcsec: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    turning_arcsec: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    mag_low: float = float("nan")
    mag_high: float = float("nan")
    mag_scatter: float = float("nan")
    mag_scatter_err: float = float("nan")
    mag_chi2_nu: float = float("nan")
    shared_cross_arcsec: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        m = len(self.t_tai_ns)
        for name, shape in (("turning_arcsec", (m,)), ("shared_cross_arcsec", (m, 3))):
            if len(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.zeros(shape))


@dataclass(frozen=True, kw_only=True, eq=False)
class OrbitState:
    """Posterior of an object's place and velocity at one epoch, GCRS axes, geocentric, km and km/s.

    t_tai_ns : the epoch at which the states hold (not that at which light left). mean (6,), covariance (6, 6) : of the posterior.
    gaussian : whether these describe it; if not, only the samples do. shape : the figures of that test, in words.
    sample_weight : (n,) sums to one; sample_state : (n, 6).
    """

    t_tai_ns: int
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    gaussian: bool
    shape: str
    sample_weight: NDArray[np.float64]
    sample_state: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.sample_weight)
        for name, shape in (("mean", (6,)), ("covariance", (6, 6)), ("sample_weight", (n,)), ("sample_state", (n, 6))):
            object.__setattr__(self, name, validate.finite_array(f"orbit_state.{name}", getattr(self, name), shape))


def _unknown() -> NDArray[np.float64]:
    return np.full(3, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class OrbitEstimate:
    """Posterior of a tracklet's range and orbit: each quantity as (5 %, median, 95 %), and the range modes.

    range_posterior : density per km on range_grid_km.
    modes : (k, 5) range_km, weight, a_km, e, i_deg. prior : what was assumed, in words.
    node_deg, perigee_deg, mean_anomaly_deg, latitude_argument_deg : (3,) medians in [0, 360), the other two points beside them
    without a jump at 360; NaN when not estimated. state : the posterior as states; None without one. lacks : why nothing was
    estimated, in words; empty when something was.
    """

    tracklet_id: int
    t_ref_tai_ns: int
    range_km: NDArray[np.float64]
    altitude_km: NDArray[np.float64]
    a_km: NDArray[np.float64]
    e: NDArray[np.float64]
    i_deg: NDArray[np.float64]
    size_m: NDArray[np.float64]
    modes: NDArray[np.float64]
    range_grid_km: NDArray[np.float64]
    range_posterior: NDArray[np.float64]
    prior: str
    converged: bool
    node_deg: NDArray[np.float64] = field(default_factory=_unknown)
    perigee_deg: NDArray[np.float64] = field(default_factory=_unknown)
    mean_anomaly_deg: NDArray[np.float64] = field(default_factory=_unknown)
    latitude_argument_deg: NDArray[np.float64] = field(default_factory=_unknown)
    state: OrbitState | None = None
    lacks: str = ""
