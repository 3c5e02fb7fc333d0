"""A line fitted to the pixels of many faint frames, against the analytic Cramér-Rao bound of Gaussian trails in white noise."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from ground.link.pixel_line import CrossedFrame, line_of_pixels
from ground.streaks.across import AcrossPixels
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels

Array = NDArray[np.float64]
PSF_PX, NOISE_E = 0.9, 10.0
WIDTH_PX = math.sqrt(PSF_PX**2 + 1.0 / 12.0)
BEND_SIGMA = 1e-6
"""Px per frame squared: none."""


def trail_fit(length: float, angle: float, flux_e: float) -> StreakFit:
    """A forced fit about the pixel (40, 40), that knows its ends to half a pixel and its place across to 0.5 px."""
    half = 0.5 * length * np.array([math.sin(angle), math.cos(angle)])
    return StreakFit(
        row0=40.0 - half[0], col0=40.0 - half[1], row1=40.0 + half[0], col1=40.0 + half[1], covariance_px2=0.25 * np.eye(4),
        end_interval_px=np.ones((2, 2)), sigma_cross_px=0.5, flux_e=flux_e, flux_err_e=flux_e / 4.0, snr=4.0, sagitta_px=0.0,
        sagitta_err_px=0.0, gradient=0.0, width_px=PSF_PX, width_err_px=0.1, chi2_nu=1.0, n_pixels=100, flags=StreakFlag(0),
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )  # fmt: skip


def exposed(rng: np.random.Generator, fit: StreakFit, flux_e: float, shift0: float, shift1: float, star_e: float) -> StreakPixels:
    """Pixels of a Gaussian trail whose ends lie so far across from those of the fit, and of a star 1.5 px beside its middle."""
    row, col = (x.ravel() for x in np.mgrid[0:81, 0:81].astype(np.float64))
    sin, cos = (fit.row1 - fit.row0) / fit.length_px, (fit.col1 - fit.col0) / fit.length_px
    u, v = (col - 40.0) * cos + (row - 40.0) * sin, (row - 40.0) * cos - (col - 40.0) * sin
    half = 0.5 * fit.length_px
    centre = 0.5 * (shift0 + shift1) + 0.5 * (shift1 - shift0) * u / half
    share = ndtr((u + half) / WIDTH_PX) - ndtr((u - half) / WIDTH_PX)
    light = flux_e / fit.length_px * share * np.exp(-0.5 * ((v - centre) / WIDTH_PX) ** 2) / (math.sqrt(2.0 * math.pi) * WIDTH_PX)
    light += star_e * np.exp(-0.5 * (u**2 + (v - 1.5) ** 2) / WIDTH_PX**2) / (2.0 * math.pi * WIDTH_PX**2)
    value = light + rng.normal(0.0, NOISE_E, row.size)
    return StreakPixels(
        row=row.astype(np.int32), col=col.astype(np.int32), value_e=value.astype(np.float32),
        variance_e2=np.full(row.size, NOISE_E**2, dtype=np.float32), psf_sigma_px=PSF_PX, frame_shape=(81, 81),
    )  # fmt: skip


def crossed(fit: StreakFit, pixels: StreakPixels, time: float) -> CrossedFrame:
    """The line's parameters are px across at time 0, px per frame, and px per frame squared; a trail lasts 0.8 of a frame."""
    across = AcrossPixels.of(fit, pixels)
    assert across is not None
    ends = time + np.array([-0.4, 0.4])
    rows = np.stack([np.ones(2), ends, 0.5 * ends**2], axis=1)
    to_place = np.array([[0.5, 0.5], [-0.5, 0.5]])
    return CrossedFrame(pixels=across, offset_px=np.zeros(2), by_line=to_place @ rows, variance_px2=np.zeros(2))


def group(rng: np.random.Generator, n: int, snr: float, star_e: float = 0.0) -> tuple[list[CrossedFrame], Array, Array]:
    """Frames of one object, the true line (3,) and its bound's covariance (3, 3) where bend is known."""
    length, angle = float(rng.uniform(10.0, 50.0)), float(rng.uniform(0.0, np.pi))
    # S/N^2 of a matched filter: density^2 L / (2 sqrt(pi) w noise^2)
    flux = snr * NOISE_E * math.sqrt(2.0 * math.sqrt(math.pi) * WIDTH_PX * length)
    true = np.array([rng.normal(0.0, 0.3), rng.normal(0.0, 0.05), 0.0])
    # of a place: density^2 L / (4 sqrt(pi) w^3 noise^2) = S^2 / (2 w^2); half of the tilt has a third of it
    place = snr**2 / (2.0 * WIDTH_PX**2)
    frames, information = [], np.diag([0.0, 0.0, BEND_SIGMA**-2])
    for k in range(n):
        time = k - 0.5 * (n - 1)
        fit = trail_fit(length, angle, flux * float(rng.uniform(0.8, 1.2)))
        light = flux * float(rng.normal(1.0, 0.1))
        shifts = true[0] + true[1] * (time + np.array([-0.4, 0.4]))
        frames.append(crossed(fit, exposed(rng, fit, light, *shifts.tolist(), star_e if k == n // 2 else 0.0), time))
        by_line = frames[-1].by_line
        information += place * (np.outer(by_line[0], by_line[0]) + np.outer(by_line[1], by_line[1]) / 3.0)
    return frames, true, np.asarray(np.linalg.inv(information))


@pytest.mark.parametrize(("n", "snr"), [(3, 5.0), (8, 3.5), (16, 3.0)])
def test_lines_through_pixels_reach_the_joint_bound_and_state_it(n: int, snr: float) -> None:
    """Groups from starts 0.5 px off: places and rates within 1.2 times the bound, pulls 0.8 to 1.2 (n = 300, 120)."""
    rng = np.random.default_rng(n)
    errors, pulls, lost = [], [], 0
    for _ in range(150 if n < 8 else 60):
        frames, true, bound = group(rng, n, snr)
        start = true + np.array([rng.choice([-0.5, 0.5]), 0.0, 0.0])
        line = line_of_pixels(frames, start, np.diag([0.0, 0.0, BEND_SIGMA**-2]), np.zeros(3))
        if line is None:
            lost += 1
            continue
        off = (line.parameters - true)[:2]
        errors += list(off / np.sqrt(np.diag(bound)[:2]))
        pulls += list(off / np.sqrt(np.diag(line.covariance)[:2]))
    assert lost <= 2
    assert float(np.sqrt(np.mean(np.square(errors)))) == pytest.approx(1.0, abs=0.2)
    assert float(np.sqrt(np.mean(np.square(pulls)))) == pytest.approx(1.0, abs=0.2)


def test_a_star_beside_one_frame_does_not_bend_the_line() -> None:
    """A star as bright as ten of its trails, 1.5 px beside the middle frame of nine."""
    rng = np.random.default_rng(3)
    pulls = []
    for _ in range(20):
        frames, true, _ = group(rng, 9, 4.0, star_e=4000.0)
        line = line_of_pixels(frames, true, np.diag([0.0, 0.0, BEND_SIGMA**-2]), np.zeros(3))
        assert line is not None
        pulls += list(((line.parameters - true) / np.sqrt(np.diag(line.covariance)))[:2])
    assert float(np.sqrt(np.mean(np.square(pulls)))) < 1.3


def test_frames_without_light_give_no_line() -> None:
    """Noise alone, darker than the sky: the caller keeps the line through places."""
    rng = np.random.default_rng(4)
    frames, true, _ = group(rng, 4, -8.0)
    assert line_of_pixels(frames, true, np.diag([0.0, 0.0, BEND_SIGMA**-2]), np.zeros(3)) is None
