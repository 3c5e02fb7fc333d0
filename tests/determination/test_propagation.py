"""Tables of Sun, Moon and Earth rotation that propagations share change no orbit that anyone could measure."""

import math
from typing import Any

import numpy as np
import pytest

from ground.determination.forces import ForceModel
from ground.determination.propagation import _settings_with_table, instant, propagate
from sboc_e2e.icd import tai
from tests.association.list_simulator import kepler

satkit = pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

T0 = 2_152_656_037 * tai.NS_PER_S + 123_456_789_012
FORCES = ForceModel(gravity_degree=8)
"""Without radiation pressure: at the edges of the Earth's shadow the integrator itself is uncertain by decimetres in days."""
ORBITS = {
    "700 km": kepler(7_078.0, 0.001, math.radians(98.2), 1.0, 0.5, 0.3),
    "navigation": kepler(26_560.0, 0.01, math.radians(55.0), 2.0, 0.5, 0.3),
    "geostationary": kepler(42_164.0, 0.0005, math.radians(0.1), 0.4, 0.5, 0.3),
}


def with_a_table_of_its_own(state: np.ndarray, t_tai_ns: np.ndarray) -> np.ndarray:
    """Places (n, 3) km as satkit itself finds them."""
    settings = satkit.propsettings(
        abs_error=1e-7,
        rel_error=1e-11,
        gravity_degree=8,
        tide_model=satkit.tidemodel.solid_full,
        use_relativistic_correction=True,
    )
    run: Any = satkit.propagate(1e3 * state, instant(T0), instant(int(t_tai_ns[-1])), propsettings=settings)
    return 1e-3 * np.array([run.interp(instant(int(t)))[:3] for t in t_tai_ns])


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("days", [0.003, -0.4, 5.0])
def test_a_shared_table_moves_no_orbit_by_a_millimetre(name: str, days: float) -> None:
    t = T0 + np.round(np.linspace(0.1, 1.0, 10) * days * tai.NS_PER_DAY).astype(np.int64)
    ours = propagate(ORBITS[name], T0, t, FORCES).states[:, :3]
    assert 1e6 * np.abs(ours - with_a_table_of_its_own(ORBITS[name], t)).max() < 1.0


def test_results_do_not_depend_on_what_was_propagated_before() -> None:
    t = np.array([T0 + 3 * tai.NS_PER_DAY])
    _settings_with_table.cache_clear()
    first = propagate(ORBITS["navigation"], T0, t, FORCES, partials=True)
    propagate(ORBITS["navigation"], T0, t + 2 * tai.NS_PER_DAY, FORCES)
    _settings_with_table.cache_clear()
    propagate(ORBITS["700 km"], T0, t + tai.NS_PER_DAY, FORCES)
    again = propagate(ORBITS["navigation"], T0, t, FORCES, partials=True)
    assert (again.states == first.states).all()
    assert (again.partials == first.partials).all()
