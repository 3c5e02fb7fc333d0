"""Frames that we did not make: FITS files of any telescope or simulator through the same door as simulated frames."""
