"""Ground segment: packets to streaks, sky positions and magnitudes, to tracklets, orbits and products.

Its inputs are the downlink, the calibration and a star catalogue.
"""
