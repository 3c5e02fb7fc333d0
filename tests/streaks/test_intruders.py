"""Light of other sources on a trail: which pixels are masked, and how many seeds are looked at for it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

from ground.streaks import TrailedPsfFitter
from ground.streaks.centre_line import LineFit, uniform_trail
from ground.streaks.intruders import (
    CLEAN_SIGMAS,
    MOST_MASKED,
    POINT_REACH,
    intruder_mask,
    mask_sources,
    point_source_snr,
    profile_by_distance,
)
from ground.streaks.trail_frame import TrailFrame
from ground.streaks.trail_model import N_PARAMETERS
from ground.streaks.trail_pixels import TrailPixels
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakPixels
from sboc_e2e.icd.signals import Detection

WIDTH_PX, LENGTH_PX, REACH_PX = 1.3, 300, 12
Array = NDArray[np.float64]


def pixels() -> tuple[Array, Array, NDArray[np.bool_]]:
    """Places along and across of the pixels about a line, by ascending u, and which of them lie on the trail."""
    u, v = (part.ravel().astype(np.float64) for part in np.mgrid[:LENGTH_PX, -REACH_PX : REACH_PX + 1])
    return u, v, np.abs(v) < 1.5 * WIDTH_PX


def masked(residual_e: Array, most: float) -> tuple[NDArray[np.bool_], float, int, int]:
    """Mask, share of the trail masked, seeds looked at and seeds, of residuals in units of the noise."""
    u, v, inside = pixels()
    seeds = np.flatnonzero(residual_e > 1.5)
    mask = np.zeros(u.size, dtype=np.bool_)
    noise = np.ones(u.size)
    share, looked = mask_sources(mask, seeds, np.full(seeds.size, 4.2), u, v, residual_e, noise, WIDTH_PX, inside, most)
    return mask, share, looked, seeds.size


def test_a_trail_that_is_masked_all_along_is_known_from_a_tenth_of_its_seeds() -> None:
    """The time of nebulae and crowded fields, where every pixel is a seed, went into seeds whose masks were thrown away."""
    u, _, inside = pixels()
    mask, share, looked, seeds = masked(np.full(u.size, 20.0), MOST_MASKED)
    assert seeds == u.size
    assert looked < 0.1 * seeds
    assert share > MOST_MASKED
    assert share == float(mask[inside].mean())


def test_each_source_is_masked_to_where_it_falls_below_the_noise() -> None:
    """As disc by disc about every seed whose matched-filter S/N is above what is needed."""
    u, v, inside = pixels()
    rng = np.random.default_rng(5)
    residual = rng.normal(size=u.size)
    for place, offset, light in ((40.0, 1.0, 12.0), (120.0, -6.0, 40.0), (121.5, 3.0, 9.0), (280.0, 0.0, 200.0)):
        residual += light * np.exp(-0.5 * ((u - place) ** 2 + (v - offset) ** 2) / WIDTH_PX**2)
    expected = np.zeros(u.size, dtype=np.bool_)
    for i in np.flatnonzero(residual > 1.5):
        r2 = (u - u[i]) ** 2 + (v - v[i]) ** 2
        weight = np.where(r2 < (3.0 * WIDTH_PX) ** 2, np.exp(-0.5 * r2 / WIDTH_PX**2), 0.0)
        snr = float(weight @ residual) / math.sqrt(float(weight @ weight))
        if snr > 4.2:
            peak = snr / (math.sqrt(math.pi) * WIDTH_PX)
            expected |= r2 < 2.0 * WIDTH_PX**2 * math.log(max(peak / CLEAN_SIGMAS, 2.0))
    mask, share, looked, seeds = masked(residual, 1.0)
    assert looked == seeds
    assert expected.any()
    np.testing.assert_array_equal(mask, expected)
    assert share == float(expected[inside].mean())


def test_the_mask_does_not_hang_on_the_order_of_the_pixels() -> None:
    """Pixels are ordered along the detection, and a fit turns its line: some are out of order along that, and were searched as
    if they were not."""
    u, v, _ = pixels()
    u -= 0.5 * LENGTH_PX
    rng = np.random.default_rng(6)
    variance = np.full(u.size, 9.0)
    value = rng.normal(0.0, 3.0, u.size) + 300.0 * np.exp(-0.5 * ((u - 20.0) ** 2 + (v - 4.0) ** 2) / WIDTH_PX**2)
    given = TrailPixels(
        frame=TrailFrame(row=100.0, col=200.0, cos=1.0, sin=0.0),
        u=u,
        v=v,
        value_e=value,
        variance_e2=variance,
        index=np.arange(u.size),
    )
    half_px = 0.4 * LENGTH_PX
    line = LineFit(
        pixels=given,
        parameters=uniform_trail(5.0, half_px, (False, False), WIDTH_PX),
        covariance=np.zeros((N_PARAMETERS, N_PARAMETERS)),
        half_px=half_px,
        blur_px=(0.5, 0.5),
        free=(),
        chi2=math.nan,
        snr=10.0,
        n_pixels=u.size,
    )
    mask, _ = intruder_mask(line, WIDTH_PX, line.blur_px)
    assert 20 < mask.sum() < 200
    turned = np.argsort(u + 0.3 * v, kind="stable")
    np.testing.assert_array_equal(
        intruder_mask(replace(line, pixels=given.take(turned)), WIDTH_PX, line.blur_px)[0], mask[turned]
    )


def test_the_signal_of_a_point_source_is_that_of_its_profile_at_every_distance() -> None:
    """Squared distances of pixels are whole numbers in turned axes too: a table of the profile is exact."""
    rng = np.random.default_rng(2)
    row, col = (part.ravel().astype(np.float64) for part in np.mgrid[:60, :60])
    u, v = 0.28 * row + 0.96 * col, 0.96 * row - 0.28 * col
    order = np.argsort(u)
    u, v = u[order], v[order]
    precision, residual_e = rng.uniform(0.5, 2.0, u.size), rng.normal(size=u.size)
    for width in (0.9, 2.3, 8.0):
        i, reach = 1700, POINT_REACH * width
        r2 = (u - u[i]) ** 2 + (v - v[i]) ** 2
        weight = np.where(r2 < reach**2 - 1e-9, np.exp(-0.5 * r2 / width**2), 0.0)
        exact = np.sum(weight * residual_e * precision) / math.sqrt(np.sum(weight**2 * precision))
        found = point_source_snr(i, u, v, residual_e * precision, precision, profile_by_distance(width), reach)
        assert math.isclose(found, exact, rel_tol=1e-9)


def test_a_trail_across_a_cluster_is_fitted_to_its_own_light() -> None:
    """Stars of up to 200 times its brightness cover more than a third of it. They count as sources on it, and pull nothing."""
    rng = np.random.default_rng(14)
    rows, cols = 60, 600
    row, col = (part.astype(np.float64) for part in np.mgrid[:rows, :cols])
    lit = 0.5 * (erf((col - 60.0) / 2.8) - erf((col - 540.0) / 2.8))
    light = 100.0 * np.exp(-0.5 * ((row - 30.0) / 2.0) ** 2) * lit
    for place, peak in zip(rng.uniform(80.0, 520.0, 11), np.geomspace(800.0, 20000.0, 11), strict=True):
        r2 = (row - 30.0 - rng.normal(0.0, 3.0)) ** 2 + (col - place) ** 2
        light += peak * (1.0 + r2 / 24.0) ** -3.5
    value = light + rng.normal(0.0, 15.0, light.shape) + rng.normal(0.0, 1.0, light.shape) * np.sqrt(light)
    seen = StreakPixels(
        row=row.ravel().astype(np.int32),
        col=col.ravel().astype(np.int32),
        value_e=value.ravel().astype(np.float32),
        variance_e2=np.full(row.size, 225.0, np.float32),
        psf_sigma_px=1.9,
        frame_shape=(rows, cols),
    )
    snr = 100.0 / 15.0 * math.sqrt(480.0 * 2.0 * math.sqrt(math.pi))
    detection = Detection(row0=30.5, col0=63.0, row1=29.6, col1=536.0, snr=snr, flags=StreakFlag(0))
    fit = TrailedPsfFitter().fit(seen, detection)
    assert fit.flags & StreakFlag.CROSSES_STAR
    assert abs(fit.row0 - 30.0) < 0.5
    assert abs(fit.row1 - 30.0) < 0.5
    assert abs(fit.col0 - 60.0) < 2.0
    assert abs(fit.col1 - 540.0) < 2.0
    assert fit.flux_e == pytest.approx(100.0 * 2.0 * math.sqrt(2.0 * math.pi) * 480.0, rel=0.15)
