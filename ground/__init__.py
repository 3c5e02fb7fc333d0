"""Ground segment: packets to streaks, sky positions and magnitudes, to tracklets, orbits and products.

Knows the downlink, the calibration and a star catalogue; nothing else.
"""
