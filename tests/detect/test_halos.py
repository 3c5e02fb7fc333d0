"""Halos are masked as far as they are bright, subtracted beyond, and not imagined where a star has none."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from onboard.detect.line_integral import halos, static_sky
from onboard.image import registration
from sboc_e2e.icd.signals import StarList
from sboc_e2e.icd.work import WorkMeter

SIZE, MIDDLE, CORE_PX = 241, 120.0, 5.0
SIGMA_E = 2.84


def radius() -> NDArray[np.float64]:
    """Distance of every pixel from the middle."""
    d = np.arange(SIZE) - MIDDLE
    return np.hypot(d[:, None], d)


def one_star(snr: float = 1e5) -> StarList:
    one = np.array([1.0])
    return StarList(row=MIDDLE * one, col=MIDDLE * one, flux_e=one, snr=np.array([snr], np.float32), flags=np.zeros(1, np.uint8))


def taken_out(light_sigma: NDArray[np.float64], seed: int = 1) -> tuple[NDArray[np.int8], NDArray[np.uint8], halos.Halos]:
    """A noisy image of light around one star, whose core is masked, after its halo was taken out; the mask; the halo."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(light_sigma.shape) * np.sqrt(1.0 + light_sigma / SIGMA_E)
    image = np.clip(np.rint(16.0 * (light_sigma + noise)), -127, 127).astype(np.int8)
    blocked = (radius() <= CORE_PX).astype(np.uint8)
    left = halos.take_out(image, blocked, one_star(), np.array([0]), np.array([CORE_PX]), SIGMA_E, WorkMeter())
    return image, blocked, left


def aureole() -> NDArray[np.float64]:
    """Light of 1 sigma at 20 px that falls as r^-3."""
    return (20.0 / np.maximum(radius(), 3.0)) ** 3


def test_halo_is_masked_where_it_is_bright_and_subtracted_beyond() -> None:
    image, blocked, left = taken_out(aureole())
    assert 19.0 < math.sqrt(np.count_nonzero(blocked) / math.pi) < 24.0
    for inner, outer in ((24.0, 30.0), (30.0, 40.0), (40.0, 60.0)):
        ring = (radius() > inner) & (radius() < outer)
        assert abs(image[ring].mean() / 16.0) < 0.1
        assert image[ring].std() / 16.0 == pytest.approx(1.0, abs=0.05)
    assert left.light[0, 0] / 16.0 == pytest.approx(1.0, abs=0.3)


def test_star_without_a_halo_and_a_bled_column_hide_nothing_more() -> None:
    column = np.zeros((SIZE, SIZE))
    column[70:170, 118:122] = 1000.0
    _, blocked, left = taken_out(column)
    assert math.sqrt(np.count_nonzero(blocked) / math.pi) < CORE_PX + 0.2
    assert len(left.centre) == 0


def test_light_taken_from_a_segment_is_what_the_earlier_frame_still_shows() -> None:
    """The S/N of the subtracted light on a segment is that of the halo itself."""
    s_px, ends = 0.85, np.array([90.0, 145.0, 150.0, 145.0])
    _, blocked, left = taken_out(aureole())
    at_row, at_col, profile = static_sky.lit_pixels(blocked, 0, ends, s_px)
    halo = aureole()[at_row, at_col]
    expected = float(np.sum(profile * halo) / math.sqrt(np.sum(profile**2)))
    assert expected > 3.0
    assert halos.subtracted_snr(left, registration.IDENTITY, blocked, 0, ends, s_px) == pytest.approx(expected, rel=0.15)
    far = ends + np.array([0.0, 90.0, 0.0, 90.0])
    assert halos.subtracted_snr(left, registration.IDENTITY, blocked, 0, far, s_px) < 0.5
