"""Tables of a run with units and descriptions, ready to be written as ECSV: frames, stars, streaks, tracklets, orbits.

Tables with rows for each frame, star or streak come in pieces, of which one is in memory at a time.
"""

from ground.products.tables.frames import frames_tables
from ground.products.tables.known import known_table
from ground.products.tables.orbits import orbits_table
from ground.products.tables.stars import stars_tables
from ground.products.tables.streaks import streaks_tables
from ground.products.tables.tracklets import tracklets_table

__all__ = ["frames_tables", "known_table", "orbits_table", "stars_tables", "streaks_tables", "tracklets_table"]
