"""The calibrated image of a frame: counts, dark map, masks, background, sky without stars, registration with earlier frames."""
