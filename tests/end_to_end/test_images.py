"""Pixels that came down are in products/images, bit by bit those of the camera, with the solved camera's directions."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS

from sboc_e2e.run import RunDirectory
from tests.end_to_end.conftest import products_only, request, tiny

OVERRIDES = ("ground.products.images=all", "onboard.downlink.whole_frame_every=2", "onboard.downlink.thumbnail=16 px")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    folder = tmp_path_factory.mktemp("images")
    return products_only(request(tiny(folder), folder / "run", *OVERRIDES)).directory


def test_whole_frames_and_the_dark_give_the_camera_s_frames_back(made: RunDirectory) -> None:
    dark = fits.getdata(made.calibration / "dark.fits")
    for number in range(4):
        with fits.open(made.products / "images" / f"{number:06d}.fits") as hdus:
            names = [hdu.name for hdu in hdus]
            assert ("FRAME" in names) == (number % 2 == 0)
            assert "THUMBNAIL" in names
            if "FRAME" in names:
                assert np.array_equal(hdus["FRAME"].data + np.rint(dark), fits.getdata(made.frame_file(number)))


def test_images_look_where_the_frames_do(made: RunDirectory) -> None:
    frames = Table.read(made.products / "frames.ecsv")
    assert frames["solved"].all()
    for row in frames:
        with fits.open(made.products / "images" / f"{row['frame']:06d}.fits") as hdus:
            for hdu in hdus[1:]:
                wcs = WCS(hdu.header)
                # where the middle of the frame lies in the image; aberration moves it by at most 26 arcsec
                sides = ((1, "cols"), (2, "rows"))
                scale, shift = (
                    [hdu.header.get(key.format(k), other) for k, _ in sides]
                    for key, other in (("LTM{0}_{0}", 1.0), ("LTV{0}", 0.0))
                )
                here = [(0.5 * row[side] + 0.5) * m + v for (_, side), m, v in zip(sides, scale, shift, strict=True)]
                ra, dec = wcs.all_pix2world([here], 1)[0]
                assert abs(ra - row["ra_app_deg"]) < 0.02
                assert abs(dec - row["dec_app_deg"]) < 0.02
