"""Scene: sources of light (stars, sky, objects) and effects on its way to the aperture (Earth shadow, atmosphere)."""
