"""What a night sees of the store: tracklets of the window, objects in service; and orbits between the store's form and fits'."""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from ground.association.clusters import AssociationOptions, Cluster
from ground.determination.measurements import Directions
from ground.sky.sphere import east_north
from ground.store.forces import carried, covariance_of, forces_of
from ground.store.store import ObjectStore, StoredOrbit, StoredTracklet
from ground.upkeep.sightings import KnownOrbit
from sboc_e2e.icd import tai

MADE_BY: Final = "sboc objects update"


@dataclass(frozen=True, kw_only=True)
class UpkeepOptions:
    """Rules of the catalogue.

    window_days : tracklets and fits reach so far back. accept : a tracklet is an object's from this probability on; below it
    stays ambiguous. lost_km : position error (3-D, one sigma) beyond which an object is lost; retired_days : after so many
    days without a tracklet a lost object is retired. merge_chi2 : of the difference of two orbits, six degrees of freedom.
    workers : processes that predict orbits; what comes out does not depend on it.
    """

    window_days: float = 10.0
    accept: float = 0.99
    lost_km: float = 2000.0
    retired_days: float = 60.0
    merge_chi2: float = 25.0
    workers: int = 1
    association: AssociationOptions = field(default_factory=AssociationOptions)


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A store, the epoch that it is brought up to, and the rules."""

    store: ObjectStore
    now_tai_ns: int
    options: UpkeepOptions

    @property
    def window_ns(self) -> int:
        """How far back tracklets and fits reach."""
        return round(self.options.window_days * tai.NS_PER_DAY)

    @property
    def since_tai_ns(self) -> int:
        """Where the window begins."""
        return self.now_tai_ns - self.window_ns

    def uncorrelated(self) -> dict[int, Directions]:
        """Tracklets of the window that are no object's, by number."""
        return {k: directions_of(t) for k, t in self.store.uncorrelated(self.since_tai_ns, self.now_tai_ns).items()}

    def tracklets_of(self, object_id: int) -> dict[int, Directions]:
        """An object's tracklets of the window, by number."""
        stored = self.store.tracklets_of(object_id).items()
        return {k: directions_of(t) for k, t in stored if self.since_tai_ns <= t.t_tai_ns[0] < self.now_tai_ns}

    def in_service(self) -> tuple[dict[int, str], dict[int, KnownOrbit]]:
        """Status of every object, and the orbits of those that are looked for."""
        status = {row["object_id"]: str(row["status"]) for row in self.store.objects()}
        known = [known_orbit(o, self.options) for o in self.store.orbits() if status[o.object_id] in ("active", "lost")]
        return status, {one.orbit.object_id: one for one in known}

    def stored(self, cluster: Cluster, object_id: int) -> StoredOrbit:
        """The orbit of a cluster, as an object's row made tonight."""
        s = cluster.solution
        return StoredOrbit(
            object_id=object_id, epoch_tai_ns=s.t0_tai_ns, state=s.state, covariance=s.covariance, made_tai_ns=self.now_tai_ns,
            made_by=MADE_BY, parameters={p: s.forces.value_of(p) for p in s.parameters}, chi2_nu=s.chi2_nu,
            n_used=int((s.weights > 0.0).sum()),
        )  # fmt: skip


def directions_of(stored: StoredTracklet) -> Directions:
    """A tracklet of the store as measurements."""
    unit, n = stored.rows[:, :3], len(stored.t_tai_ns)
    turned = [east_north(one) for one in unit]
    east, north = (np.array([pair[k] for pair in turned]) for k in (0, 1))
    cos, sin = np.cos(stored.rows[:, 5:6]), np.sin(stored.rows[:, 5:6])
    axes = np.stack([cos * north + sin * east, cos * east - sin * north], axis=1)
    covariance = np.zeros((n, 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = stored.rows[:, 3] ** 2, stored.rows[:, 4] ** 2
    return Directions(
        t_tai_ns=stored.t_tai_ns, observer_km=stored.rows[:, 6:], direction=unit, axes=axes, covariance_rad2=covariance
    )


def known_orbit(orbit: StoredOrbit, options: UpkeepOptions) -> KnownOrbit:
    """An orbit with its forces. Where only the state has a covariance, radiation has the association's doubt, the rest none."""
    covariance = covariance_of(orbit, options.association.radiation_sigma_m2_kg)
    return KnownOrbit(orbit=orbit, forces=forces_of(orbit, options.association.gravity_degree), covariance=covariance)


def position_error_km(orbit: StoredOrbit, at_tai_ns: int, options: AssociationOptions | None = None) -> float:
    """One sigma of place, 3-D, at an epoch: carried with the estimated parameters and with what the forces leave out.

    UserError where the orbit cannot be carried there.
    """
    _, covariances = carried(orbit, np.array([at_tai_ns], dtype=np.int64), options)
    return float(np.sqrt(np.trace(covariances[0, :3, :3])))
