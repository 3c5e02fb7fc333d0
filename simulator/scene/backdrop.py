"""Everything behind and around the stars at an instant: sky, Moon, planets, Earth, and the veil that a camera makes of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.camera import Camera
from simulator.exposure.halos import render_halos
from simulator.optics.far_scatter import veil_per_arcsec2
from simulator.platform import earth
from simulator.platform.line_of_sight import LineOfSight
from simulator.scene import bodies
from simulator.scene.aberration import aberrate
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.bodies import Body
from simulator.scene.cirrus import Cirrus
from simulator.scene.earth_light import earth_light, earth_reach_rad, earth_veil
from simulator.scene.reflection import in_sight
from simulator.scene.sky import SKY_GRID, SkyOptions, diffuse_flux, fill_diffuse, unresolved_flux
from simulator.scene.stars import StarField

Array = NDArray[np.float64]

EARTH_GRID = 257
"""Nodes across a frame with the Earth in it: the air's scale height is 8 km, 500 arcsec at its limb from 700 km."""
NEAR_GRID = 65  # 0.08 deg apart over 5 deg: a veil of r^-2 errs by 2 % at 0.5 deg from the Moon, 0.1 % at 2 deg
NEAR_RAD = np.radians(6.0)
"""Nearer to the Moon than this the veil bends within a frame."""
DISC_STEP_PX = 1.0  # a point in each pixel, shared among four, makes an even disc
HALO_POINTS = 12
"""Points across the Moon's disc that stand for it in its halo."""
FIRST_BODY_ID = -(1 << 62)
"""Identity of planets in the truth of stars: this plus their number."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Backdrop:
    """What shines and hides at one instant.

    sun_km : (3,) of the zodiacal light. lit_sun_km : (3,) now. observer_km : (3,) geocentric. air : of a site; None in orbit.
    cirrus : structure of the unresolved light; None for none.
    """

    options: SkyOptions
    sun_km: Array
    lit_sun_km: Array
    observer_km: Array
    air: Atmosphere | None
    moon: Body | None
    planets: list[Body]
    cirrus: Cirrus | None = None

    def surface_flux(self, directions: Array, camera: Camera) -> Array:
        """Flux of a square arcsecond of field in directions (n, 3), in units of a V = 0 star."""
        flux = diffuse_flux(self.options, directions, self.sun_km)
        scatter = camera.instrument.scatter
        if self.air is not None:
            flux = flux * self.air.transmission(directions) + self.air.glow_flux(directions)
        moon = self.moon
        if moon is not None and self.air is not None and moon.direction @ self.air.up > 0.0:
            flux = flux + self.air.moonlight(directions, moon.direction, moon.flux_v0)
        hidden = np.ones(len(directions))
        if self.air is None and self.earth_is_near(directions):
            light, hidden = earth_light(directions, self.observer_km, self.lit_sun_km)
            flux = flux * hidden + light
        if scatter.strength > 0.0:
            if moon is not None:
                arriving = moon.flux_v0 * float(self.shining(moon.direction[None])[0])
                flux = flux + arriving * veil_per_arcsec2(scatter, np.arccos(np.clip(directions @ moon.direction, -1.0, 1.0)))
            if self.air is None and self.options.earth:
                flux = flux + earth_veil(scatter, directions, self.observer_km, self.lit_sun_km)
        return np.asarray(flux)

    def structure_flux(self, directions: Array) -> Array:
        """Flux of the unresolved light less that of its mean, in the units of `surface_flux`."""
        if self.cirrus is None:
            return np.zeros(len(directions))
        uneven = unresolved_flux(self.options, directions) * (self.cirrus.factor(directions) - 1.0)
        return np.asarray(uneven * self.shining(directions))

    def earth_is_near(self, directions: Array) -> bool:
        """Whether the Earth or its air stands in one of the directions (n, 3)."""
        if not self.options.earth:
            return False
        nadir = -self.observer_km / np.linalg.norm(self.observer_km)
        return bool(np.max(directions @ nadir, initial=-1.0) > np.cos(earth_reach_rad(self.observer_km)))

    def shining(self, directions: Array) -> Array:
        """Share of distant light that reaches the camera from directions (n, 3), through the Earth's limb or a site's air."""
        if self.air is not None:
            return np.where(directions @ self.air.up > 0.0, self.air.transmission(directions), 0.0)
        if not self.earth_is_near(directions):
            return np.ones(len(directions))
        return earth_light(directions, self.observer_km, self.lit_sun_km)[1]

    def grid(self, directions: Array) -> int:
        """Nodes across a frame whose sky stands in directions (n, 3)."""
        if self.air is None and self.earth_is_near(directions):
            return EARTH_GRID
        near = self.moon is not None and (directions @ self.moon.direction).max() > np.cos(NEAR_RAD)
        return NEAR_GRID if near else SKY_GRID

    def planets_near(self, direction: Array, radius_rad: float) -> list[tuple[int, Body]]:
        """Planets within an angle of a direction (3,), with their numbers."""
        return [(k, p) for k, p in enumerate(self.planets) if p.direction @ direction > np.cos(radius_rad)]


def backdrop_of(
    options: SkyOptions, tai_ns: int, sun_km: Array, observer_km: Array, air: Atmosphere | None, cirrus: Cirrus | None
) -> Backdrop:
    """What stands around an observer (3,), km, at an instant. sun_km : (3,) that the zodiacal light follows."""
    moon = bodies.moon(tai_ns, observer_km) if options.moon else None
    if moon is not None and air is None and not in_sight(1e5 * moon.direction + observer_km, observer_km):
        moon = None
    return Backdrop(
        options=options,
        sun_km=sun_km,
        lit_sun_km=earth.sun_position_km(tai_ns),
        observer_km=observer_km,
        air=air,
        moon=moon,
        planets=bodies.planets(tai_ns) if options.planets else [],
        cirrus=cirrus,
    )


def diffuse_image(backdrop: Backdrop, sight: LineOfSight, camera: Camera) -> NDArray[np.float32]:
    """An image of mean electrons of sky, Earth and stray light; the camera stands still in the middle of its frame."""
    shape = camera.shape

    def directions(grid: int) -> Array:
        row, col = np.meshgrid(*(np.linspace(0.0, n - 1.0, grid) for n in shape), indexing="ij")
        return camera.projection.to_vectors(row.ravel(), col.ravel()) @ sight.reference

    grid = backdrop.grid(directions(SKY_GRID))
    flux = backdrop.surface_flux(directions(grid), camera).reshape(grid, grid)
    if backdrop.cirrus is not None:  # on nodes of its own: what else shines is smooth, or has more nodes already
        flux = refined(flux, NEAR_GRID)
        structure = backdrop.structure_flux(directions(NEAR_GRID)).reshape(NEAR_GRID, NEAR_GRID)
        flux += refined(structure, len(flux))
    rate_e_s = flux * camera.surface_rate_e_s
    image_e = np.empty(shape, dtype=np.float32)
    stray_e = camera.instrument.stray_light_e_px_s * camera.exposure_s
    grid_e = (rate_e_s * camera.exposure_s).astype(np.float32)
    fill_diffuse(image_e, *camera.illumination, grid_e, stray_e, camera.instrument.stray_gradient)
    return image_e


def refined(values: Array, nodes: int) -> Array:
    """Values (n, n) from corner to corner, interpolated linearly to `nodes` nodes a side; unchanged where n is larger."""
    n = len(values)
    if n >= nodes:
        return values
    weight = np.maximum(1.0 - np.abs(np.linspace(0.0, n - 1.0, nodes)[:, None] - np.arange(n)), 0.0)
    return np.asarray(weight @ values @ weight.T)


def add_moon(image_e: NDArray[np.float32], backdrop: Backdrop, sight: LineOfSight, camera: Camera, velocity_km_s: Array) -> None:
    """Add the Moon's disc and its halo where they reach the frame; motion within the frame is left out.

    velocity_km_s : (3,) of the observer, as for stars.
    """
    moon = backdrop.moon
    if moon is None:
        return
    points, share = bodies.disc_points(moon, 2.0 * moon.radius_rad / HALO_POINTS)
    reaching = backdrop.shining(points)
    row, col = _pixels(points, backdrop, sight, camera, velocity_km_s)
    colour = float(camera.instrument.colour_factor(np.array([moon.b_v]))[0])
    total_e = camera.zero_point_e_s * camera.exposure_s * moon.flux_v0 * colour
    field = camera.psf_field
    rows, cols = camera.shape
    reach_px = moon.radius_rad * camera.projection.focal_px + (0.0 if field is None else 600.0)
    middle = _pixels(moon.direction[None], backdrop, sight, camera, velocity_km_s)
    if not (-reach_px < middle[0][0] < rows + reach_px and -reach_px < middle[1][0] < cols + reach_px):
        return
    if float((sight.reference @ moon.direction)[2]) <= 0.0:
        return
    light = camera.illumination_at(row, col) * reaching * share * total_e
    if field is not None:
        render_halos(image_e, row, col, light, field.halo, (camera.projection.center_row, camera.projection.center_col))
    core = 1.0 if field is None else field.halo.core_share
    fine, fine_share = bodies.disc_points(moon, DISC_STEP_PX / camera.projection.focal_px)
    row, col = _pixels(fine, backdrop, sight, camera, velocity_km_s)
    fine_e = core * total_e * fine_share * backdrop.shining(fine) * camera.illumination_at(row, col)
    inside = (row > -1.0) & (row < rows) & (col > -1.0) & (col < cols)
    _splat(image_e, row[inside], col[inside], fine_e[inside])


def _pixels(points: Array, backdrop: Backdrop, sight: LineOfSight, camera: Camera, velocity_km_s: Array) -> tuple[Array, Array]:
    apparent = aberrate(points, velocity_km_s)
    seen = apparent if backdrop.air is None else backdrop.air.refracted(apparent)
    return camera.projection.to_pixels(seen @ sight.reference.T)


def _splat(image_e: NDArray[np.float32], row: Array, col: Array, flux_e: Array) -> None:
    """Share points among their four pixels, in place."""
    r, c = np.floor(row).astype(int), np.floor(col).astype(int)
    for dr, dc in ((0, 0), (0, 1), (1, 0), (1, 1)):
        weight = np.abs(1 - dr - (row - r)) * np.abs(1 - dc - (col - c))
        y, x = r + dr, c + dc
        ok = (y >= 0) & (y < image_e.shape[0]) & (x >= 0) & (x < image_e.shape[1])
        np.add.at(image_e, (y[ok], x[ok]), (weight * flux_e)[ok].astype(np.float32))


def planet_field(body: Body, number: int, camera: Camera) -> tuple[StarField, StarField]:
    """A planet as points of light over its disc, and as the one source that the truth knows."""
    colour = float(camera.instrument.colour_factor(np.array([body.b_v]))[0])
    flux = camera.zero_point_e_s * body.flux_v0 * colour
    points, share = bodies.disc_points(body, DISC_STEP_PX / camera.projection.focal_px)
    v_mag = -2.5 * np.log10(body.flux_v0)

    def field(direction: Array, flux_e_s: Array) -> StarField:
        n = len(direction)
        identity = np.full(n, FIRST_BODY_ID + number, dtype=np.int64)
        return StarField(
            direction=direction,
            flux_e_s=flux_e_s,
            star_id=identity,
            v_mag=np.full(n, v_mag, dtype=np.float32),
            b_v=np.full(n, body.b_v, dtype=np.float32),
        )

    return field(points, share * flux), field(body.direction[None], np.array([flux]))
