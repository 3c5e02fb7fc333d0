"""Radiation: particles through the sensitive layer -> charge in pixels."""

from simulator.radiation.belts import GeodeticPosition
from simulator.radiation.field import ParticleField
from simulator.radiation.hits import HitList
from simulator.radiation.options import RadiationOptions

__all__ = ["GeodeticPosition", "HitList", "ParticleField", "RadiationOptions"]
