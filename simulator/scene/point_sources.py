"""All points of the sky around a direction: stars and asteroids, which have truth; galaxies and clusters, which have none."""

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.catalogue import StarCatalogue
from simulator.optics.instrument import InstrumentOptions
from simulator.scene.asteroids import AsteroidSky
from simulator.scene.clusters import clusters_around
from simulator.scene.galaxies import GalaxySky
from simulator.scene.sky import SkyOptions
from simulator.scene.stars import StarField, StarOptions, StarSky, joined

Array = NDArray[np.float64]


class PointSources:
    """Catalogue stars with their faint neighbours, asteroids, galaxies and globular clusters of one sky."""

    def __init__(
        self,
        stars: StarOptions,
        sky: SkyOptions,
        instrument: InstrumentOptions,
        catalogue: StarCatalogue,
        *,
        seed: int,
        epoch_jyear: float,
    ) -> None:
        self._sky, self._instrument, self._seed = sky, instrument, seed
        self._stars = StarSky(stars, instrument, catalogue, seed=seed, epoch_jyear=epoch_jyear)
        self._asteroids = AsteroidSky(sky.asteroids, instrument, seed=seed)
        self._galaxies = GalaxySky(sky.galaxies, instrument, seed=seed)

    def listed(self, centre: Array, radius_rad: float, tai_ns: int, observer_km: Array) -> StarField:
        """Stars and asteroids within `radius_rad` of a direction (3,), ICRS, seen from `observer_km` (3,)."""
        radius_deg = float(np.degrees(radius_rad))
        stars = self._stars.around(centre, radius_deg)
        if self._sky.asteroids.density == 0.0:
            return stars
        return joined([stars, self._asteroids.around(centre, radius_deg, tai_ns, observer_km)])

    def nebulae(self, centre: Array, radius_rad: float) -> StarField | None:
        """Points of galaxies and globular clusters around a direction (3,), ICRS; None where there is nothing."""
        radius_deg, fields = float(np.degrees(radius_rad)), []
        if self._sky.galaxies.density > 0.0:
            fields.append(self._galaxies.around(centre, radius_deg))
        if self._sky.clusters:
            fields += clusters_around(centre, radius_deg, self._instrument, self._seed)
        return joined(fields) if fields else None
