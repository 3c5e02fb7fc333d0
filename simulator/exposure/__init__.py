"""Exposure: light that lands on pixels while the shutter is open, in mean photo-electrons."""

from simulator.exposure.stars import render_stars
from simulator.exposure.trails import render_trail, render_trail_table

__all__ = ["render_stars", "render_trail", "render_trail_table"]
