"""Truth tables: what the simulator knows and ground must never see. Columns, units and meanings, once.

Each table is a numpy structured array of the dtypes below; the harness writes them as ECSV with these units and
descriptions. `sboc score --truth` reads a folder of them, or one table of the columns EXTERNAL from any other source.
Published directions follow section "published direction" of ICD.md.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

PATH_NODES: Final = 33
"""Samples of a trail's path, equal steps of time from end 0 to end 1: the part inside the frame, where it is cut."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column: name, dtype, unit ('' when dimensionless), meaning."""

    name: str
    dtype: DTypeLike
    unit: str
    text: str


_PATH = (PATH_NODES,)

STREAKS: Final = (
    Column(name="frame", dtype="i4", unit="", text="frame number"),
    Column(name="object_id", dtype="i4", unit="", text="row of objects.ecsv"),
    Column(name="row0", dtype="f8", unit="pix", text="PSF centre at shutter open (clipped to the frame)"),
    Column(name="col0", dtype="f8", unit="pix", text="PSF centre at shutter open (clipped to the frame)"),
    Column(name="row1", dtype="f8", unit="pix", text="PSF centre at shutter close (clipped to the frame)"),
    Column(name="col1", dtype="f8", unit="pix", text="PSF centre at shutter close (clipped to the frame)"),
    Column(name="edge0", dtype="?", unit="", text="end 0 is where the trail enters the frame, not shutter open"),
    Column(name="edge1", dtype="?", unit="", text="end 1 is where the trail leaves the frame, not shutter close"),
    Column(name="t0_tai_ns", dtype="i8", unit="ns", text="true epoch of end 0"),
    Column(name="t1_tai_ns", dtype="i8", unit="ns", text="true epoch of end 1"),
    Column(name="length_px", dtype="f8", unit="pix", text="arc length inside the frame"),
    Column(name="flux_e", dtype="f8", unit="electron", text="noise-free electrons inside the frame"),
    Column(name="snr", dtype="f8", unit="", text="matched-filter S/N, noise variance without the object"),
    Column(name="psf_sigma_px", dtype="f8", unit="pix", text="effective PSF sigma, defocus included"),
    Column(name="defocus_px", dtype="f8", unit="pix", text="diameter of the defocus disc"),
    Column(name="sagitta_px", dtype="f8", unit="pix", text="height of the arc over its chord, signed"),
    Column(name="gradient", dtype="f8", unit="", text="relative brightness change from end 0 to end 1"),
    Column(name="rate_deg_s", dtype="f8", unit="deg / s", text="apparent rate against the camera frame at mid-trail"),
    Column(name="range_km", dtype="f8", unit="km", text="distance at mid-trail, NaN for a path over pixels"),
    Column(name="mag", dtype="f8", unit="mag", text="apparent V at mid-trail"),
    Column(name="ra_app_deg", dtype="f8", unit="deg", text="apparent right ascension of mid-trail"),
    Column(name="dec_app_deg", dtype="f8", unit="deg", text="apparent declination of mid-trail"),
    Column(name="n_saturated", dtype="i4", unit="", text="pixels of the trail at saturation"),
    Column(name="path_row", dtype=("f8", _PATH), unit="pix", text="row at equal time steps"),
    Column(name="path_col", dtype=("f8", _PATH), unit="pix", text="col at equal time steps"),
    Column(
        name="path_flux_e_s",
        dtype=("f8", _PATH),
        unit="electron / s",
        text="detected electrons per second of true time, mean over half a step on each side",
    ),
    Column(name="path_t_tai_ns", dtype=("i8", _PATH), unit="ns", text="true epochs of the nodes"),
    Column(name="path_ra_deg", dtype=("f8", _PATH), unit="deg", text="published right ascension of the nodes"),
    Column(name="path_dec_deg", dtype=("f8", _PATH), unit="deg", text="published declination of the nodes"),
)

OBJECTS: Final = (
    Column(name="object_id", dtype="i4", unit="", text="index"),
    Column(name="name", dtype="U32", unit="", text="name or designation"),
    Column(name="kind", dtype="U16", unit="", text="population, tle, orbit, sky_path, pixel_path"),
    Column(name="size_m", dtype="f8", unit="m", text="diameter"),
    Column(name="albedo", dtype="f8", unit="", text="Bond albedo of a Lambert sphere"),
    Column(name="a_km", dtype="f8", unit="km", text="semi-major axis, osculating at the first frame"),
    Column(name="e", dtype="f8", unit="", text="eccentricity"),
    Column(name="i_deg", dtype="f8", unit="deg", text="inclination"),
    Column(name="weight", dtype="f8", unit="", text="objects in nature that this drawn one stands for"),
    Column(
        name="range_km",
        dtype="f8",
        unit="km",
        text="distance at its first truth streak, NaN if never in a frame or a path over pixels",
    ),
)

FRAMES: Final = (
    Column(name="frame", dtype="i4", unit="", text="frame number"),
    Column(name="t_start_true_tai_ns", dtype="i8", unit="ns", text="true start of exposure of row 0"),
    Column(name="t_start_clock_tai_ns", dtype="i8", unit="ns", text="the same as the on-board clock reads it"),
    Column(name="exposure_ns", dtype="i8", unit="ns", text="exposure of each row"),
    Column(name="line_time_ns", dtype="i8", unit="ns", text="signed line time"),
    Column(name="q_true", dtype=("f8", (4,)), unit="", text="true attitude at mid-exposure of the middle row"),
    Column(name="position_m", dtype=("f8", (3,)), unit="m", text="true observer position, GCRS"),
    Column(name="velocity_m_s", dtype=("f8", (3,)), unit="m / s", text="true observer velocity, GCRS"),
    Column(name="grid_row", dtype=("f8", (81,)), unit="pix", text="9 x 9 grid of pixels"),
    Column(name="grid_col", dtype=("f8", (81,)), unit="pix", text="9 x 9 grid of pixels"),
    Column(name="grid_ra_app_deg", dtype=("f8", (81,)), unit="deg", text="true apparent direction, mean over the exposure"),
    Column(name="grid_dec_app_deg", dtype=("f8", (81,)), unit="deg", text="true apparent direction, mean over the exposure"),
    Column(name="sky_e_px", dtype="f8", unit="electron", text="mean sky per pixel"),
    Column(name="noise_e", dtype="f8", unit="electron", text="median noise sigma per pixel without sources"),
    Column(name="entropy_bits", dtype="f8", unit="bit", text="mean entropy of a pixel given the noise-free image"),
    Column(name="n_cosmics", dtype="i4", unit="", text="particle hits"),
    Column(name="zero_point_mag", dtype="f8", unit="mag", text="V of 1 e-/s on axis for a solar colour"),
)

STARS: Final = (
    Column(name="frame", dtype="i4", unit="", text="frame number"),
    Column(name="star_id", dtype="i8", unit="", text="catalogue identifier, negative for synthetic stars"),
    Column(name="row", dtype="f8", unit="pix", text="PSF centre, mean over the exposure"),
    Column(name="col", dtype="f8", unit="pix", text="PSF centre, mean over the exposure"),
    Column(name="flux_e", dtype="f8", unit="electron", text="noise-free electrons in the frame"),
    Column(name="v_mag", dtype="f4", unit="mag", text="V"),
    Column(name="b_v", dtype="f4", unit="mag", text="B-V"),
)

COSMICS: Final = (
    Column(name="frame", dtype="i4", unit="", text="frame number"),
    Column(name="row0", dtype="f4", unit="pix", text="entry"),
    Column(name="col0", dtype="f4", unit="pix", text="entry"),
    Column(name="row1", dtype="f4", unit="pix", text="exit"),
    Column(name="col1", dtype="f4", unit="pix", text="exit"),
    Column(name="charge_e", dtype="f4", unit="electron", text="electrons left inside the frame"),
)

EXTERNAL: Final = (
    Column(name="frame", dtype="i4", unit="", text="frame number in products/frames.ecsv; or give file"),
    Column(name="file", dtype="U64", unit="", text="name of the FITS file of the frame; or give frame"),
    Column(name="hdu", dtype="i4", unit="", text="header-data unit in that file; needed where a file holds several frames"),
    Column(name="object", dtype="U32", unit="", text="name or number of the object, the same in all its frames"),
    Column(name="row0", dtype="f8", unit="pix", text="PSF centre at shutter open; may lie outside the frame"),
    Column(name="col0", dtype="f8", unit="pix", text="PSF centre at shutter open; may lie outside the frame"),
    Column(name="row1", dtype="f8", unit="pix", text="PSF centre at shutter close; may lie outside the frame"),
    Column(name="col1", dtype="f8", unit="pix", text="PSF centre at shutter close; may lie outside the frame"),
    Column(name="row_mid", dtype="f8", unit="pix", text="PSF centre at mid-exposure, for curved trails"),
    Column(name="col_mid", dtype="f8", unit="pix", text="PSF centre at mid-exposure, for curved trails"),
    Column(name="flux_e", dtype="f8", unit="electron", text="noise-free electrons from shutter open to shutter close"),
    Column(name="mag", dtype="f8", unit="mag", text="apparent V at mid-exposure"),
    Column(name="snr", dtype="f8", unit="", text="matched-filter S/N of the part inside the frame"),
    Column(name="psf_sigma_px", dtype="f8", unit="pix", text="effective PSF sigma"),
    Column(name="ra0_deg", dtype="f8", unit="deg", text="published right ascension at shutter open"),
    Column(name="dec0_deg", dtype="f8", unit="deg", text="published declination at shutter open"),
    Column(name="ra1_deg", dtype="f8", unit="deg", text="published right ascension at shutter close"),
    Column(name="dec1_deg", dtype="f8", unit="deg", text="published declination at shutter close"),
    Column(name="range_km", dtype="f8", unit="km", text="distance at mid-exposure"),
)
"""Truth from elsewhere in one table, a row for each trail; frames of the run that it does not name hold no object."""

EXTERNAL_REQUIRED: Final = ("object", "row0", "col0", "row1", "col1")
"""Columns that an external table must have, besides frame or file; every other is optional, cell by cell."""

TABLES: Final = {"frames": FRAMES, "stars": STARS, "streaks": STREAKS, "cosmics": COSMICS, "objects": OBJECTS}


def dtype_of(table: str) -> np.dtype[np.void]:
    """Structured dtype of a truth table."""
    return np.dtype([(c.name, *c.dtype) if isinstance(c.dtype, tuple) else (c.name, c.dtype) for c in TABLES[table]])


def empty(table: str, length: int = 0) -> NDArray[np.void]:
    """A zeroed truth table."""
    return np.zeros(length, dtype=dtype_of(table))


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTruth:
    """Truth of one frame: one row of FRAMES, any number of rows of the others."""

    frame: NDArray[np.void]
    stars: NDArray[np.void]
    streaks: NDArray[np.void]
    cosmics: NDArray[np.void]
