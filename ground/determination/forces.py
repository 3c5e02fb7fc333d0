"""What acts on an object, and the propagator's data, found where their packages put them; nothing is ever downloaded."""

from dataclasses import dataclass, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import astropy_iers_data

from sboc_e2e.icd.errors import UserError

LEAKS: Final = ("leak_x", "leak_y", "leak_z")
LEAK_RATES: Final = ("leak_x_rate", "leak_y_rate", "leak_z_rate")
PARAMETERS: Final = ("drag", "radiation", "sun", "panel", "third", "third_cos", "third_sin", *LEAKS, *LEAK_RATES)
"""Force parameters that may be estimated.

drag, radiation : coefficient times area over mass, m^2/kg. sun, panel, third, third_cos, third_sin : accelerations (m/s^2 at one
astronomical unit) towards the Sun, along the panels' axis, and along the third axis: constant, cosine and sine of the argument of
latitude (Beutler et al. 1994, Manuscripta Geodaetica 19, 367: the reduced model of CODE). leak_x, leak_y, leak_z : accelerations
(m/s^2) along the axes of GCRS at the epoch of the state; leak_x_rate, ... : their change with time from there (m/s^3).
"""
_STEP: Final = (
    {"drag": 1e-3, "radiation": 1e-3}
    | dict.fromkeys(PARAMETERS[2:7], 1e-9)
    | dict.fromkeys(LEAKS, 1e-8)
    | dict.fromkeys(LEAK_RATES, 1e-12)
)


@dataclass(frozen=True, kw_only=True)
class ForceModel:
    """Gravity of the Earth to a degree, Sun, Moon, solid tides, relativity, drag (NRLMSISE-00), radiation pressure, leaks."""

    gravity_degree: int = 20
    tides: bool = True
    relativity: bool = True
    drag: float = 0.0
    radiation: float = 0.0
    sun: float = 0.0
    panel: float = 0.0
    third: float = 0.0
    third_cos: float = 0.0
    third_sin: float = 0.0
    leak_x: float = 0.0
    leak_y: float = 0.0
    leak_z: float = 0.0
    leak_x_rate: float = 0.0
    leak_y_rate: float = 0.0
    leak_z_rate: float = 0.0

    def __post_init__(self) -> None:
        if not 2 <= self.gravity_degree <= 70:
            raise UserError(f"forces: gravity_degree: expected 2 to 70, got {self.gravity_degree}")

    def value_of(self, name: str) -> float:
        """Value of a parameter."""
        return float(getattr(self, name))

    def with_values(self, names: tuple[str, ...], values: Any) -> "ForceModel":
        """The same forces with some parameters (k,) replaced."""
        changed: dict[str, Any] = {name: float(value) for name, value in zip(names, values, strict=True)}
        return replace(self, **changed)


def step_of(name: str) -> float:
    """Step of a parameter in numerical derivatives."""
    return _STEP[name]


@cache
def propagator() -> Any:
    """The module satkit, told where Earth orientation, ephemeris and space weather are. UserError without the extra."""
    spec = find_spec("satkit_data")
    if find_spec("satkit") is None or spec is None or spec.origin is None:
        raise UserError('orbits need satkit and satkit-data: pip install "sboc-e2e[objects]"')
    import satkit

    satkit.utils.set_offline(True)
    satkit.utils.add_search_dir(str(Path(spec.origin).parent / "data"))
    satkit.utils.add_search_dir(str(Path(astropy_iers_data.IERS_A_FILE).parent))
    return satkit
