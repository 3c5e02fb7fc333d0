"""Properties of rendered light: whole-pixel shifts, transposition, additivity, no dependence on order."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.exposure import render_stars, render_trail

POSITIONS = st.floats(16.0, 47.0)
FLUX = st.floats(1.0, 1e6)
WIDTH = st.floats(0.4, 2.0)


def star(row, col, flux, sigma):
    image = np.zeros((64, 64), dtype=np.float32)
    render_stars(image, [row], [col], [flux], sigma)
    return image


@settings(max_examples=40, deadline=None)
@given(row=POSITIONS, col=POSITIONS, flux=FLUX, sigma=WIDTH, step=st.tuples(st.integers(-5, 5), st.integers(-5, 5)))
def test_a_shift_by_whole_pixels_shifts_the_star(row, col, flux, sigma, step):
    moved = star(row + step[0], col + step[1], flux, sigma)
    # Positions differ in the last bits of a double after the shift; single precision and the stamp's border see little of it.
    assert np.abs(np.roll(star(row, col, flux, sigma), step, axis=(0, 1)) - moved).max() <= 1e-6 * flux + 0.02


@settings(max_examples=40, deadline=None)
@given(row=POSITIONS, col=POSITIONS, flux=FLUX, sigma=WIDTH)
def test_transposition_swaps_rows_and_columns(row, col, flux, sigma):
    assert np.abs(star(row, col, flux, sigma).T - star(col, row, flux, sigma)).max() <= 1e-6 * flux


@settings(max_examples=20, deadline=None)
@given(
    ends=st.tuples(POSITIONS, POSITIONS, POSITIONS, POSITIONS),
    defocus=st.sampled_from([0.0, 2.5, 9.0]),
    share=st.floats(0.1, 0.9),
)
def test_a_trail_is_the_sum_of_its_parts_in_any_order(ends, defocus, share):
    t = (np.arange(120) + 0.5) / 120
    row, col = ends[0] + (ends[1] - ends[0]) * t, ends[2] + (ends[3] - ends[2]) * t
    flux = np.full(120, 100.0)
    whole, parts = (np.zeros((64, 64), dtype=np.float32) for _ in range(2))
    render_trail(whole, row, col, flux, 0.85, defocus, 0.2)
    cut = int(120 * share)
    for piece in (np.s_[cut:], np.s_[cut - 1 :: -1]):
        render_trail(parts, row[piece], col[piece], flux[piece], 0.85, defocus, 0.2)
    assert np.abs(whole - parts).max() <= 1e-5 * whole.max()
