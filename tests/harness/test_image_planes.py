"""Planes of a file that are no pictures: units of variances, and units of pictures that hold a square too."""

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from sboc_e2e.outside.fits_frames import FitsFolder, images_of
from sboc_e2e.outside.image_planes import is_square_of_light

VARIANCES = (
    "adu2", "ADU**2", "adu^2", "adu**(2)", "electron**2", "ELECTRONS^2", "electron2", "electrons2", "e-^2", "e-2", "(e-)**2",
    "count**2", "counts2", "ct2", "DN^2", "DN**2/s**2", "DN2 / s2", "(DN/s)^2", "adu2 s-2", "electron^2/s^2", "(electron/s)**2",
    "ELECTRONS**2/S**2", "nJy**2", "nJy2", "nmgy**2", "nmgy^2", "nanomaggy^2", "(MJy/sr)^2", "(MJy/sr)**2", "MJy2 / sr2",
    "Jy^2", "adu2/pix", "adu**2/pixel**2", "[adu^2]", "erg2 / (s2 cm4 Angstrom2)", "1E-34 erg2/s2/cm4/Angstrom2",
)  # fmt: skip
"""Astropy's CCDData and Gemini (adu2, electron2), LSST (adu**2, electron**2, nJy**2), JWST (DN2 / s2, MJy2 / sr2), SDSS."""

PICTURES = (
    "", "adu", "ADU", "counts", "COUNTS/S", "ELECTRONS", "ELECTRONS/S", "electron/s", "electron s-1", "DN/s", "DN s**-1", "nJy",
    "nanomaggy", "nmgy", "MJy/sr", "MJy sr-1", "Jy/beam", "JY/BEAM", "K", "K km/s", "mag", "mag/arcsec^2", "mag/arcsec**2",
    "nmgy/arcsec^2", "mJy/arcsec^2", "mJy/arcsec**2", "counts/s/arcsec^2", "e-/s/arcsec2", "W/m^2", "W/m**2/sr", "W m-2 sr-1",
    "erg/s/cm**2/Angstrom", "erg/cm**2/s", "erg/s/cm^2/A", "erg/cm2/s/Ang", "erg s-1 cm-2 Hz-1", "10**(-20)*erg/s/cm**2/Angstrom",
    "1E-17 erg/cm^2/s/Ang/spaxel", "10^-17 erg/s/cm^2", "photon/s/m2", "photons/cm**2/s", "cm^-2", "cm**(-2)", "1/arcsec^2",
    "arcsec^2", "km2/s2", "pix^2", "e-/pix^2", "counts/pixel**2", "DN/(s pix**2)", "electron/s**2", "adu**2/s",
)  # fmt: skip
"""HST (ELECTRONS/S, COUNTS/S, erg/cm**2/s/A), JWST (MJy/sr, DN/s), LSST (adu, nJy), SDSS and MaNGA (nanomaggy, 1E-17 erg/...),
radio (Jy/beam, K km/s), maps of surface brightness, of column density (cm^-2) and of velocity dispersion squared."""


@pytest.mark.parametrize("unit", VARIANCES)
def test_a_square_of_a_whole_unit_of_light_is_a_variance(unit: str) -> None:
    assert is_square_of_light(unit)
    assert is_square_of_light(f" {unit} ")


@pytest.mark.parametrize("unit", PICTURES)
def test_a_square_inside_a_unit_makes_no_variance(unit: str) -> None:
    assert not is_square_of_light(unit)


def image(unit: str) -> fits.ImageHDU:
    return fits.ImageHDU(
        np.random.default_rng(len(unit)).normal(9.0, 1.0, (48, 48)).astype(np.float32), fits.Header({"BUNIT": unit})
    )


@pytest.mark.parametrize("unit", ["erg/s/cm**2/Angstrom", "mJy/arcsec^2", "W/m^2", "electron**2"])
def test_the_only_image_of_a_file_is_a_picture_whatever_its_unit(tmp_path: Path, unit: str) -> None:
    fits.HDUList([fits.PrimaryHDU(), image(unit)]).writeto(tmp_path / "a.fits")
    (place,) = images_of(tmp_path / "a.fits")
    assert place.planes == ()


def test_two_pictures_whose_unit_holds_a_square_are_two_pictures(tmp_path: Path) -> None:
    fits.HDUList([fits.PrimaryHDU(), image("adu"), image("erg/s/cm**2/Angstrom"), image("adu**2")]).writeto(tmp_path / "a.fits")
    assert [(place.hdu, [plane.hdu for plane in place.planes]) for place in images_of(tmp_path / "a.fits")] == [(1, []), (2, [3])]
    assert [sourced.hdu for sourced in FitsFolder(path=tmp_path).frames()] == [1, 2]
