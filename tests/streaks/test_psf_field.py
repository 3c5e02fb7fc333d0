"""The width of the PSF over the field, learned from trails."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import PsfField, TrailedPsfFitter
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from tests.streaks.trail_rendering import expose, trail_at


@pytest.fixture(scope="module")
def template() -> StreakFit:
    rng = np.random.default_rng(1)
    exposure = expose(rng, trail_at(rng, 50.0), 30.0)
    return TrailedPsfFitter().fit(exposure.pixels, exposure.detection)


def fits_of(template: StreakFit, rng: np.random.Generator, n: int, growth: float) -> list[StreakFit]:
    """Fits all over a 4096 px image whose PSF grows quadratically; width errors of 5 %."""
    out = []
    for _ in range(n):
        row, col = rng.uniform(0.0, 4095.0, 2)
        r2 = ((row - 2047.5) ** 2 + (col - 2047.5) ** 2) / (2.0 * 2047.5**2)
        width = 0.85 * math.exp(growth * r2) * rng.lognormal(0.0, 0.05)
        out.append(
            replace(template, row0=row, row1=row, col0=col - 25.0, col1=col + 25.0, width_px=width, width_err_px=0.05 * width)
        )
    return out


def test_nominal_before_any_trail() -> None:
    field = PsfField.nominal(0.85, (4096, 4096))
    assert field.sigma_px(0.0, 0.0) == pytest.approx(0.85)


def test_growth_towards_the_corner_is_learned_to_a_percent(template: StreakFit) -> None:
    """300 trails of 5 % width error each give the corner to about 1 %."""
    field = PsfField.nominal(0.85, (4096, 4096)).updated(fits_of(template, np.random.default_rng(2), 300, 0.14))
    assert field.sigma_px(2047.5, 2047.5) == pytest.approx(0.85, rel=0.02)
    assert field.sigma_px(0.0, 0.0) == pytest.approx(0.85 * math.exp(0.14), rel=0.03)
    assert field.sigma_px(2047.5, 2047.5, length_px=4000.0) > field.sigma_px(2047.5, 2047.5)


def test_particles_and_defocused_objects_teach_nothing(template: StreakFit) -> None:
    field = PsfField.nominal(0.85, (4096, 4096))
    sharp = replace(template, width_px=0.2, flags=StreakFlag.COSMIC_LIKE)
    outlier = replace(template, width_px=2.5, width_err_px=0.05)
    faint = replace(template, snr=5.0)
    # a bright point that moves by a pixel is wider than the PSF by many of its errors, though by little
    point = replace(template, width_px=0.93, width_err_px=0.004, flags=StreakFlag.POINT_LIKE)
    assert field.updated([sharp, outlier, faint, point]) is field
