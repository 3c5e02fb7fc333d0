"""Tables of a run with units and descriptions, ready to be written as ECSV: frames, stars, streaks, tracklets, orbits.

Tables with rows for each frame, star or streak come in pieces, of which one is in memory at a time.
"""

import json
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, Final

import numpy as np
from astropy.table import Column, Table
from numpy.typing import NDArray

from ground.orbit.catalogue_match import CatalogueMatch
from ground.products.epochs import utc_text
from ground.products.light_curve import light_curve
from ground.records import GroundProducts
from ground.sky.apparent import mid_frame_tai_ns
from ground.sky.pixel_sky import SolvedSky, mid_frame_directions, row_mid_exposure_tai_ns
from ground.sky.sphere import ARCSEC_RAD, spherical_deg
from sboc_e2e.icd.camera import CameraParameter
from sboc_e2e.icd.downlink import DownlinkFrame, Housekeeping
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution, OrbitEstimate, PhotometricSolution, StreakMeasurement
from sboc_e2e.icd.signals import StarList
from sboc_e2e.icd.version import CONTRACT_VERSION

COUNTERS: Final = (
    ("n_stars_found", None, "stars found on board"),
    ("n_detections", None, "detections of the on-board detector"),
    ("n_rois_sent", None, "regions of interest sent"),
    ("n_rois_dropped", None, "detections without a region that was sent"),
    ("bytes_dropped", "byte", "bytes that did not fit into the downlink budget"),
    ("n_masked", "pix", "pixels masked on board"),
    ("parameter_set", None, "number of the set of parameters that flew"),
    ("operations", None, "work on board, in operations"),
    ("shed_stars", None, "entries of the star list that were left out or not fitted for want of work"),
    ("shed_halos", None, "bright stars whose halo was not measured"),
    ("shed_candidates", None, "candidates of trails that were not searched"),
    ("shed_points", None, "new star-like entries that were not fitted"),
    ("shed_trails", None, "trails that were not looked at further"),
    ("shed_regions", None, "regions of interest that were not cut"),
)
"""Fields of `Housekeeping` that `frames.ecsv` has: name, unit, meaning."""

GRID_LINES: Final = 9
"""Enough for a reader to interpolate the distortion; chosen, not measured. `GRID_TEXT` and docs state it."""
GRID_TEXT: Final = (
    "9 x 9 pixels, evenly spaced from corner to corner, row by row, at mid-exposure of their rows; NaN where unsolved"
)
GRID_DECIMALS: Final = 9
"""Of degrees: 4 micro-arcseconds."""

FRAMES_AT_ONCE: Final = 64
"""Rows in memory at once; a limit of memory."""
STREAKS_AT_ONCE: Final = 4096
"""Rows in memory at once; a limit of memory."""

CROSSINGS: Final = (
    "SINGLE_FRAME with EDGE0 and EDGE1 is an object that crossed the field within one exposure; its speed is unknown: "
    "mag = mag_at_1deg_s - 2.5 log10(rate in deg/s)"
)

Array = NDArray[np.float64]

Spec = tuple[str, Any, str | None, str]
"""Name, values, unit, description."""


def frames_tables(products: GroundProducts, frames: Sequence[DownlinkFrame]) -> Iterator[Table]:
    """One row for each frame: epoch, pointing, camera, star statistics, zero point; flags from on board and from ground."""
    columns = products.solutions[0].camera.parameters() if len(frames) else ()
    for part in _parts(len(frames)):
        status = [(frame.flags, frame.psf_sigma_px, frame.housekeeping) for frame in (frames[k] for k in part)]
        at = slice(part.start, part.stop)
        yield _frames_table(products.headers[at], products.solutions[at], products.photometry[at], status, columns)


def _frames_table(
    headers: Sequence[FrameHeader],
    solutions: Sequence[FrameSolution],
    photometry: Sequence[PhotometricSolution],
    status: Sequence[tuple[FrameFlag, float | None, Housekeeping | None]],
    columns: Sequence[CameraParameter],
) -> Table:
    """status : flags, PSF width and counters from on board. columns : parameter columns of the run's first camera."""
    counters = [housekeeping for _, _, housekeeping in status]
    solved = np.array([not s.flags & FrameFlag.NO_SOLUTION for s in solutions], dtype=bool)
    ra, dec = _centre_directions(headers, solutions)
    grid = np.array([_grid_directions(h, s) for h, s in zip(headers, solutions, strict=True)]).reshape(-1, GRID_LINES**2, 2)
    sigma = np.array([np.sqrt(np.diag(s.covariance_rad2)) for s in solutions]).reshape(-1, 3) / ARCSEC_RAD
    quaternion = np.array([s.quaternion for s in solutions]).reshape(-1, 4)
    rate = np.array([s.rate_rad_s for s in solutions]).reshape(-1, 3)
    return _table(
        [
            ("frame", [h.frame for h in headers], None, "frame number"),
            ("t_start_utc", _text(utc_text([h.t_start_tai_ns for h in headers])), None, "start of exposure of row 0"),
            ("t_start_tai_ns", [h.t_start_tai_ns for h in headers], "ns", "start of exposure of row 0"),
            ("t_mid_utc", _text(utc_text([mid_frame_tai_ns(h) for h in headers])), None, "mid-exposure of the middle row"),
            ("exposure_s", [h.exposure_ns * 1e-9 for h in headers], "s", "exposure of each row"),
            ("line_time_s", [h.line_time_ns * 1e-9 for h in headers], "s", "delay from row to row"),
            ("rows", [h.rows for h in headers], "pix", "delivered rows"),
            ("cols", [h.cols for h in headers], "pix", "delivered columns"),
            ("solved", solved, None, "whether the attitude was solved from stars"),
            ("ra_app_deg", ra, "deg", "apparent right ascension of the frame's middle (GCRS axes, all aberration in)"),
            ("dec_app_deg", dec, "deg", "apparent declination of the frame's middle"),
            ("qx", quaternion[:, 0], None, "attitude quaternion, apparent GCRS directions to camera frame"),
            ("qy", quaternion[:, 1], None, "attitude quaternion"),
            ("qz", quaternion[:, 2], None, "attitude quaternion"),
            ("qw", quaternion[:, 3], None, "attitude quaternion, scalar"),
            *((f"rate_{axis}_rad_s", rate[:, k], "rad / s", "angular velocity, camera axes") for k, axis in enumerate("xyz")),
            ("sigma_x_arcsec", sigma[:, 0], "arcsec", "error of the rotation about the col axis"),
            ("sigma_y_arcsec", sigma[:, 1], "arcsec", "error of the rotation about the row axis"),
            ("sigma_roll_arcsec", sigma[:, 2], "arcsec", "error of the rotation about the boresight"),
            *_camera_columns(solutions, columns),
            ("grid_ra_app_deg", grid[..., 0], "deg", f"apparent right ascension (GCRS axes, all aberration in) of {GRID_TEXT}"),
            ("grid_dec_app_deg", grid[..., 1], "deg", f"apparent declination of {GRID_TEXT}"),
            ("n_stars", [s.n_stars for s in solutions], None, "stars in the camera fit"),
            ("rms_px", _floats(solutions, "rms_px"), "pix", "rms of a coordinate's star residuals"),
            ("zero_point_mag", _floats(photometry, "zero_point_mag"), "mag", "V of 1 e-/s on axis for a solar colour"),
            ("zero_point_err_mag", _floats(photometry, "zero_point_err_mag"), "mag", "its error"),
            ("colour_term", _floats(photometry, "colour_term"), None, "mag of V for 1 mag of B-V"),
            ("n_phot", [p.n_stars for p in photometry], None, "stars in the zero point"),
            ("rms_mag", _floats(photometry, "rms_mag"), "mag", "rms of the stars' residuals"),
            (
                "psf_sigma_px",
                [_or_nan(psf_sigma_px) for _, psf_sigma_px, _ in status],
                "pix",
                "PSF sigma in mid-field, measured on board",
            ),
            *(
                (
                    name,
                    np.array([-1 if c is None else getattr(c, name) for c in counters], dtype=np.int64),
                    unit,
                    text + "; -1: header packet lost",
                )
                for name, unit, text in COUNTERS
            ),
            (
                "threshold_sigma",
                [float("nan") if c is None else float(c.threshold_sigma) for c in counters],
                None,
                "S/N above which all were sent when a particle storm met the limit of regions, else 0; NaN: header packet lost",
            ),
            ("flags", [int(s.flags | flags) for s, (flags, _, _) in zip(solutions, status, strict=True)], None, "FrameFlag bits"),
        ],
        "frames",
    )


def stars_tables(products: GroundProducts, frames: Sequence[DownlinkFrame]) -> Iterator[Table]:
    """One row for each star that was received, with its identification where there is one."""
    for part in _parts(len(frames)):
        yield _stars_table([(frames[k].header.frame, frames[k].stars, products.solutions[k]) for k in part])


def _stars_table(found: Sequence[tuple[int, StarList, FrameSolution]]) -> Table:
    """found : number, stars and solution of each frame."""
    parts: dict[str, list[Any]] = {name: [] for name in ("frame", "row", "col", "flux", "snr", "flags", "v", "bv", "dr", "dc")}
    for number, stars, solution in found:
        n = len(stars)
        matched = {name: np.full(n, np.nan) for name in ("v", "bv", "dr", "dc")}
        index = np.asarray(solution.star_index, dtype=np.intp)
        matched["v"][index], matched["bv"][index] = solution.star_v_mag, solution.star_b_v
        matched["dr"][index], matched["dc"][index] = solution.star_residual_px[:, 0], solution.star_residual_px[:, 1]
        parts["frame"].append(np.full(n, number))
        for name, values in (("row", stars.row), ("col", stars.col), ("flux", stars.flux_e)):
            parts[name].append(values)
        parts["snr"].append(stars.snr)
        parts["flags"].append(stars.flags)
        for name, values in matched.items():
            parts[name].append(values)
    column = {name: np.concatenate(values) if values else np.zeros(0) for name, values in parts.items()}
    return _table(
        [
            ("frame", column["frame"].astype(np.int64), None, "frame number"),
            ("row", column["row"], "pix", "centroid"),
            ("col", column["col"], "pix", "centroid"),
            ("flux_e", column["flux"], "electron", "flux in one exposure"),
            ("snr", column["snr"], None, "matched-filter S/N"),
            ("v_mag", column["v"], "mag", "catalogue V; NaN when not identified"),
            ("b_v", column["bv"], "mag", "catalogue B-V"),
            ("residual_row_px", column["dr"], "pix", "measured minus fitted"),
            ("residual_col_px", column["dc"], "pix", "measured minus fitted"),
            ("flags", column["flags"].astype(np.int64), None, "StarFlag bits"),
        ],
        "stars",
    )


def streaks_tables(products: GroundProducts) -> Iterator[Table]:
    """One row for each measured streak; ends by growing col before linking, by time after it (DIRECTION_RESOLVED)."""
    left = iter(products.streaks)
    directions = _directions(products.headers)
    part = list(islice(left, STREAKS_AT_ONCE))
    yield _streaks_table(part, directions)
    while part := list(islice(left, STREAKS_AT_ONCE)):
        yield _streaks_table(part, directions)


def _streaks_table(streaks: Sequence[StreakMeasurement], directions: str) -> Table:
    fits = [s.fit for s in streaks]
    covariance = np.array([f.covariance_px2 for f in fits]).reshape(-1, 4, 4)
    interval = np.array([f.end_interval_px for f in fits]).reshape(-1, 2, 2)
    ra, dec = (np.array([getattr(s, name) for s in streaks]).reshape(-1, 3) for name in ("ra_deg", "dec_deg"))
    t = [np.array([s.t_tai_ns[k] for s in streaks], dtype=np.int64) for k in range(3)]
    length = np.array([np.nan if f.flags & StreakFlag.POINT_LIKE or f.length_px == 0.0 else f.length_px for f in fits])
    density = np.array([(f.flux_e, f.flux_err_e) for f in fits]).reshape(-1, 2) / length[:, None]
    lists: list[Spec] = [
        ("frame", [s.frame for s in streaks], None, "frame number, 0-based"),
        ("streak_id", [s.streak_id for s in streaks], None, "unique in a run"),
        ("roi_id", [s.roi_id for s in streaks], None, "ROI group it was measured in"),
        ("row0", [f.row0 for f in fits], "pix", "PSF centre at end 0"),
        ("col0", [f.col0 for f in fits], "pix", "PSF centre at end 0"),
        ("row1", [f.row1 for f in fits], "pix", "PSF centre at end 1"),
        ("col1", [f.col1 for f in fits], "pix", "PSF centre at end 1"),
        ("row_mid", [s.row_mid for s in streaks], "pix", "middle of the trail"),
        ("col_mid", [s.col_mid for s in streaks], "pix", "middle of the trail"),
        ("length_px", [f.length_px for f in fits], "pix", "chord"),
        ("angle_deg", [f.angle_deg for f in fits], "deg", "atan2(drow, dcol) mod 180 of the chord"),
        ("flux_e", [f.flux_e for f in fits], "electron", "flux inside the frame"),
        ("flux_err_e", [f.flux_err_e for f in fits], "electron", "its error"),
        ("flash_e", [f.flash_e for f in fits], "electron", "part of the flux that came in short flashes, as of a glint"),
        (
            "density_e_px",
            density[:, 0],
            "electron / pix",
            "flux over length, NaN for points: brightness over speed, of any shutter",
        ),
        ("density_err_e_px", density[:, 1], "electron / pix", "flux_err_e over length"),
        ("snr", [f.snr for f in fits], None, "matched-filter S/N, noise without the object"),
        ("ra_mid_deg", ra[:, 1], "deg", "published right ascension of the middle"),
        ("dec_mid_deg", dec[:, 1], "deg", "published declination of the middle"),
        ("ra0_deg", ra[:, 0], "deg", "published right ascension of end 0"),
        ("dec0_deg", dec[:, 0], "deg", "published declination of end 0"),
        ("ra1_deg", ra[:, 2], "deg", "published right ascension of end 1"),
        ("dec1_deg", dec[:, 2], "deg", "published declination of end 1"),
        ("sigma_along_arcsec", [s.sigma_along_arcsec for s in streaks], "arcsec", "error of the middle along the trail"),
        ("sigma_cross_arcsec", [s.sigma_cross_arcsec for s in streaks], "arcsec", "error of the middle across the trail"),
        ("sigma_cross_px", [f.sigma_cross_px for f in fits], "pix", "error of the middle across the trail, fit alone"),
    ]
    names = ("row0", "col0", "row1", "col1")
    lists += [
        (f"cov_{names[i]}_{names[j]}", covariance[:, i, j], "pix2", "covariance of the ends")
        for i in range(4)
        for j in range(i, 4)
    ]
    lists += [
        ("end0_low_px", interval[:, 0, 0], "pix", "68 % interval of end 0 along the trail, outwards positive"),
        ("end0_high_px", interval[:, 0, 1], "pix", "68 % interval of end 0"),
        ("end1_low_px", interval[:, 1, 0], "pix", "68 % interval of end 1 along the trail, outwards positive"),
        ("end1_high_px", interval[:, 1, 1], "pix", "68 % interval of end 1"),
        ("t_mid_utc", _text(utc_text(t[1])), None, "epoch of the middle"),
        ("t0_tai_ns", t[0], "ns", "epoch of end 0 (mid-exposure of its row until the direction is known)"),
        ("t_mid_tai_ns", t[1], "ns", "epoch of the middle"),
        ("t1_tai_ns", t[2], "ns", "epoch of end 1 (mid-exposure of its row until the direction is known)"),
        ("mag", [s.mag for s in streaks], "mag", "Johnson V for a solar colour"),
        ("mag_err", [s.mag_err for s in streaks], "mag", "its error"),
        ("mag_at_1deg_s", [s.mag_at_1deg_s for s in streaks], "mag", "of trails cut by an edge: mag if they move by 1 deg/s"),
        ("mag_at_1deg_s_err", [s.mag_at_1deg_s_err for s in streaks], "mag", "its error"),
        ("sagitta_px", [f.sagitta_px for f in fits], "pix", "height of the arc over its chord, signed; 0 when straight"),
        ("gradient", [f.gradient for f in fits], None, "relative brightness change from end 0 to end 1"),
        ("width_px", [f.width_px for f in fits], "pix", "fitted PSF sigma"),
        ("width_err_px", [f.width_err_px for f in fits], "pix", "its error"),
        ("chi2_nu", [f.chi2_nu for f in fits], None, "chi-square of the fit by degrees of freedom"),
        ("period_fraction", [_or_nan(f.period_fraction) for f in fits], None, "period of the light curve by the trail's length"),
        ("probability", [s.probability for s in streaks], None, "that it is a real object, from this frame alone"),
        ("tracklet_id", [s.tracklet_id for s in streaks], None, "-1 while unlinked"),
        ("flags", [int(s.flags) for s in streaks], None, "StreakFlag bits"),
    ]
    table = _table(lists, "streaks")
    table.meta["directions"] = directions
    table.meta["crossings"] = CROSSINGS
    return table


def tracklets_table(products: GroundProducts) -> Table:
    """One row for each tracklet: motion at its reference epoch."""
    tracklets = products.tracklets
    curves = [light_curve(members) for members in products.members]
    table = _table(
        [
            ("tracklet_id", [t.tracklet_id for t in tracklets], None, "number of the tracklet"),
            ("n_frames", [len(np.unique(t.frames)) for t in tracklets], None, "frames it was seen in"),
            ("first_frame", [int(t.frames.min()) for t in tracklets], None, "first frame"),
            ("last_frame", [int(t.frames.max()) for t in tracklets], None, "last frame"),
            (
                "streak_ids",
                _text([" ".join(str(i) for i in t.streak_ids) for t in tracklets]),
                None,
                "streaks used, in time order",
            ),
            ("t_ref_utc", _text(utc_text([t.t_ref_tai_ns for t in tracklets])), None, "reference epoch"),
            ("t_ref_tai_ns", [t.t_ref_tai_ns for t in tracklets], "ns", "reference epoch"),
            ("ra_ref_deg", [t.ra_ref_deg for t in tracklets], "deg", "published right ascension at the reference epoch"),
            ("dec_ref_deg", [t.dec_ref_deg for t in tracklets], "deg", "published declination at the reference epoch"),
            ("rate_deg_s", [t.rate_deg_s for t in tracklets], "deg / s", "rate of the published direction"),
            ("rate_err_deg_s", [t.rate_err_deg_s for t in tracklets], "deg / s", "its error"),
            ("position_angle_deg", [t.position_angle_deg for t in tracklets], "deg", "of the motion, from north by east"),
            ("mag", [t.mag for t in tracklets], "mag", "Johnson V of the object's mean light over its light curve, solar colour"),
            ("mag_err", [t.mag_err for t in tracklets], "mag", "half of its 68 % interval: noise and what the light curve hides"),
            ("mag_low", [t.mag_low for t in tracklets], "mag", "5 % point, the bright one"),
            ("mag_high", [t.mag_high for t in tracklets], "mag", "95 % point"),
            (
                "mag_scatter",
                [t.mag_scatter for t in tracklets],
                "mag",
                "rms of the object's light about its mean, 1.0857 x relative light; of a sinusoid, amplitude / 1.414",
            ),
            ("mag_scatter_err", [t.mag_scatter_err for t in tracklets], "mag", "its error"),
            ("mag_chi2_nu", [t.mag_chi2_nu for t in tracklets], None, "of constant light, NaN with one magnitude"),
            ("period_s", [c.period_s for c in curves], "s", "period of the brightness from frame to frame, NaN without one"),
            (
                "period_false_alarm",
                [c.false_alarm for c in curves],
                None,
                "probability of as high a peak of the periodogram without a period, NaN when not tried",
            ),
            ("chi2_nu", [t.chi2_nu for t in tracklets], None, "of the motion model"),
            ("probability", [t.probability for t in tracklets], None, "that all of it is one real object"),
            (
                "direction_resolved",
                np.array([t.direction_resolved for t in tracklets], dtype=bool),
                None,
                "sense of motion known",
            ),
            ("flags", [int(t.flags) for t in tracklets], None, "StreakFlag bits"),
        ],
        "tracklets",
    )
    table.meta["directions"] = _directions(products.headers)
    return table


def orbits_table(products: GroundProducts) -> Table:
    """One row for each orbit estimate: 5 %, 50 % and 95 % points of the posterior, and its modes as JSON."""
    orbits = products.orbits
    columns: list[Spec] = [
        ("tracklet_id", [o.tracklet_id for o in orbits], None, "tracklet"),
        ("t_ref_utc", _text(utc_text([o.t_ref_tai_ns for o in orbits])), None, "reference epoch"),
        ("t_ref_tai_ns", [o.t_ref_tai_ns for o in orbits], "ns", "reference epoch"),
    ]
    for name, suffix, unit, text in (
        ("range", "_km", "km", "distance"),
        ("altitude", "_km", "km", "height over a sphere of 6378.137 km"),
        ("a", "_km", "km", "semi-major axis"),
        ("e", "", None, "eccentricity"),
        ("i", "_deg", "deg", "inclination"),
        ("size", "_m", "m", "diameter of a Lambert sphere of the albedo in prior, with its scatter"),
    ):
        values = np.array([getattr(o, name + suffix) for o in orbits]).reshape(-1, 3)
        columns += [
            (f"{name}{point}{suffix}", values[:, k], unit, f"{text}, {share} of the posterior")
            for k, (point, share) in enumerate((("_low", "5 %"), ("", "median"), ("_high", "95 %")))
        ]
    for name, text in (
        ("node", "right ascension of the ascending node"),
        ("perigee", "argument of perigee"),
        ("mean_anomaly", "mean anomaly"),
        ("latitude_argument", "angle from the ascending node"),
    ):
        values = np.array([getattr(o, f"{name}_deg") for o in orbits]).reshape(-1, 3)
        columns += [
            (f"{name}{point}_deg", values[:, k], "deg", f"{text}, {share} of the posterior, no jump at 360 beside the median")
            for k, (point, share) in enumerate((("_low", "5 %"), ("", "median"), ("_high", "95 %")))
        ]
    columns += [
        (
            "modes",
            _text([json.dumps(np.round(o.modes, 6).tolist()) for o in orbits]),
            None,
            "[range_km, weight, a_km, e, i_deg] of each mode",
        ),
        ("prior", _text([o.prior for o in orbits]), None, "what was assumed"),
        ("converged", np.array([o.converged for o in orbits], dtype=bool), None, "whether the arc says anything"),
        (
            "gaussian",
            np.array([o.state is not None and o.state.gaussian for o in orbits], dtype=bool),
            None,
            "whether a mean and a covariance describe the posterior of the state (then the OPM has them)",
        ),
        ("state", _text([_state_words(o) for o in orbits]), None, "how Gaussian the state is, or why there is none"),
    ]
    return _table(columns, "orbits")


def _state_words(orbit: OrbitEstimate) -> str:
    """Figures of the test of a state, or what is lacking for one."""
    if orbit.state is not None:
        return orbit.state.shape
    return f"none: {orbit.lacks}" if orbit.lacks else "none: the orbit step gives no state"


def _parts(n_frames: int) -> Iterator[range]:
    """Places of the frames of each piece; one empty piece where there is no frame."""
    for low in range(0, max(n_frames, 1), FRAMES_AT_ONCE):
        yield range(low, min(low + FRAMES_AT_ONCE, n_frames))


def _centre_directions(headers: Sequence[FrameHeader], solutions: Sequence[FrameSolution]) -> tuple[Any, Any]:
    """Apparent directions of the frames' middles, NaN where unsolved."""
    vectors = np.full((len(headers), 3), np.nan)
    for k, (header, solution) in enumerate(zip(headers, solutions, strict=True)):
        if not solution.flags & FrameFlag.NO_SOLUTION:
            middle = np.array([0.5 * (header.rows - 1)]), np.array([0.5 * (header.cols - 1)])
            vectors[k] = mid_frame_directions(solution, *middle)[0]
    return spherical_deg(vectors)


def _grid_directions(header: FrameHeader, solution: FrameSolution) -> Array:
    """Apparent right ascension and declination (deg), (81, 2), of the grid at mid-exposure of its rows; NaN where unsolved."""
    if solution.flags & FrameFlag.NO_SOLUTION:
        return np.full((GRID_LINES**2, 2), np.nan)
    lines = np.linspace(0.0, header.rows - 1.0, GRID_LINES), np.linspace(0.0, header.cols - 1.0, GRID_LINES)
    row, col = (a.ravel() for a in np.meshgrid(*lines, indexing="ij"))
    sky = SolvedSky(header=header, solution=solution)
    directions = spherical_deg(sky.apparent(row, col, row_mid_exposure_tai_ns(header, row)))
    return np.asarray(np.round(np.stack(directions, axis=-1), GRID_DECIMALS), dtype=np.float64)


def _camera_columns(solutions: Sequence[FrameSolution], columns: Sequence[CameraParameter]) -> list[Spec]:
    """The columns that the camera's model asks for. Raises `PluginError` when a frame's camera has others than the first one."""
    values = []
    for solution in solutions:
        own = solution.camera.parameters()
        if [p.name for p in own] != [p.name for p in columns]:
            names = ", ".join(p.name for p in own)
            kind = f"{type(solution.camera).__module__}:{type(solution.camera).__qualname__}"
            raise PluginError(f"{kind}, frame {solution.frame}: parameters {names}; the first frame's camera has others")
        values.append([p.value for p in own])
    kinds = [bool if isinstance(p.value, bool) else np.float64 for p in columns]
    return [(p.name, np.array([row[k] for row in values], dtype=kinds[k]), p.unit, p.description) for k, p in enumerate(columns)]


WHOLE_NUMBERS: Final = ("_id", "_ns", "frame", "frames", "flags", "rows", "cols", "dropped")
"""How the names of columns of integers end, besides those that begin with n_."""


def _table(columns: Sequence[Spec], name: str) -> Table:
    """An astropy table; empty lists become empty columns of the right kind."""
    made = []
    for title, values, unit, text in columns:
        array = np.asarray(values)
        if array.size == 0 and array.dtype.kind == "f" and isinstance(values, list):
            array = array.astype(np.int64 if title.startswith("n_") or title.endswith(WHOLE_NUMBERS) else np.float64)
        made.append(Column(array, name=title, unit=unit, description=text))
    return Table(made, meta={"table": name, "contract_version": CONTRACT_VERSION})


def _directions(headers: Sequence[FrameHeader]) -> str:
    """What a run's published directions are, in words; without the observer's state nothing can be removed."""
    unknown = sum(header.observer is None for header in headers)
    if unknown == 0:
        removed = "aberration of the observer's geocentric velocity removed"
    elif unknown < len(headers):
        removed = "aberration of the observer's geocentric velocity removed, except in frames flagged NO_OBSERVER"
    else:
        removed = "observer state unknown: aberration of the observer's geocentric velocity not removed"
    return f"GCRS axes, observer-centred; {removed}, annual aberration not removed, light time not removed"


def _text(values: Sequence[str]) -> Any:
    """A text column, also when empty."""
    return np.array(list(values), dtype=str) if values else np.zeros(0, dtype="U1")


def _floats(records: Sequence[object], name: str) -> NDArray[np.float64]:
    """A field of records as floats in every piece of a table, for any number type that a step returned."""
    return np.array([getattr(record, name) for record in records], dtype=np.float64)


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value


def known_table(products: GroundProducts, matches: Sequence[CatalogueMatch]) -> Table:
    """One row for each tracklet: the nearest catalogue object and all that would do; '-' and NaN where none could be compared."""
    by_tracklet = {match.tracklet_id: match for match in matches}
    found = [by_tracklet.get(t.tracklet_id) for t in products.tracklets]
    columns: list[Spec] = [
        ("tracklet_id", [t.tracklet_id for t in products.tracklets], None, "tracklet"),
        (
            "known",
            np.array([m is not None and m.known for m in found], dtype=bool),
            None,
            "whether one catalogue object fits, no other, and chance gives no such match",
        ),
        (
            "status",
            _text([_status(m) for m in found]),
            None,
            "known; ambiguous: candidates are hypotheses; unknown: none fits; not compared: no directions or no observer orbit",
        ),
        ("name", _text([m.name if m is not None and m.known else "-" for m in found]), None, "object, when known"),
        ("number", np.array([m.number if m is not None and m.known else -1 for m in found], dtype=np.int64), None, "its number"),
    ]
    for name, unit, text in (
        ("along_arcsec", "arcsec", "observed minus computed along the motion of the nearest object"),
        ("cross_arcsec", "arcsec", "observed minus computed across it"),
        ("rate_residual_arcsec_s", "arcsec / s", "length of the difference between observed and computed rate"),
        ("range_km", "km", "distance of the nearest object"),
        ("sigmas", None, "distance in expected errors of element sets"),
        (
            "chance_probability",
            None,
            "that an unrelated object fits as well as the nearest, from the density of predicted objects in place and rate",
        ),
    ):
        columns.append((name, [float("nan") if m is None else getattr(m, name) for m in found], unit, text))
    n_candidates = np.array([0 if m is None else m.n_candidates for m in found], dtype=np.int64)
    columns.append(("n_candidates", n_candidates, None, "objects that would do; more than one: ambiguous"))
    hypotheses = [
        [[c.number, c.name, round(c.sigmas, 3), float(f"{c.chance_probability:.3g}")] for c in (m.candidates if m else ())]
        for m in found
    ]
    columns.append(
        ("candidates", _text([json.dumps(h) for h in hypotheses]), None, "[number, name, sigmas, chance_probability] of each")
    )
    return _table(columns, "known")


def _status(match: CatalogueMatch | None) -> str:
    """Word for what a comparison with the catalogue gave."""
    if match is None:
        return "not compared"
    if match.known:
        return "known"
    return "ambiguous" if match.candidates else "unknown"
