"""Trailed stars under a rolling shutter against an integration in time, pixel row by pixel row.

The authority knows neither the exposed duration nor trails: it moves a point in small steps of time and gives its light to
those rows of pixels that are open at that instant.
"""

import numpy as np
import pytest
from scipy.special import ndtr

from simulator.exposure import render_stars
from simulator.optics.projection import Projection
from simulator.platform.line_of_sight import LineOfSight
from simulator.scene.crossing import RowShutter
from simulator.scene.star_image import place_stars
from simulator.scene.stars import StarField

ROWS, COLS, FOCAL_PX, SIGMA_PX = 400, 60, 5555.0, 0.9
EXPOSURE_S, FLUX_E_S = 0.05, 1e6
MIDDLE_S = 0.1


def _projection() -> Projection:
    return Projection(focal_px=FOCAL_PX, center_row=0.5 * (ROWS - 1), center_col=0.5 * (COLS - 1), sip=None)


def _sight(row_rate_px_s: float) -> LineOfSight:
    """A camera that turns about its rows' axis, so that stars move along columns."""
    fine_s = np.linspace(-0.5, 0.7, 2401)
    turn = np.zeros((len(fine_s), 3))
    turn[:, 0] = row_rate_px_s / FOCAL_PX * (fine_s - MIDDLE_S)
    return LineOfSight(
        node_s=np.linspace(-0.5, 0.7, 33),
        observer_km=np.zeros((33, 3)),
        velocity_km_s=np.zeros((33, 3)),
        reference_s=MIDDLE_S,
        reference=np.eye(3),
        fine_s=fine_s,
        turn_rad=turn,
    )


def _field(projection: Projection) -> StarField:
    direction = projection.to_vectors(np.array([0.5 * (ROWS - 1)]), np.array([0.5 * (COLS - 1)]))
    one = np.zeros(1)
    return StarField(
        direction=direction,
        flux_e_s=np.array([FLUX_E_S]),
        star_id=np.ones(1, dtype=np.int64),
        v_mag=one.astype(np.float32),
        b_v=one.astype(np.float32),
    )


def _by_integration(row_rate_px_s: float, shutter: RowShutter) -> np.ndarray:
    """Electrons of each row of pixels (ROWS,): every 0.02 px of the way, light falls on those rows that are open."""
    step_s = min(0.02 / abs(row_rate_px_s), 1e-4)
    opens_s = shutter.open_s + shutter.line_s * np.arange(ROWS)
    edges = np.arange(ROWS + 1) - 0.5
    total = np.zeros(ROWS)
    for times_s in np.array_split(np.arange(-0.2, 0.4, step_s) + 0.5 * step_s, 20):
        # Along the middle column the tangent projection turns an angle into FOCAL_PX tan(angle).
        row = 0.5 * (ROWS - 1) + FOCAL_PX * np.tan(row_rate_px_s / FOCAL_PX * (times_s - MIDDLE_S))
        lit = (times_s[:, None] >= opens_s) & (times_s[:, None] < opens_s + EXPOSURE_S)
        total += (np.diff(ndtr((edges - row[:, None]) / SIGMA_PX), axis=1) * lit).sum(axis=0) * (FLUX_E_S * step_s)
    return total


@pytest.mark.parametrize("row_rate_px_s", [485.0, -485.0, 1500.0, 4000.0, 30.0])
def test_light_of_a_trailed_star_is_that_of_a_moving_point(row_rate_px_s: float) -> None:
    """Speeds of 0.01 to 1.6 rows in each line time: light and density to 0.3 %, centroid to 0.1 px."""
    projection, sight = _projection(), _sight(row_rate_px_s)
    shutter = RowShutter(open_s=0.0, line_s=4e-4, exposure_s=EXPOSURE_S, rows=ROWS, cols=COLS)
    field = _field(projection)
    wanted = _by_integration(row_rate_px_s, shutter)
    places = place_stars(field, sight, np.zeros(3), projection, shutter, 40.0, None)
    image = np.zeros((ROWS, COLS), dtype=np.float32)
    flux_e = field.flux_e_s[places.index] * EXPOSURE_S * places.exposed
    sigma_px = np.sqrt(SIGMA_PX**2 + places.spread_px2)
    for row, col in zip(places.row, places.col, strict=True):
        render_stars(image, row, col, flux_e / len(places.row), sigma_px)
    profile = image.sum(axis=1, dtype=np.float64)
    assert profile.sum() == pytest.approx(wanted.sum(), rel=3e-3)
    assert profile.sum() == pytest.approx(FLUX_E_S * EXPOSURE_S / abs(1.0 - row_rate_px_s * shutter.line_s), rel=3e-3)
    rows = np.arange(ROWS)
    assert rows @ profile / profile.sum() == pytest.approx(rows @ wanted / wanted.sum(), abs=0.1)
    inside = np.flatnonzero(wanted > 0.5 * wanted.max())[6:-6]
    assert inside.size > 5 or abs(row_rate_px_s) < 100.0
    if inside.size:  # the middle of a trail: its density, which no shutter changes
        assert wanted[inside] == pytest.approx(FLUX_E_S / abs(row_rate_px_s), rel=0.01)
        assert profile[inside] == pytest.approx(FLUX_E_S / abs(row_rate_px_s), rel=3e-3)
