"""Simulator and ground each write the Sun's brightness down for themselves; both must have the published value."""

import math

import pytest

from ground.orbit import size
from simulator.scene import reflection

ABSOLUTE_V_MAG = 4.81
"""Vega system: Willmer 2018, ApJS 236, 47, table 3; given to 0.01 mag."""
PARSEC_AU = 648000.0 / math.pi


@pytest.mark.parametrize("module", [reflection, size])
def test_the_sun_at_1_au_is_that_of_willmer_2018(module):
    assert abs(module.SUN_V_MAG - (ABSOLUTE_V_MAG - 5.0 * math.log10(10.0 * PARSEC_AU))) < 0.005


def test_both_halves_have_the_same_sun():
    assert reflection.SUN_V_MAG == size.SUN_V_MAG
