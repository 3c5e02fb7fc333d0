"""Detector: mean photo-electrons -> charge -> volts -> ADU, with a fixed pattern drawn once for each sensor."""

from simulator.sensor.options import SensorOptions
from simulator.sensor.sensor import DeliveredPixels, Sensor

__all__ = ["DeliveredPixels", "Sensor", "SensorOptions"]
