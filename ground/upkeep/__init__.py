"""Keeping the catalogue: a night's tracklets are correlated, orbits renewed, new objects found, old ones lost, found, merged."""
