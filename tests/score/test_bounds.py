"""Trails and bounds against closed forms that share no code with them."""

import math

import numpy as np
import pytest

from sboc_e2e.score.bounds import trail_bounds
from sboc_e2e.score.detection import detection_figures
from sboc_e2e.score.ideal import expected_false, ideal_snr50, ideal_threshold
from sboc_e2e.score.trail import TruePath, draw

SIGMA_PX = 0.849


def straight(length_px: float, *, flux_e_s: float = 1e10, edge: bool = False, angle_rad: float = 0.4) -> TruePath:
    node = np.linspace(-0.5, 0.5, 33)
    return TruePath(
        row=2000.3 + node * length_px * math.sin(angle_rad), col=2000.1 + node * length_px * math.cos(angle_rad),
        flux_e_s=np.full(33, flux_e_s), duration_s=0.2, sigma_px=SIGMA_PX, edge0=edge, edge1=edge,
    )  # fmt: skip


@pytest.mark.parametrize(("length_px", "snr"), [(200.0, 12.0), (150.0, 10.0), (400.0, 7.0), (1000.0, 20.0)])
def test_bounds_equal_the_long_trail_forms(length_px: float, snr: float) -> None:
    """Closed forms for L >> s (end sqrt(2 sqrt(pi) s L)/S, cross sqrt(2) s/S), with pixel integration in s; 3 %."""
    bounds = trail_bounds(straight(length_px), snr, (10**5, 10**5))
    s = math.sqrt(SIGMA_PX**2 + 1 / 12)
    assert bounds.cross_px == pytest.approx(math.sqrt(2) * s / snr, rel=0.03)
    end_px = math.sqrt(2 * math.sqrt(math.pi) * s * length_px) / snr
    assert bounds.end0_px == pytest.approx(end_px, rel=0.03)
    assert bounds.flux_relative == pytest.approx(math.sqrt(1 / snr**2 + 2 * end_px**2 / length_px**2), rel=0.03)
    assert bounds.angle_rad == pytest.approx(math.sqrt(24) * s / (snr * length_px), rel=0.04)


def test_object_noise_widens_the_bound() -> None:
    """At L = 100, S = 50 over the preset's noise the bound is 1.31 x (cross) and 1.45 x (flux) the one without."""
    snr, noise_e, length_px = 50.0, 2.84, 100.0
    s = math.sqrt(SIGMA_PX**2 + 1 / 12)
    flux_e = snr * noise_e * math.sqrt(2 * math.sqrt(math.pi) * s * length_px)
    quiet = trail_bounds(straight(length_px), snr, (10**5, 10**5))
    loud = trail_bounds(straight(length_px, flux_e_s=flux_e / 0.2), snr, (10**5, 10**5))
    assert loud.cross_px / quiet.cross_px == pytest.approx(1.31, abs=0.05)
    assert loud.flux_relative / quiet.flux_relative == pytest.approx(1.45, abs=0.08)


def test_cut_ends_have_no_bound() -> None:
    bounds = trail_bounds(straight(300.0, edge=True), 15.0, (10**5, 10**5))
    assert bounds.end0_px is None
    assert bounds.end1_px is None
    assert bounds.flux_relative == pytest.approx(1 / 15.0, rel=0.03)


def test_drawn_light_is_conserved_and_centred() -> None:
    path = straight(123.4, flux_e_s=1000.0)
    row, col, electrons = draw(path).pixels(10**5, 10**5)
    assert electrons.sum() == pytest.approx(200.0, rel=1e-5)
    assert (electrons * row).sum() / 200.0 == pytest.approx(2000.3, abs=1e-3)
    assert (electrons * col).sum() / 200.0 == pytest.approx(2000.1, abs=1e-3)


def test_ideal_threshold_of_the_preset() -> None:
    """Published with the rare-event correction: 7.0 and 6.6-6.7 at 4096 x 4096 for 0.1 false per frame, 6.7 at 2048."""
    assert ideal_threshold(0.1, 4096, 4096, 0.849) == pytest.approx(7.0, abs=0.05)
    assert ideal_snr50(0.1, 4096, 4096, 0.849) == pytest.approx(6.65, abs=0.1)
    assert ideal_threshold(0.1, 2048, 2048, 0.849) == pytest.approx(6.7, abs=0.06)
    assert expected_false(7.0, 4096, 4096, 0.849) > expected_false(7.5, 4096, 4096, 0.849)


@pytest.mark.parametrize("frame", [(1, 1, 0.85), (8, 8, 0.85), (11, 11, 0.85), (24, 24, 3.0)])
def test_a_frame_too_small_for_the_formula_has_no_ideal_threshold(frame: tuple[int, int, float]) -> None:
    """Below 3 sigma the leading term says nothing; the score gives the reason."""
    assert ideal_threshold(0.1, *frame) is None
    assert ideal_snr50(0.1, *frame) is None
    figures = detection_figures((), set(), 0, 3, frame[:2], frame[2])
    assert figures["ideal_threshold"]["reason"] == figures["ideal_snr50"]["reason"] == "the frame is too small for the formula"
