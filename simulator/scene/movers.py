"""Which objects come near the field in a frame, and by which paths."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from simulator.camera import Camera
from simulator.platform.line_of_sight import LineOfSight
from simulator.randomness import Effect, generator
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.crossing import RowShutter, exposed_intervals
from simulator.scene.light import LightOptions
from simulator.scene.objects import PixelPathObject, SkyObject
from simulator.scene.trail_image import Path, pixel_path_of, sky_path_of
from simulator.scene.turbulence import Unsteadiness

Array = NDArray[np.float64]


def paths_of(
    things: Iterable[tuple[int, SkyObject | PixelPathObject]],
    sight: LineOfSight,
    camera: Camera,
    sun_km: Array,
    effects: LightOptions,
    air: Atmosphere | None,
    starts_s: tuple[float, float],
    stream: tuple[int, int],
) -> list[tuple[int, Path]]:
    """Paths of numbered objects that come near the field in a frame.

    starts_s : when the frame opens, and how long after it its middle row does. stream : seed and number of the frame.
    """
    first_open_s, to_middle_s = starts_s
    paths = []
    for object_id, thing in things:
        path: Path | None
        unsteady = _turbulence(air, sight, camera.instrument.aperture_m, stream, object_id)
        if isinstance(thing, PixelPathObject):
            start_s = (first_open_s if thing.restart else 0.0) + (to_middle_s if thing.from_middle_row else 0.0)
            path = pixel_path_of(thing, sight, camera, start_s, effects, unsteady)
        else:
            path = sky_path_of(thing, sight, camera, sun_km, effects, air, unsteady)
        if path is not None:
            paths.append((object_id, path))
    return paths


def first_seen_km(paths: list[tuple[int, Path]], shutter: RowShutter, sight: LineOfSight) -> dict[int, float]:
    """Range of each object that is exposed in a frame, in the middle of the first stretch; not a number where it has none."""
    out = {}
    for k, path in paths:
        lit = exposed_intervals(path.place, shutter, 0.5, *path.shown(sight))
        if lit:
            distance_km = path.range_km(np.array([0.5 * (lit[0].start_s + lit[0].end_s)]))[0]
            out[k] = float(distance_km) if np.isfinite(distance_km) else np.nan
    return out


def _turbulence(
    air: Atmosphere | None, sight: LineOfSight, aperture_m: float, stream: tuple[int, int], object_id: int
) -> Unsteadiness | None:
    """Scintillation and image motion of one object while the rows of one frame are open."""
    if air is None:
        return None
    rng = generator(stream[0], Effect.TURBULENCE, stream[1], object_id)
    return air.unsteadiness(sight.reference[2], aperture_m, float(sight.node_s[0]), float(sight.node_s[-1]), rng)
