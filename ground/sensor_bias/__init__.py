"""Clock, pointing and noise of a sensor from objects of precise orbits, night by night or orbit by orbit, and their removal."""
