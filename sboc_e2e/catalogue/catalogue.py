"""Cone searches in a packed star catalogue held in memory."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.catalogue import packed
from sboc_e2e.catalogue.healpix import NSIDE, pixels_in_cone
from sboc_e2e.catalogue.proper_motion import MAS_PER_RAD, propagate
from sboc_e2e.catalogue.stars import CatalogueFlag, Stars
from sboc_e2e.icd.errors import UserError

EMBEDDED_PATH: Final = Path(__file__).parent / "data" / "tycho2_v11.npz"

FASTEST_MAS_YR: Final = 10_400.0
"""Barnard's star moves faster than any other star; bounds how far a star can stray from its pixel."""

UNKNOWN_MOTION_MAS_YR: Final = 20.0
"""Typical proper motion of a star whose motion is not in the catalogue: its position error grows by this much a year."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StarCatalogue:
    """A star catalogue; make one with `embedded` or `open`.

    name, provenance : where it comes from, in words. v_max : its depth. n_stars : its size.
    pixel_counts : (49152,) int64, stars of each HEALPix pixel (`nside` 64, NESTED).
    """

    name: str
    provenance: str
    v_max: float
    epoch_jyear: float
    pixel_counts: NDArray[np.int64]
    _start: NDArray[np.int64]
    _columns: dict[str, NDArray[Any]]

    nside = NSIDE

    @classmethod
    def embedded(cls) -> "StarCatalogue":
        """Tycho-2 to V < 11, 945,995 stars, shipped with the program; read once per process."""
        return _embedded()

    @classmethod
    def open(cls, path: str | Path) -> "StarCatalogue":
        """A catalogue made by `sboc catalogue build`; `UserError` when it is missing, truncated or something else."""
        path = Path(path)
        if not path.is_file():
            raise UserError(f"star catalogue {path}: no such file; make one with `sboc catalogue build`")
        try:
            content = packed.read_packed(path)
        except ValueError as error:
            raise UserError(f"star catalogue {path}: {error}; make it again with `sboc catalogue build`") from error
        counts = content["counts"].astype(np.int64)
        n_stars = int(counts.sum())
        if n_stars == 0:
            raise UserError(f"star catalogue {path}: holds no stars; make it again with `sboc catalogue build`")
        hip = np.zeros(n_stars, dtype=np.int32)
        hip[np.cumsum(content["hip_row"])] = content["hip_number"]
        pm = np.stack((content["pm_ra"], content["pm_dec"]), axis=1).astype(np.int32)
        pm[content["fast_row"]] = content["fast_pm"]
        taken = ("ra", "dec", "v_mag", "b_v", "flags", "sigma", "sigma_pm", "mean_epoch", "source_id")
        return cls(
            name=str(content["name"]),
            provenance=str(content["provenance"]),
            v_max=float(content["v_max"]),
            epoch_jyear=float(content["epoch_jyear"]),
            pixel_counts=counts,
            _start=np.concatenate(([0], np.cumsum(counts))),
            _columns={**{key: content[key] for key in taken}, "pm": pm, "hip": hip},
        )

    @property
    def n_stars(self) -> int:
        """Number of stars."""
        return int(self._start[-1])

    def cone(
        self, ra_deg: float, dec_deg: float, radius_deg: float, *, epoch_jyear: float = 2000.0, v_max: float | None = None
    ) -> Stars:
        """Stars that stand within `radius_deg` of a direction (ICRS) at `epoch_jyear`, in sky order.

        v_max : only stars with V below it. Errors grow with the distance from the mean epoch by the quoted error of the
        proper motion, or by `UNKNOWN_MOTION_MAS_YR` where there is none.
        """
        ra, dec = np.radians(ra_deg), np.radians(dec_deg)
        axis = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        years = epoch_jyear - self.epoch_jyear
        radius_rad = float(np.radians(radius_deg))
        stray_rad = abs(years) * FASTEST_MAS_YR / MAS_PER_RAD
        # a chord cannot tell angles beyond 180 deg apart, so that cones of the whole sky skip the last cut
        stars = self._at_epoch(self._rows_of(pixels_in_cone(axis, radius_rad + stray_rad)), epoch_jyear, v_max)
        if radius_rad >= np.pi:
            return stars
        ra, dec = np.radians(stars.ra_deg), np.radians(stars.dec_deg)
        chord2 = (
            (np.cos(dec) * np.cos(ra) - axis[0]) ** 2 + (np.cos(dec) * np.sin(ra) - axis[1]) ** 2 + (np.sin(dec) - axis[2]) ** 2
        )
        return stars.take(chord2 <= (2.0 * np.sin(0.5 * radius_rad)) ** 2)

    def _rows_of(self, pixels: NDArray[np.intp]) -> NDArray[np.intp]:
        """Row numbers of all stars of the given pixels."""
        counts = self.pixel_counts[pixels]
        total = int(counts.sum())
        first_of_run = np.repeat(self._start[pixels] - np.concatenate(([0], np.cumsum(counts)[:-1])), counts)
        return first_of_run + np.arange(total)

    def _at_epoch(self, rows: NDArray[np.intp], epoch_jyear: float, v_max: float | None) -> Stars:
        """Decode rows and apply proper motion."""
        column = self._columns
        if v_max is not None:
            rows = rows[column["v_mag"][rows] * packed.V_UNIT_MAG < v_max]
        pm = column["pm"][rows] * packed.PM_UNIT_MAS_YR
        ra_deg, dec_deg, pm_ra, pm_dec = propagate(
            column["ra"][rows] / packed.ANGLE_UNITS_PER_DEG,
            column["dec"][rows] / packed.ANGLE_UNITS_PER_DEG - 90.0,
            pm[:, 0],
            pm[:, 1],
            epoch_jyear - self.epoch_jyear,
        )
        flags = column["flags"][rows]
        sigma_pm = column["sigma_pm"][rows] * packed.SIGMA_PM_UNIT_MAS_YR
        sigma_pm = np.where(flags & CatalogueFlag.NO_PROPER_MOTION, UNKNOWN_MOTION_MAS_YR, sigma_pm)
        since_mean = epoch_jyear - (column["mean_epoch"][rows] + packed.EPOCH_ZERO_JYEAR)
        sigma = np.hypot(column["sigma"][rows] * packed.SIGMA_UNIT_MAS, sigma_pm * since_mean)
        return Stars(
            epoch_jyear=epoch_jyear,
            ra_deg=ra_deg,
            dec_deg=dec_deg,
            pm_ra_mas_yr=pm_ra.astype(np.float32),
            pm_dec_mas_yr=pm_dec.astype(np.float32),
            v_mag=(column["v_mag"][rows] * packed.V_UNIT_MAG).astype(np.float32),
            b_v=(column["b_v"][rows] * packed.B_V_UNIT_MAG).astype(np.float32),
            sigma_mas=sigma.astype(np.float32),
            flags=flags,
            source_id=column["source_id"][rows],
            hip=column["hip"][rows],
        )


@cache
def _embedded() -> StarCatalogue:
    return StarCatalogue.open(EMBEDDED_PATH)
