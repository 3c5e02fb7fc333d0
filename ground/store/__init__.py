"""The object catalogue at rest: tracklets, orbits with their history, associations, and who or what decided. Extra `objects`."""
