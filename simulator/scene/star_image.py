"""Stars of one frame: aberrated, projected, smeared by the camera's motion, each with the epoch of its own row."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.camera import Camera
from simulator.exposure import render_stars
from simulator.exposure.halos import render_halos
from simulator.exposure.tables import FAINTEST_E, add_table_points
from simulator.optics.projection import Projection
from simulator.optics.psf_field import PHASES
from simulator.platform.line_of_sight import LineOfSight
from simulator.platform.rotation import turned
from simulator.scene.aberration import aberrate
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.crossing import RowShutter
from simulator.scene.stars import StarField

Array = NDArray[np.float64]

LONGEST_STEP_PX = 0.45
"""A star that moves farther than this during its exposure is drawn as a trail of such steps, else as one widened PSF."""
PLACE_ERROR_PX = 1e-3
"""The instants at which a star's row opens and closes are so accurate that the star moves by less in the error."""
HALO_STEPS = 8
"""Steps of a trailed star that share a halo: what is farther than 7 px does not see 4 px of motion."""
_MOST_ROUNDS = 12  # of the secant method, which ends by itself but for stars that nearly keep pace with the shutter
_SLOWEST_OVERTAKING = 0.02  # keeps their steps finite: 1 - v line_time is taken for no less


@dataclass(frozen=True, kw_only=True, eq=False)
class StarPlaces:
    """Stars on or near the frame. row, col : (s, n) centres in s equal steps of their exposures; `index` into the star field.

    spread_px2 : (n,) variance of the position within a step, to be added to the PSF's.
    exposed : (n,) how long a star is exposed over the exposure of a row; a star that moves with the shutter sees more of it.
    """

    index: NDArray[np.intp]
    row: Array
    col: Array
    spread_px2: Array
    exposed: Array


def place_stars(
    stars: StarField,
    sight: LineOfSight,
    velocity_km_s: Array,
    projection: Projection,
    shutter: RowShutter,
    margin_px: float,
    air: Atmosphere | None,
) -> StarPlaces:
    """Positions of stars that come within `margin_px` of the frame.

    A star that moves by v rows per second is exposed for ``exposure / |1 - v line_time|``: both its trail and its light
    stretch, so that the light on each pixel of the trail is what it would be under a global shutter.

    velocity_km_s : (3,) barycentric velocity of the observer in the middle of the frame; its change within a frame moves
    stars by less than 0.01 arcsec for exposures up to a second.
    """
    apparent = aberrate(stars.direction, velocity_km_s)
    seen = (apparent if air is None else air.refracted(apparent)) @ sight.reference.T
    row, col = projection.to_pixels(seen)
    drift_px = _largest_motion_px(sight, projection, shutter, shutter.exposure_s)
    reach = margin_px + _largest_motion_px(sight, projection, shutter, np.inf)
    near = (row > -reach) & (row < shutter.rows + reach) & (col > -reach) & (col < shutter.cols + reach)
    index = np.flatnonzero(near)
    seen, row = seen[index], row[index]
    error_s = PLACE_ERROR_PX * shutter.exposure_s / max(drift_px, PLACE_ERROR_PX)
    ends_s = [_instant(seen, row, sight, projection, shutter, since, error_s) for since in (0.0, shutter.exposure_s)]
    open_s, close_s = np.minimum(*ends_s), np.maximum(*ends_s)  # a star faster than the shutter meets its rows backwards
    lit_s = np.maximum(close_s - open_s, 1e-12)
    longest_s = float(lit_s.max(initial=shutter.exposure_s))
    substeps = max(1, int(np.ceil(_largest_motion_px(sight, projection, shutter, longest_s) / LONGEST_STEP_PX)))
    exposed = lit_s / shutter.exposure_s
    if substeps == 1:
        turn, variance = sight.mean_turn(open_s, open_s + lit_s)
        row, col = projection.to_pixels(turned(seen, turn))
        radius2 = ((row - projection.center_row) ** 2 + (col - projection.center_col) ** 2) / projection.focal_px**2
        spread = projection.focal_px**2 * 0.5 * (variance[:, 0] + variance[:, 1] + radius2 * variance[:, 2])
        return StarPlaces(index=index, row=row[None], col=col[None], spread_px2=spread, exposed=exposed)
    rows, cols = np.empty((substeps, len(index))), np.empty((substeps, len(index)))
    for k in range(substeps):
        at_s = open_s + (k + 0.5) / substeps * lit_s
        rows[k], cols[k] = projection.to_pixels(turned(seen, sight.turn_at(at_s)))
    return StarPlaces(index=index, row=rows, col=cols, spread_px2=np.zeros(len(index)), exposed=exposed)


def expose_stars(image_e: NDArray[np.float32], places: StarPlaces, flux_e: Array, sigma_px: Array, camera: Camera) -> None:
    """Add stars (n,) with given total electrons, in place. sigma_px : width of Gaussian stars, motion in a step included."""
    steps = len(places.row)
    field = camera.psf_field
    if field is None:
        for row, col in zip(places.row, places.col, strict=True):
            render_stars(image_e, row, col, flux_e / steps, sigma_px)
        return
    node = field.node(places.row.mean(axis=0), places.col.mean(axis=0))
    tables = field.spread(node, places.spread_px2)
    for row, col in zip(places.row, places.col, strict=True):
        add_table_points(image_e, row, col, flux_e / steps, node, tables, field.reach, PHASES, FAINTEST_E / steps)
    axis = camera.projection.center_row, camera.projection.center_col
    for some in np.array_split(np.arange(steps), max(1, steps // HALO_STEPS)):
        share = len(some) / steps
        render_halos(image_e, places.row[some].mean(axis=0), places.col[some].mean(axis=0), share * flux_e, field.halo, axis)


def _instant(
    seen: Array,
    reference_row: Array,
    sight: LineOfSight,
    projection: Projection,
    shutter: RowShutter,
    since_s: float,
    error_s: float,
) -> Array:
    """When stars (n, 3) stand on a row that opened `since_s` ago, by the secant method; (n,) seconds after the epoch.

    reference_row : (n,) their rows at the reference time of the frame.
    """
    before_s = np.full(len(seen), sight.reference_s)
    before = shutter.since_open(before_s, reference_row) - since_s
    time_s = shutter.open_s + shutter.line_s * reference_row + since_s
    if shutter.line_s == 0.0:
        return np.asarray(time_s)
    for _ in range(_MOST_ROUNDS):
        row, _ = projection.to_pixels(turned(seen, sight.turn_at(time_s)))
        excess = shutter.since_open(time_s, row) - since_s
        if np.abs(excess).max(initial=0.0) < error_s:
            break
        # Seconds since the opening of the row for each second: 1 - v line_time.
        apart_s = time_s - before_s
        pace = np.divide(excess - before, apart_s, out=np.ones_like(apart_s), where=np.abs(apart_s) > 1e-12)
        pace = np.copysign(np.maximum(np.abs(pace), _SLOWEST_OVERTAKING), pace)
        before_s, before = time_s, excess
        time_s = time_s - excess / pace
    return np.asarray(time_s)


def _largest_motion_px(sight: LineOfSight, projection: Projection, shutter: RowShutter, span_s: float) -> float:
    """Upper bound of how far any star of the frame moves in a time span: peak-to-peak turns within windows of it."""
    steps = int(np.clip(span_s / float(sight.fine_s[1] - sight.fine_s[0]) + 0.5, 1, len(sight.fine_s)))
    blocks = [sight.turn_rad[k : k + steps + 1] for k in range(0, len(sight.turn_rad), max(steps // 2, 1))]
    swing = np.max([np.ptp(b, axis=0) for b in blocks], axis=0)
    corner = 0.5 * np.hypot(shutter.rows, shutter.cols)
    return float(projection.focal_px * np.hypot(swing[0], swing[1]) + corner * swing[2])
