"""Real frames of other telescopes (not part of the project; skipped with a reason when absent)."""

from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS

from sboc_e2e import cli
from sboc_e2e.icd.flags import StreakFlag
from tests.end_to_end.test_directions_from_stars import solved_wcs
from tests.validation.star_field import solve_field


def streaks(shared_data: Path, name: str, out: Path) -> Table:
    path = shared_data / "real" / name
    if not path.exists():
        pytest.skip(f"real frame not present: {path}")
    assert cli.run(["process", str(path), "--out", str(out)]) == 0
    return Table.read(out / "products" / "streaks.ecsv", format="ascii.ecsv")


def published(table: Table) -> Table:
    return table[(np.asarray(table["flags"]) & int(StreakFlag.VETOED)) == 0]


def test_a_streak_with_both_ends_inside_is_measured(shared_data: Path, tmp_path: Path) -> None:
    """SAAO, 512 x 512, one satellite of about 320 px; the eye puts its ends at (338, 22) and (310, 338)."""
    table = streaks(shared_data, "saao_ystar_one_streak.fits", tmp_path / "out")
    ends = np.array([table[name] for name in ("row0", "col0", "row1", "col1")]).T
    away_px = np.abs(ends - [338, 22, 310, 338]).max(axis=1)
    streak = table[np.argmin(away_px)]
    assert away_px.min() < 4.0
    assert 232.0 < streak["ra_mid_deg"] < 234.0
    assert not int(streak["flags"]) & (StreakFlag.EDGE0 | StreakFlag.EDGE1)
    assert not int(streak["flags"]) & StreakFlag.VETOED
    assert len(published(table)) == 1
    frames = Table.read(tmp_path / "out" / "products" / "frames.ecsv", format="ascii.ecsv")
    assert (frames["file"][0], int(frames["hdu"][0])) == ("saao_ystar_one_streak.fits", 0)


@pytest.mark.slow
def test_a_wide_defocused_streak_is_published_once_from_edge_to_edge(shared_data: Path, tmp_path: Path) -> None:
    """Subaru HSC, 400 x 400: one streak some 25 px wide from (400, 72) to (0, 217)."""
    table = streaks(shared_data, "hsc_wide_defocused_streak.fits", tmp_path / "out")
    (streak,) = published(table)
    assert streak["length_px"] > 300
    assert np.hypot(streak["row_mid"] - 200, streak["col_mid"] - 144) < 6.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["opd_control.fits", "sdss_control.fits", "gmos_stars_cosmics.fits"])
def test_frames_without_streaks_publish_none(shared_data: Path, tmp_path: Path, name: str) -> None:
    table = streaks(shared_data, name, tmp_path / "out")
    assert len(published(table)) == 0


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("name", ["Alt40_Azi-135", "Alt40_Azi45", "Alt60_Azi-45", "Alt60_Azi135"])
def test_a_real_star_field_is_solved_with_no_camera_given(shared_data: Path, tmp_path: Path, name: str, mirrored: bool) -> None:
    """ESA's tetra3 fields of 11.4 deg: places of the identified stars against a TAN-SIP fitted to the same image by astropy."""
    pytest.importorskip("tetra3rs", reason="the extra `solve` is not installed")
    (frame,) = (shared_data / "real").glob(f"*_{name}_Try1.tiff")
    solve_field(frame, tmp_path / "reference.fits")
    reference, image = WCS(fits.getheader(tmp_path / "reference.fits")), fits.getdata(tmp_path / "reference.fits")
    hdu = fits.PrimaryHDU(image[:, ::-1] if mirrored else image)
    hdu.header.update({"DATE-OBS": "2019-07-29T20:47:26", "EXPTIME": 0.2})
    hdu.writeto(tmp_path / "field.fits")
    assert cli.run(["process", str(tmp_path / "field.fits"), "--out", str(tmp_path / "out"), "--wcs", "solve"]) == 0
    frames, stars = (
        Table.read(tmp_path / "out" / "products" / f"{kind}.ecsv", format="ascii.ecsv") for kind in ("frames", "stars")
    )
    assert bool(frames["solved"][0])
    assert bool(frames["mirrored"][0]) == mirrored
    named = stars[np.isfinite(np.asarray(stars["v_mag"], dtype=float))]
    row, col = np.asarray(named["row"], dtype=float), np.asarray(named["col"], dtype=float)
    found = SkyCoord(*solved_wcs(frames[0]).pixel_to_world_values(col, row), unit="deg")
    there = SkyCoord(*reference.pixel_to_world_values(image.shape[1] - 1.0 - col if mirrored else col, row), unit="deg")
    away_px = found.separation(there).rad * frames["focal_px"][0]
    assert len(away_px) > 80
    assert away_px.max() < 1.0
    assert np.median(away_px) < 0.1


@pytest.mark.slow
def test_seventy_extensions_of_raw_cut_outs_are_seventy_frames(shared_data: Path, tmp_path: Path) -> None:
    """DECam, 100 x 100 each, tile-compressed; one wide streak in extension 33."""
    table = streaks(shared_data, "decam_raw_cutouts.fits.fz", tmp_path / "out")
    frames = Table.read(tmp_path / "out" / "products" / "frames.ecsv", format="ascii.ecsv")
    assert list(frames["hdu"]) == list(range(1, 71))
    assert len(published(table)) <= 14, "one published streak in five frames of material chosen to raise false alarms"
