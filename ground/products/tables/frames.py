"""One row for each frame, see `frames_tables`."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from ground.products.epochs import utc_text
from ground.products.tables.columns import Spec, floats, or_nan, parts_of, table_of, texts
from ground.records import GroundProducts
from ground.sky.apparent import mid_frame_tai_ns
from ground.sky.pixel_sky import SolvedSky, mid_frame_directions, row_mid_exposure_tai_ns
from ground.sky.sphere import ARCSEC_RAD, spherical_deg
from sboc_e2e.icd.camera import CameraParameter
from sboc_e2e.icd.downlink import DownlinkFrame, Housekeeping
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution, PhotometricSolution

Array = NDArray[np.float64]

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


def frames_tables(products: GroundProducts, frames: Sequence[DownlinkFrame]) -> Iterator[Table]:
    """One row for each frame: epoch, pointing, camera, star statistics, zero point; flags from on board and from ground."""
    columns = products.solutions[0].camera.parameters() if len(frames) else ()
    for part in parts_of(len(frames)):
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
    return table_of(
        [
            ("frame", [h.frame for h in headers], None, "frame number"),
            ("t_start_utc", texts(utc_text([h.t_start_tai_ns for h in headers])), None, "start of exposure of row 0"),
            ("t_start_tai_ns", [h.t_start_tai_ns for h in headers], "ns", "start of exposure of row 0"),
            ("t_mid_utc", texts(utc_text([mid_frame_tai_ns(h) for h in headers])), None, "mid-exposure of the middle row"),
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
            ("rms_px", floats(solutions, "rms_px"), "pix", "rms of a coordinate's star residuals"),
            ("zero_point_mag", floats(photometry, "zero_point_mag"), "mag", "V of 1 e-/s on axis for a solar colour"),
            ("zero_point_err_mag", floats(photometry, "zero_point_err_mag"), "mag", "its error"),
            ("colour_term", floats(photometry, "colour_term"), None, "mag of V for 1 mag of B-V"),
            ("n_phot", [p.n_stars for p in photometry], None, "stars in the zero point"),
            ("rms_mag", floats(photometry, "rms_mag"), "mag", "rms of the stars' residuals"),
            (
                "psf_sigma_px",
                [or_nan(psf_sigma_px) for _, psf_sigma_px, _ in status],
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
