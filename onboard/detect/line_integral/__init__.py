"""`onboard.detector: line_integral`: `detector` knows the order of the steps; every other module does one and serves it alone."""
