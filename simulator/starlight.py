"""Stars and planets of one frame: placed, dimmed by what is in the way, exposed, and told to the truth."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.camera import Camera
from simulator.platform.line_of_sight import LineOfSight
from simulator.scene.backdrop import Backdrop, planet_field
from simulator.scene.bodies import Body
from simulator.scene.crossing import RowShutter
from simulator.scene.star_image import StarPlaces, expose_stars, place_stars
from simulator.scene.stars import StarField
from simulator.truth_rows import star_rows

Array = NDArray[np.float64]

STAR_MARGIN_PX = 40.0
"""Stars this far outside the frame are drawn for the light of their wings."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Points:
    """What shines in a field. nebulae : points that together make up what is nebulous, without truth; None for none.

    planets : number and body of each.
    """

    listed: StarField
    nebulae: StarField | None
    planets: list[tuple[int, Body]]


def add_stars(
    image_e: NDArray[np.float32],
    points: Points,
    backdrop: Backdrop,
    sight: LineOfSight,
    velocity_km_s: Array,
    shutter: RowShutter,
    camera: Camera,
    stream: tuple[int, int],
) -> NDArray[np.void]:
    """Add stars, nebulae and planets to the image; truth of planets and stars, in this order.

    stream : seed and number of the frame, which decide scintillation (planets have none).
    """
    lighting = _Lighting(image_e, backdrop, sight, velocity_km_s, shutter, camera)
    rows = []
    if points.nebulae is not None:
        lighting.expose(points.nebulae)
    for number, planet in points.planets:
        disc, whole = planet_field(planet, number, camera)
        lighting.expose(disc)
        rows.append(lighting.truth(whole, stream[1]))
    rows.append(lighting.truth(points.listed, stream[1], lighting.expose(points.listed, stream)))
    return rows[0] if len(rows) == 1 else np.concatenate(rows)


@dataclass(frozen=True, eq=False)
class _Lighting:
    """How points of the sky reach one image."""

    image_e: NDArray[np.float32]
    backdrop: Backdrop
    sight: LineOfSight
    velocity_km_s: Array
    shutter: RowShutter
    camera: Camera

    def expose(self, field: StarField, stream: tuple[int, int] | None = None) -> "_Exposed":
        """Add points of light; stream : of scintillation, None for none."""
        made = self._place(field, stream)
        expose_stars(self.image_e, made.places, made.flux_e, made.sigma_px, self.camera)
        return made

    def truth(self, field: StarField, index: int, made: "_Exposed | None" = None) -> NDArray[np.void]:
        """Rows of the truth, on the level of the finished image."""
        made = made or self._place(field, None)
        level_e = float(self.image_e[::64, ::64].mean())
        return star_rows(self.camera, field, made.places, made.flux_e, made.sigma_px, level_e, index)

    def _place(self, field: StarField, stream: tuple[int, int] | None) -> "_Exposed":
        camera, air, shutter = self.camera, self.backdrop.air, self.shutter
        places = place_stars(field, self.sight, self.velocity_km_s, camera.projection, shutter, STAR_MARGIN_PX, air)
        row, col = places.row.mean(axis=0), places.col.mean(axis=0)
        sigma_px = np.sqrt(camera.sigma_at(row, col) ** 2 + places.spread_px2)
        flux_e = field.flux_e_s[places.index] * shutter.exposure_s * places.exposed * camera.illumination_at(row, col)
        flux_e *= self.backdrop.shining(field.direction[places.index])
        if air is not None and stream is not None:
            aperture_m = camera.instrument.aperture_m
            flux_e *= air.flicker(len(flux_e), self.sight.reference[2], aperture_m, shutter.exposure_s, *stream)
        return _Exposed(places, flux_e, sigma_px)


class _Exposed(NamedTuple):
    places: StarPlaces
    flux_e: Array
    sigma_px: Array
