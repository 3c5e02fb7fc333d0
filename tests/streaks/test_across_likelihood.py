"""The tabulated likelihood of a faint trail's place, against the sum over its pixels."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from ground.streaks.across import AcrossPixels
from ground.streaks.across_likelihood import AcrossLikelihood
from tests.link.test_pixel_line import NOISE_E, WIDTH_PX, exposed, trail_fit

Array = NDArray[np.float64]
LENGTH_PX, FLUX_E = 24.0, 400.0


def template(across: AcrossPixels, shift: float, half_tilt: float) -> Array:
    """Of a trail of one e-/px whose ends are blurred by half a pixel, which the fit states."""
    p, half = across.pixels, across.half_px
    blurred = math.hypot(WIDTH_PX, 0.5)
    share = ndtr((p.u + half) / blurred) - ndtr((p.u - half) / blurred)
    off = (p.v - shift - half_tilt * p.u / half) / WIDTH_PX
    return np.asarray(share * np.exp(-0.5 * off**2) / (math.sqrt(2.0 * math.pi) * WIDTH_PX))


@pytest.mark.parametrize(("shift", "half_tilt"), [(0.0, 0.0), (0.5, 0.0), (-1.3, 0.4), (0.2, -0.9)])
def test_tables_are_the_likelihood_of_the_pixels(shift: float, half_tilt: float) -> None:
    """With the light summed over a fine grid under its prior. Blocks that are moved as a whole follow a tilt to 0.3."""
    fit = trail_fit(LENGTH_PX, 0.7, FLUX_E)
    across = AcrossPixels.of(fit, exposed(np.random.default_rng(5), fit, FLUX_E, 0.3, 0.5, 0.0))
    assert across is not None
    value = across.pixels.value_e
    light, spread = FLUX_E / LENGTH_PX, 0.3 * FLUX_E / LENGTH_PX
    densities = light + spread * np.linspace(-6.0, 6.0, 601)
    shape = template(across, shift, half_tilt)
    log = [0.5 * float(np.sum(value**2 - (value - d * shape) ** 2)) / NOISE_E**2 for d in densities]
    prior = np.exp(-0.5 * ((densities - light) / spread) ** 2)
    prior /= prior.sum()
    expected = float(np.logaddexp.reduce(np.array(log) + np.log(prior)))
    found = AcrossLikelihood.of(across).log(np.array([[shift, half_tilt]]), light, spread)
    assert float(found[0]) == pytest.approx(expected, abs=0.3 if half_tilt else 0.05)


def test_a_star_over_more_than_a_third_of_a_short_trail_is_left_out() -> None:
    """Twenty times the light of a trail of 12 px, beside its middle: less than a tenth of the brightest pixel is left."""
    fit = trail_fit(12.0, 0.2, FLUX_E)
    across = AcrossPixels.of(fit, exposed(np.random.default_rng(6), fit, FLUX_E, 0.0, 0.0, 20.0 * FLUX_E))
    assert across is not None
    kept = across.without_intruders(np.zeros(2)).pixels
    assert kept.u.size < across.pixels.u.size
    assert float(kept.value_e.max()) < 0.1 * float(across.pixels.value_e.max())
