"""Light of an object by pass, brought to a standard distance and phase."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd import tai

Array = NDArray[np.float64]

STANDARD_KM: Final = 1000.0
_AU_KM: Final = 149597870.7
_TT_TAI_DAYS: Final = 32.184 / 86400.0


@dataclass(frozen=True, kw_only=True, eq=False)
class LightPass:
    """Samples of one pass in the order of time.

    t_s : (n,) after an instant of its own. mag, mag_err : (n,) at `STANDARD_KM`, not reduced for phase. phase_rad : (n,) angle at
    the object between Sun and observer.
    """

    t_s: Array
    mag: Array
    mag_err: Array
    phase_rad: Array

    def __post_init__(self) -> None:
        """ValueError for samples that are not finite, of no error, or not in the order of time."""
        columns = np.stack([self.t_s, self.mag, self.mag_err, self.phase_rad])
        if not np.isfinite(columns).all() or (self.mag_err <= 0.0).any() or (np.diff(self.t_s) <= 0.0).any():
            raise ValueError("a pass has finite samples with positive errors at rising epochs")


def sun_km(t_tai_ns: NDArray[np.int64]) -> Array:
    """Geocentric Sun (n, 3), GCRS axes, geometric (ERFA `epv00`)."""
    parts = np.array([tai.to_jd_parts(int(t)) for t in t_tai_ns]).reshape(-1, 2)
    return np.asarray(-erfa.epv00(parts[:, 0], parts[:, 1] + _TT_TAI_DAYS)[0]["p"] * _AU_KM)


def light_pass(t_tai_ns: NDArray[np.int64], mag: Array, mag_err: Array, object_km: Array, observer_km: Array) -> LightPass:
    """Apparent magnitudes (n,) of an object at object_km (n, 3), seen from observer_km (n, 3), GCRS.

    Samples without a magnitude or an error are left out; of samples at one epoch the first counts.
    """
    order = np.argsort(t_tai_ns, kind="stable")
    usable = (
        np.isfinite(mag)
        & np.isfinite(mag_err)
        & (mag_err > 0.0)
        & np.isfinite(object_km).all(1)
        & np.isfinite(observer_km).all(1)
    )
    order = order[usable[order]]
    order = order[np.diff(t_tai_ns[order], prepend=np.int64(-(2**62))) > 0]
    t, to_observer = t_tai_ns[order], observer_km[order] - object_km[order]
    to_sun = sun_km(t) - object_km[order]
    range_km, sun_range_km = np.linalg.norm(to_observer, axis=1), np.linalg.norm(to_sun, axis=1)
    cosine = np.einsum("ij,ij->i", to_observer, to_sun) / (range_km * sun_range_km)
    return LightPass(
        t_s=(t - (t[0] if len(t) else 0)) * 1e-9,
        mag=mag[order] - 5.0 * np.log10(range_km / STANDARD_KM),
        mag_err=mag_err[order],
        phase_rad=np.arccos(np.clip(cosine, -1.0, 1.0)),
    )


def split_by(labels: Sequence[int] | NDArray[np.int64]) -> list[NDArray[np.intp]]:
    """Indices of each label, in the order in which labels come first."""
    array = np.asarray(labels)
    _, first, inverse = np.unique(array, return_index=True, return_inverse=True)
    return [np.flatnonzero(inverse == k) for k in np.argsort(first)]
