"""Surveys: which debris passes the field in hours and years, and how it shows in each frame, without a pixel.

The objects, orbits, pointing, light and densities are those of the pixel chain; only the image is missing. Time is divided into
blocks, each with random streams of its own, so that any worker makes any block with the same bytes. A block's passages are a
Poisson process: candidates as in `scene.encounters` stand for ``w`` objects of nature each, and each is kept ``floor(w + u)``
times, u uniform in [0, 1). Where no w exceeds 1, their number scatters as nature's does.
"""
