"""The PSF's run over the field is read from fluxes and S/N of a star list, whatever sigma the extractor divided by."""

from dataclasses import replace

import numpy as np
import pytest

from ground.photometry.psf_width import growth_of, with_star_list
from ground.streaks.psf_field import PsfField
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.icd.signals import BackgroundModel, StarList
from tests.astrometry.star_fields import make_field

SIGMA_ADU = 2.5


def _frame(growth: float, sigma_used: float, n: int = 250) -> tuple[DownlinkFrame, NominalCamera]:
    """Stars whose S/N follows from a Gaussian PSF of growing width, in the steps that packets have."""
    field = make_field(StarCatalogue.embedded(), 0)
    camera = field.calibration.camera
    rng = np.random.default_rng(4)
    row, col = rng.uniform(0.0, 4095.0, (2, n))
    r2 = ((row - camera.center_row) ** 2 + (col - camera.center_col) ** 2) / (2.0 * 2048.0**2)
    width = camera.psf_sigma_px * (1.0 + growth * r2)
    flux = np.sort(10.0 ** rng.uniform(3.5, 5.5, n))[::-1]
    snr = flux / (sigma_used * np.sqrt(4.0 * np.pi * (width**2 + 1.0 / 12.0)))
    snr = 2.0 ** (np.rint(16.0 * np.log2(snr + 1.0)) / 16.0) - 1.0
    snr[:12] *= 0.5  # blends
    background = BackgroundModel(tile_px=128, level_adu=np.full((32, 32), 5.0), sigma_adu=np.full((32, 32), SIGMA_ADU))
    stars = StarList(row=row, col=col, flux_e=flux, snr=snr, flags=np.zeros(n))
    return replace(field.frame, stars=stars, background=background), camera


@pytest.mark.parametrize("growth", [0.0, 0.15, 0.4])
@pytest.mark.parametrize("sigma_used", [SIGMA_ADU, 1.3 * SIGMA_ADU])
def test_growth_towards_the_corner_is_found(growth, sigma_used):
    frame, camera = _frame(growth, sigma_used)
    # 3.5 % at the corner, with a wrong sigma bending it a little through the pixel's own share
    assert abs(growth_of(frame, camera.center_row, camera.center_col) - growth) < 0.035
    field = with_star_list(PsfField.nominal(camera.psf_sigma_px, (4096, 4096)), frame)
    assert abs(field.sigma_px(0.0, 0.0) / field.sigma_px(2047.5, 2047.5) - (1.0 + growth)) < 0.05
    assert abs(field.sigma_px(2047.5, 2047.5) / camera.psf_sigma_px - 1.0) < 1e-9


def test_few_stars_or_no_background_say_nothing():
    frame, camera = _frame(0.4, SIGMA_ADU, n=20)
    field = PsfField.nominal(camera.psf_sigma_px, (4096, 4096))
    assert with_star_list(field, frame) is field
    frame, camera = _frame(0.4, SIGMA_ADU)
    assert with_star_list(field, replace(frame, background=None)) is field
