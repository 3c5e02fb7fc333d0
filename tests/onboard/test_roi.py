"""ROI strips: they hold the streak's light, follow arcs, stay inside the frame, and never send a pixel twice."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from onboard.downlink import roi
from onboard.image.dark_map import DarkMap
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, strip_pixels

SHAPE = (400, 500)
SIGMA_PX = 0.897


def footprint(strips: tuple[roi.StripGeometry, ...], shape: tuple[int, int] = SHAPE) -> NDArray[np.int64]:
    """How often each pixel is sent."""
    counts = np.zeros(shape, dtype=np.int64)
    for g in strips:
        row, col = strip_pixels(g.axis, g.major0, g.minor0_fp, g.slope_fp, (g.n, g.width))
        inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
        np.add.at(counts, (row[inside], col[inside]), 1)
    return counts


def rendered(detection: Detection, shape: tuple[int, int] = SHAPE) -> NDArray[np.float64]:
    """Light of a trail of unit flux per px along its parabola, Gaussian PSF sampled at pixel centres."""
    fractions = (np.arange(2000) + 0.5) / 2000
    points = roi.arc_points(detection, fractions)
    row, col = np.indices(shape)
    image = np.zeros(shape)
    reach = 6
    for r, c in points:
        i0, i1, j0, j1 = int(r) - reach, int(r) + reach + 1, int(c) - reach, int(c) + reach + 1
        part = np.s_[max(i0, 0) : max(i1, 0), max(j0, 0) : max(j1, 0)]
        image[part] += np.exp(-0.5 * ((row[part] - r) ** 2 + (col[part] - c) ** 2) / SIGMA_PX**2)
    return image / image.sum()


ends = st.tuples(
    st.floats(0.0, SHAPE[0] - 1.0), st.floats(0.0, SHAPE[1] - 1.0), st.floats(0.0, SHAPE[0] - 1.0), st.floats(0.0, SHAPE[1] - 1.0)
)


@given(ends=ends, sagitta=st.floats(-6.0, 6.0), snr=st.floats(6.0, 200.0), room=st.integers(300, 8000))
def test_strips_hold_the_light_and_no_pixel_twice(
    ends: tuple[float, float, float, float], sagitta: float, snr: float, room: int
) -> None:
    """>= 99.5 % of the in-frame light inside, every pixel at most once."""
    length = math.hypot(ends[2] - ends[0], ends[3] - ends[1])
    sagitta = sagitta if length > 60.0 else 0.0
    detection = Detection(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=snr, sagitta_px=sagitta)
    margin = roi.end_margin_px(length, snr, SIGMA_PX, 3.0)
    strips = roi.plan_strips(detection, SHAPE, half_width_px=5.0 * SIGMA_PX, margins_px=(margin, margin), pixels_per_strip=room)
    counts = footprint(strips)
    assert counts.max() <= 1
    assert (rendered(detection) * (counts > 0)).sum() >= 0.995


@given(ends=ends)
def test_strips_lie_inside_the_frame_along_their_axis(ends: tuple[float, float, float, float]) -> None:
    """Lines never leave the frame, so that no packet carries lines of padding only."""
    detection = Detection(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=7.0)
    for g in roi.plan_strips(detection, SHAPE, half_width_px=4.5, margins_px=(30.0, 30.0), pixels_per_strip=4000):
        assert g.major0 >= 0
        assert g.major0 + g.n <= SHAPE[g.axis]
        assert g.n >= 1
        assert abs(g.slope_fp) <= 65536


def test_margin_follows_the_change_point_law() -> None:
    """Faint long trail: 3 x 5.1 L / S^2; bright one: 3 x the bound; both plus the light of the end."""
    ends_light = roi.LEAST_END_MARGIN_SIGMA * SIGMA_PX
    assert roi.end_margin_px(300.0, 8.0, SIGMA_PX, 3.0) == pytest.approx(3 * 5.099 * 300 / 64 + ends_light, rel=1e-3)
    bound = math.sqrt(2 * math.sqrt(math.pi) * SIGMA_PX * 20.0) / 50.0
    assert roi.end_margin_px(20.0, 50.0, SIGMA_PX, 3.0) == pytest.approx(3 * bound + ends_light, rel=1e-3)


def test_edge_ends_get_no_margin() -> None:
    """An end on the frame's edge is not an end: the strip stops there."""
    detection = Detection(row0=0.0, col0=100.0, row1=200.0, col1=100.0, snr=7.0, flags=StreakFlag.EDGE0)
    with_edge = footprint(roi.plan_strips(detection, SHAPE, half_width_px=4.5, margins_px=(50.0, 50.0), pixels_per_strip=4000))
    rows = np.flatnonzero(with_edge.any(axis=1))
    assert rows[0] == 0
    assert rows[-1] == pytest.approx(250, abs=1)


def test_point_like_is_a_small_square() -> None:
    """A point gets a square around it."""
    detection = Detection(row0=100.2, col0=200.7, row1=100.2, col1=200.7, snr=9.0, flags=StreakFlag.POINT_LIKE)
    counts = footprint(roi.plan_strips(detection, SHAPE, half_width_px=4.5, margins_px=(5.4, 5.4), pixels_per_strip=4000))
    rows, cols = np.nonzero(counts)
    assert (rows.min(), rows.max()) == (95, 106)
    assert cols.max() - cols.min() == rows.max() - rows.min() + 1
    assert counts.max() == 1


def test_cut_reads_raw_minus_dark_and_pads_with_the_level() -> None:
    """Values against plain indexing; outside the frame the level."""
    rng = np.random.default_rng(1)
    pixels, dark = rng.integers(0, 65536, SHAPE).astype(np.uint16), rng.integers(-50, 300, SHAPE).astype(np.int16)
    geometry = roi.StripGeometry(axis=1, major0=3, n=40, width=9, minor0_fp=-4 << 16, slope_fp=12345)
    strip = roi.cut_strip(geometry, pixels, DarkMap.of(dark.astype(np.float32)), 17)
    row, col, inside = strip.pixel_coordinates(*SHAPE)
    expected = np.where(inside, pixels[row.clip(0), col].astype(np.int64) - dark[row.clip(0), col], 17)
    assert (strip.values_adu == expected).all()
    assert (~inside).any()


@given(n=st.integers(1, 60), width=st.integers(1, 40), slope=st.integers(-65536, 65536), axis=st.integers(0, 1))
def test_split_keeps_every_pixel(n: int, width: int, slope: int, axis: int) -> None:
    """Both halves together are the whole."""
    if n * width == 1:
        return
    whole = roi.StripGeometry(axis=axis, major0=100, n=n, width=width, minor0_fp=150 << 16, slope_fp=slope)
    assert (footprint((whole,)) == footprint(roi.split(whole))).all()
