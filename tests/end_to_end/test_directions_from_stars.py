"""`sboc process --wcs solve`: directions from the stars of a frame alone, of which nothing is told but the camera."""

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, SkyCoord
from astropy.io import fits
from astropy.table import Table
from astropy.time import Time
from astropy.wcs import WCS

from sboc_e2e import cli
from sboc_e2e.catalogue import StarCatalogue

SIDE_PX, PIXEL_DEG, SIGMA_PX = 512, float(np.degrees(72e-6 / 0.4)), 1.1
"""Of the preset `smoke_wide`: pixels of 72 um behind 0.4 m."""

EPOCH = "2027-01-29T00:00:00"
TRAIL = (230.0, 180.0, 290.0, 330.0)


def sky(ra_deg: float, dec_deg: float, roll_deg: float) -> WCS:
    """A tangential projection whose rows, columns and line of sight are right-handed, as in a camera (not mirrored)."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [ra_deg, dec_deg]
    wcs.wcs.crpix = [0.5 * (SIDE_PX + 1)] * 2
    cos, sin = np.cos(np.radians(roll_deg)), np.sin(np.radians(roll_deg))
    wcs.wcs.cd = PIXEL_DEG * np.array([[cos, -sin], [sin, cos]])
    return wcs


def star_field(wcs: WCS) -> np.ndarray:
    """Stars of the catalogue to V = 9.5 as Gaussians, and one trail."""
    rng = np.random.default_rng(5)
    stars = StarCatalogue.embedded().cone(*wcs.wcs.crval, 4.5, epoch_jyear=2027.1)
    stars = stars.take(stars.v_mag < 9.5)
    col, row = wcs.world_to_pixel_values(stars.ra_deg, stars.dec_deg)
    spots = list(zip(row, col, 4000.0 * 10.0 ** (-0.4 * (stars.v_mag - 9.0)), strict=True))
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


def test_the_stars_of_a_frame_tell_where_it_looked(tmp_path: Path) -> None:
    pytest.importorskip("tetra3rs", reason="the extra `solve` is not installed")
    wcs = sky(130.0, 19.5, 35.0)
    hdu = fits.PrimaryHDU(np.clip(np.rint(star_field(wcs)), 0, 65535).astype(np.uint16))
    hdu.header.update({"DATE-OBS": EPOCH, "EXPTIME": 0.2, "GAIN": 1.0, "RDNOISE": 3.0})
    hdu.writeto(tmp_path / "field.fits")
    out = tmp_path / "out"
    assert cli.run(["process", str(tmp_path / "field.fits"), "--out", str(out), "--wcs", "solve", "--camera", "smoke_wide"]) == 0
    frames, streaks = (Table.read(out / "products" / f"{name}.ecsv", format="ascii.ecsv") for name in ("frames", "streaks"))
    assert np.asarray(frames["solved"]).all()
    ends = np.array([streaks[name] for name in ("row0", "col0", "row1", "col1")], dtype=float).T
    away_px = np.abs(ends - TRAIL).max(axis=1)
    streak = streaks[int(np.argmin(away_px))]
    assert away_px.min() < 3.0, "the trail"
    # Published directions keep annual aberration (DESIGN: apparent minus that of the geocentric velocity): GCRS, not ICRS.
    ra, dec = wcs.pixel_to_world_values(streak["col_mid"], streak["row_mid"])
    seen = SkyCoord(ra, dec, unit="deg").transform_to(GCRS(obstime=Time(EPOCH, scale="utc")))
    measured = SkyCoord(streak["ra_mid_deg"], streak["dec_mid_deg"], unit="deg")
    away = SkyCoord(seen.ra, seen.dec).separation(measured)
    assert away < 0.2 * PIXEL_DEG * u.deg, f"{away.to(u.arcsec):.1f}"
