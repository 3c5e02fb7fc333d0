"""Orbits from measurements: numerical propagation with its partial derivatives, batch least squares, precise reference orbits.

States are geocentric, GCRS axes, km and km/s; epochs TAI ns. Needs the extra `objects` (satkit and its data).
"""
