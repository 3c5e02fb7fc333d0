"""Stars of one frame: aberrated, projected, smeared by the camera's motion, each with the epoch of its own row."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.optics.projection import Projection
from simulator.platform.line_of_sight import LineOfSight
from simulator.platform.rotation import turned
from simulator.scene.aberration import aberrate
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.crossing import RowShutter
from simulator.scene.stars import StarField

Array = NDArray[np.float64]

LONGEST_STEP_PX = 0.45
"""A star that moves farther than this during its exposure is drawn as a trail of such steps, else as one widened PSF."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StarPlaces:
    """Stars on or near the frame. row, col : (s, n) centres in s substeps of the exposure; `index` into the star field.

    spread_px2 : (n,) variance of the position within a substep, to be added to the PSF's.
    """

    index: NDArray[np.intp]
    row: Array
    col: Array
    spread_px2: Array


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

    velocity_km_s : (3,) barycentric velocity of the observer in the middle of the frame; its change within a frame moves
    stars by less than 0.01 arcsec for exposures up to a second.
    """
    apparent = aberrate(stars.direction, velocity_km_s)
    seen = (apparent if air is None else air.refracted(apparent)) @ sight.reference.T
    row, col = projection.to_pixels(seen)
    drift_px = _largest_motion_px(sight, projection, shutter)
    reach = margin_px + drift_px
    near = (row > -reach) & (row < shutter.rows + reach) & (col > -reach) & (col < shutter.cols + reach)
    index = np.flatnonzero(near)
    seen, row = seen[index], row[index]
    substeps = max(1, int(np.ceil(drift_px / LONGEST_STEP_PX)))
    if substeps == 1:
        turn, variance = sight.mean_turn(shutter.open_s + shutter.line_s * row, shutter.exposure_s)
        row, col = projection.to_pixels(turned(seen, turn))
        radius2 = ((row - projection.center_row) ** 2 + (col - projection.center_col) ** 2) / projection.focal_px**2
        spread = projection.focal_px**2 * 0.5 * (variance[:, 0] + variance[:, 1] + radius2 * variance[:, 2])
        return StarPlaces(index=index, row=row[None], col=col[None], spread_px2=spread)
    rows, cols = np.empty((substeps, len(index))), np.empty((substeps, len(index)))
    for k in range(substeps):
        since = (k + 0.5) / substeps * shutter.exposure_s
        for _ in range(2):  # the row where a star stands decides when it is exposed
            row, col = projection.to_pixels(turned(seen, sight.turn_at(shutter.open_s + shutter.line_s * row + since)))
        rows[k], cols[k] = row, col
    return StarPlaces(index=index, row=rows, col=cols, spread_px2=np.zeros(len(index)))


def _largest_motion_px(sight: LineOfSight, projection: Projection, shutter: RowShutter) -> float:
    """Upper bound of how far any star of the frame moves during one exposure: peak-to-peak turns within windows of it."""
    steps = max(round(shutter.exposure_s / float(sight.fine_s[1] - sight.fine_s[0])), 1)
    blocks = [sight.turn_rad[k : k + steps + 1] for k in range(0, len(sight.turn_rad), max(steps // 2, 1))]
    swing = np.max([np.ptp(b, axis=0) for b in blocks], axis=0)
    corner = 0.5 * np.hypot(shutter.rows, shutter.cols)
    return float(projection.focal_px * np.hypot(swing[0], swing[1]) + corner * swing[2])
