"""Broad trails that were found in pieces become one fit, whichever way round the ends of the pieces are."""

from dataclasses import replace

import numpy as np
import pytest

from ground.streaks.fit_record import in_pixel_order
from ground.vetting.pieces import with_joined_pieces
from sboc_e2e.icd.products import StreakFit
from tests.streaks.lit_lines import fit_of_a_trail, placed

WIDTH_PX, PSF_PX = 5.0, 1.2
FIT = fit_of_a_trail()


def piece(row0: float, col0: float, row1: float, col1: float) -> StreakFit:
    """A broad piece of S/N 200, its ends by growing column as the fitter has them."""
    return in_pixel_order(replace(placed(FIT, (row0, col0, row1, col1), WIDTH_PX, 200.0), sigma_cross_px=0.1))


@pytest.mark.parametrize("tilt_px", [0.3, -0.3])
def test_pieces_along_a_column_are_one_trail_whichever_way_round_they_are(tilt_px: float) -> None:
    """With a tilt of -0.3 px the second piece runs against the first, and both stayed pieces."""
    fits = with_joined_pieces([piece(10.0, 50.0, 110.0, 50.3), piece(120.0, 50.3, 200.0, 50.3 + tilt_px)], PSF_PX)
    assert sorted((fits[0].row0, fits[0].row1)) == [10.0, 200.0]
    assert fits[0].col0 <= fits[0].col1


@pytest.mark.parametrize("height_px", [0.0, 1.5, -1.5])
def test_a_trail_of_pieces_is_as_bent_as_their_ends_say(height_px: float) -> None:
    """Ends of three pieces on a parabola over 300 px. A piece's own height says nothing of the whole."""
    along = np.array([0.0, 90.0, 105.0, 195.0, 210.0, 300.0])
    across = 80.0 + 4.0 * height_px * (along / 300.0) * (1.0 - along / 300.0)
    pieces = [piece(across[k], 40.0 + along[k], across[k + 1], 40.0 + along[k + 1]) for k in (2, 0, 4)]
    fits = with_joined_pieces([replace(pieces[0], sagitta_px=0.9), *pieces[1:]], PSF_PX)
    (joined,) = [fit for fit in fits if fit.length_px > 250.0]
    assert joined.sagitta_px == pytest.approx(height_px, abs=0.01)
    assert 0.03 < joined.sagitta_err_px < 0.1


def test_sharp_pieces_and_far_ones_stay() -> None:
    """Objects that follow each other in a line are as sharp as stars."""
    sharp = [replace(fit, width_px=1.3) for fit in (piece(10.0, 50.0, 110.0, 50.3), piece(120.0, 50.3, 200.0, 50.6))]
    assert with_joined_pieces(sharp, PSF_PX) == sharp
    beside = [piece(10.0, 50.0, 110.0, 50.3), piece(120.0, 62.0, 200.0, 62.3)]
    assert with_joined_pieces(beside, PSF_PX) == beside
