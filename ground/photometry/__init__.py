"""Electrons to magnitudes: calibrated streak pixels, zero point of a frame, magnitude and size of a streak."""
