"""Axes of messages to GCRS, the axes of the truth."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

_ARCSEC: Final = np.pi / 648_000.0
_DPSI, _DEPS, _DRA = -0.041775 * _ARCSEC, -0.0068192 * _ARCSEC, -0.0146 * _ARCSEC
"""Offsets of the J2000.0 pole and equinox (IERS Conventions 2003, eq. 28 and 30)."""
_EPS0 = 84_381.448 * _ARCSEC


def _turn(axis: int, angle: float) -> Array:
    """Rotation of the axes about one of them."""
    out = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out[i, i] = out[j, j] = np.cos(angle)
    out[i, j], out[j, i] = np.sin(angle), -np.sin(angle)
    return out


_BIAS: Final = _turn(0, -_DEPS) @ _turn(1, _DPSI * np.sin(_EPS0)) @ _turn(2, _DRA)

AXES: Final[dict[str, Array]] = {"EME2000": _BIAS.T, "GCRF": np.eye(3), "ICRF": np.eye(3)}
"""Matrices (3, 3) that take components on the named axes to GCRS components."""


def gcrs_from(frame: str) -> Array:
    """Matrix (3, 3) to GCRS. Raises UserError for axes that are not known."""
    if frame not in AXES:
        raise UserError(f"axes {frame[:40]} are not read; read are {', '.join(AXES)}")
    return AXES[frame]


def unit_vectors(ra_deg: Array, dec_deg: Array) -> Array:
    """Unit vectors (n, 3) of angles (n,)."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def orbital_axes(position: Array, velocity: Array) -> Array:
    """Matrix (3, 3) from radial, transverse, normal components to those of the state's own axes."""
    radial = position / np.linalg.norm(position)
    normal = np.cross(position, velocity)
    normal /= np.linalg.norm(normal)
    return np.stack([radial, np.cross(normal, radial), normal], axis=1)
