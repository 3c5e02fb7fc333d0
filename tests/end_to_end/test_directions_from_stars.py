"""`sboc process --wcs solve`: directions, parity and scale from the stars of a frame alone."""

from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, SkyCoord
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time
from astropy.wcs import WCS

from ground.astrometry import lost_in_space
from ground.astrometry.camera import Camera
from ground.astrometry.wcs_export import pixel_icrs, sip_header
from sboc_e2e import cli
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader

SIDE_PX, PIXEL_DEG, SIGMA_PX = 512, float(np.degrees(72e-6 / 0.4)), 1.1
"""Of the preset `smoke_wide`: pixels of 72 um behind 0.4 m."""

EPOCH = "2027-01-29T00:00:00"
TRAIL = (230.0, 180.0, 290.0, 330.0)

needs_solver = pytest.mark.skipif(not lost_in_space.installed(), reason="the extra `solve` is not installed")


def sky(ra_deg: float, dec_deg: float, roll_deg: float, *, mirrored: bool, pixel_deg: float) -> WCS:
    """A tangential projection; mirrored: rows, columns and line of sight are left-handed (north up, east to the left)."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [ra_deg, dec_deg]
    wcs.wcs.crpix = [0.5 * (SIDE_PX + 1)] * 2
    cos, sin = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    wcs.wcs.cd = pixel_deg * np.array([[cos, -sin], [sin, cos]]) @ np.diag([-1.0 if mirrored else 1.0, 1.0])
    return wcs


def star_field(wcs: WCS, v_max: float) -> np.ndarray:
    """Stars of the catalogue as Gaussians, and one trail."""
    rng = np.random.default_rng(5)
    stars = StarCatalogue.embedded().cone(*wcs.wcs.crval, 9.0, epoch_jyear=2027.1)
    stars = stars.take(stars.v_mag < v_max)
    col, row = wcs.world_to_pixel_values(stars.ra_deg, stars.dec_deg)
    spots = list(zip(row, col, 2500.0 * 10.0 ** (-0.4 * (stars.v_mag - v_max)), strict=True))
    share = np.linspace(0.0, 1.0, 800)
    spots += [(TRAIL[0] + s * (TRAIL[2] - TRAIL[0]), TRAIL[1] + s * (TRAIL[3] - TRAIL[1]), 50.0) for s in share]
    image = np.full((SIDE_PX, SIDE_PX), 100.0)
    grid = np.mgrid[-8:9, -8:9].astype(float)
    for r, c, flux in spots:
        near = round(float(r)), round(float(c))
        if all(8 <= n < SIDE_PX - 8 for n in near):
            part = np.s_[near[0] - 8 : near[0] + 9, near[1] - 8 : near[1] + 9]
            distance2 = (grid[0] + near[0] - r) ** 2 + (grid[1] + near[1] - c) ** 2
            image[part] += flux / (2.0 * np.pi * SIGMA_PX**2) * np.exp(-0.5 * distance2 / SIGMA_PX**2)
    return rng.poisson(image) + rng.normal(0.0, 3.0, image.shape)


def written(folder: Path, image: np.ndarray, **keys: float) -> str:
    hdu = fits.PrimaryHDU(np.clip(np.rint(image), 0, 65535).astype(np.uint16))
    hdu.header.update({"DATE-OBS": EPOCH, "EXPTIME": 0.2, "GAIN": 1.0, "RDNOISE": 3.0, **keys})
    hdu.writeto(folder / "field.fits")
    return str(folder / "field.fits")


def solved_wcs(frame: Table.Row) -> WCS:
    """The world coordinates of a row of products/frames.ecsv, by the program's own export."""
    quaternion = np.array([frame[name] for name in ("qx", "qy", "qz", "qw")])
    camera = Camera(**{field.name: frame[field.name] for field in fields(Camera)})
    solution = SimpleNamespace(flags=FrameFlag(0), quaternion=quaternion, camera=camera)
    header = FrameHeader(
        frame=0,
        t_start_tai_ns=int(frame["t_start_tai_ns"]),
        exposure_ns=round(1e9 * float(frame["exposure_s"])),
        line_time_ns=0,
        rows=int(frame["rows"]),
        cols=int(frame["cols"]),
    )
    return WCS(sip_header(pixel_icrs(header, solution), header.rows, header.cols))  # type: ignore[arg-type]


@needs_solver
@pytest.mark.parametrize(
    ("mirrored", "camera", "keys"),
    [
        (False, ["--camera", "smoke_wide"], {}),
        (True, ["--camera", "smoke_wide"], {}),
        (True, [], {"FOCALLEN": 210.0, "XPIXSZ": 72.0, "XBINNING": 2}),
        (True, [], {}),
        (False, [], {"PIXSCALE": 80.0}),
    ],
    ids=["camera", "mirrored", "mirrored, optics in the header", "mirrored, nothing known", "scale in the header 8 % off"],
)
@pytest.mark.slow
def test_the_stars_of_a_frame_tell_where_it_looked(
    tmp_path: Path, mirrored: bool, camera: list[str], keys: dict[str, float]
) -> None:
    # wider fields, whose databases take less time to make, where the scale is to be found too
    pixel_deg, v_max = (PIXEL_DEG, 9.5) if camera else (2.0 * PIXEL_DEG, 8.0)
    wcs = sky(130.0, 19.5, 35.0, mirrored=mirrored, pixel_deg=pixel_deg)
    path, out = written(tmp_path, star_field(wcs, v_max), **keys), tmp_path / "out"
    assert cli.run(["process", path, "--out", str(out), "--wcs", "solve", *camera]) == 0
    frames, stars, streaks = (
        Table.read(out / "products" / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "stars", "streaks")
    )
    assert np.asarray(frames["solved"]).all()
    assert bool(frames["mirrored"][0]) == mirrored
    # annual aberration alone changes the scale by up to 1e-4
    assert frames["focal_px"][0] == pytest.approx(1.0 / np.radians(pixel_deg), rel=3e-4)
    found = solved_wcs(frames[0])
    assert np.sign(np.linalg.det(found.wcs.cd)) == np.sign(np.linalg.det(wcs.wcs.cd))
    named = stars[np.isfinite(np.asarray(stars["v_mag"], dtype=float))]
    assert len(named) > 50
    col, row = np.asarray(named["col"], dtype=float), np.asarray(named["row"], dtype=float)
    there, here = (SkyCoord(*w.pixel_to_world_values(col, row), unit="deg") for w in (wcs, found))
    assert there.separation(here).deg.max() < 0.1 * pixel_deg
    ends = np.array([streaks[name] for name in ("row0", "col0", "row1", "col1")], dtype=float).T
    away_px = np.abs(ends - TRAIL).max(axis=1)
    streak = streaks[int(np.argmin(away_px))]
    assert away_px.min() < 3.0, "the trail"
    # Published directions keep annual aberration (DESIGN: apparent minus that of the geocentric velocity): GCRS, not ICRS.
    ra, dec = wcs.pixel_to_world_values(streak["col_mid"], streak["row_mid"])
    seen = SkyCoord(ra, dec, unit="deg").transform_to(GCRS(obstime=Time(EPOCH, scale="utc")))
    measured = SkyCoord(streak["ra_mid_deg"], streak["dec_mid_deg"], unit="deg")
    away = SkyCoord(seen.ra, seen.dec).separation(measured)
    assert away < 0.2 * pixel_deg * u.deg, f"{away.to(u.arcsec):.1f}"


@needs_solver
@pytest.mark.parametrize("keys", [{}, {"PIXSCALE": 1.0}], ids=["nothing known", "narrow field"])
def test_an_unknown_camera_whose_stars_fit_nothing_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], keys: dict[str, float]
) -> None:
    path = written(tmp_path, np.random.default_rng(1).normal(100.0, 3.0, (128, 128)), **keys)
    assert cli.run(["process", path, "--out", str(tmp_path / "out"), "--wcs", "solve"]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
    assert "give --camera, or PIXSCALE (arcsec) in the headers" in line
    assert not (tmp_path / "out").exists()
