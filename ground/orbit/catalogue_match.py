"""Which tracklets are known objects: directions and rates against a catalogue of element sets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sgp4.api import Satrec, SatrecArray

from ground.orbit.attributable import attributable_of
from ground.orbit.dynamics import LIGHT_KM_S
from ground.orbit.observer import observer_orbit
from ground.orbit.reference import teme_to_gcrs, utc_jd
from ground.sky.sphere import ARCSEC_RAD
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import Tracklet

_FARTHEST_SIGMA = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownObjects:
    """A catalogue: names, catalogue numbers (n,) and the propagators of its element sets."""

    names: tuple[str, ...]
    numbers: NDArray[np.int64]
    satellites: tuple[Satrec, ...]


@dataclass(frozen=True, kw_only=True)
class CatalogueMatch:
    """The best catalogue object for a tracklet, observed minus computed.

    sigmas : distance in units of the element sets' expected errors. n_candidates : objects within four of them;
    known : at least one.
    """

    tracklet_id: int
    known: bool
    number: int
    name: str
    along_arcsec: float
    cross_arcsec: float
    rate_residual_arcsec_s: float
    range_km: float
    sigmas: float
    n_candidates: int


def read_elements(text: str) -> KnownObjects:
    """Objects of a two- or three-line element file; a name line may begin with ``0 ``.

    Errors: a `UserError` that names the line for one that starts an element set but has no second line or cannot be read.
    """
    names, satellites = [], []
    lines = [line.rstrip() for line in text.splitlines()]
    name = ""
    k = 0
    while k < len(lines):
        line = lines[k]
        if line.startswith("1 ") and len(line) >= 63:
            if k + 1 >= len(lines) or not lines[k + 1].startswith("2 "):
                raise UserError(f"element sets, line {k + 2}: expected a line that starts with '2 ' after '{line[:20]}...'")
            try:
                satellites.append(Satrec.twoline2rv(line, lines[k + 1]))
            except ValueError as error:
                raise UserError(f"element sets, line {k + 1}: expected a two-line element set, got '{line[:30]}...'") from error
            names.append(name or line[2:7])
            name = ""
            k += 2
            continue
        name = line[2:].strip() if line.startswith("0 ") else line.strip()
        k += 1
    numbers = np.array([s.satnum for s in satellites], dtype=np.int64)
    return KnownObjects(names=tuple(names), numbers=numbers, satellites=tuple(satellites))


def match_catalogue(
    tracklets: Sequence[Tracklet],
    headers: Sequence[FrameHeader],
    known: KnownObjects,
    *,
    along_km: float = 3.0,
    cross_km: float = 1.0,
    age_km_day: float = 1.0,
) -> tuple[CatalogueMatch, ...]:
    """The best match of each tracklet that has sky positions and an observer state; the others are left out.

    along_km, cross_km : one sigma of fresh element sets along and across the object's motion; age_km_day is added along it.
    """
    out = []
    array = SatrecArray(list(known.satellites)) if known.satellites else None
    for tracklet in tracklets:
        data = attributable_of(tracklet, 0.1)
        if data is None or array is None:
            continue
        t_ns = data.t_ref_tai_ns
        observer = observer_orbit(headers, int(tracklet.t_tai_ns.min()), int(tracklet.t_tai_ns.max()), t_ns)
        if observer is None:
            continue
        day, fraction = utc_jd([t_ns])
        failed, position, velocity = array.sgp4(day, fraction)
        turn = teme_to_gcrs(t_ns)
        position, velocity = position[:, 0] @ turn.T, velocity[:, 0] @ turn.T
        relative = position - observer[:3]
        rho = np.linalg.norm(relative, axis=1)
        # the light left rho / c earlier
        relative -= velocity * (rho / LIGHT_KM_S)[:, None]
        plane, depth = relative @ data.axes[:2].T, relative @ data.axes[2]
        ahead = (failed[:, 0] == 0) & (depth > 0.95 * rho)
        offset = -plane / np.where(ahead, depth, np.nan)[:, None]
        moving = (velocity - observer[3:]) @ data.axes[:2].T / rho[:, None]
        speed = np.linalg.norm(moving, axis=1, keepdims=True)
        heading = moving / np.where(speed > 0.0, speed, 1.0)
        along = np.einsum("ij,ij->i", offset, heading)
        cross = heading[:, 0] * offset[:, 1] - heading[:, 1] * offset[:, 0]
        rate_error = np.linalg.norm(data.rate_rad_s - moving, axis=1)
        age_day = np.abs(np.array([s.jdsatepoch + s.jdsatepochF for s in known.satellites]) - day[0] - fraction[0])
        spread = (along_km + age_km_day * age_day) / rho
        rate_sigma = np.sqrt(np.trace(data.rate_covariance)) + 2e-3 * (along_km + age_km_day * age_day) / rho
        sigmas = np.sqrt((along / spread) ** 2 + (cross * rho / cross_km) ** 2 + (rate_error / rate_sigma) ** 2)
        sigmas = np.where(np.isfinite(sigmas), sigmas, np.inf)
        best = int(np.argmin(sigmas))
        if not np.isfinite(sigmas[best]):
            continue
        out.append(
            CatalogueMatch(
                tracklet_id=tracklet.tracklet_id,
                known=bool(sigmas[best] < _FARTHEST_SIGMA),
                number=int(known.numbers[best]),
                name=known.names[best],
                along_arcsec=float(along[best] / ARCSEC_RAD),
                cross_arcsec=float(cross[best] / ARCSEC_RAD),
                rate_residual_arcsec_s=float(rate_error[best] / ARCSEC_RAD),
                range_km=float(rho[best]),
                sigmas=float(sigmas[best]),
                n_candidates=int((sigmas < _FARTHEST_SIGMA).sum()),
            )
        )
    return tuple(out)
