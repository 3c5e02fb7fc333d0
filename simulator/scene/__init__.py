"""Scene: what shines (stars, sky, objects) and what lies between it and the aperture (Earth shadow, atmosphere)."""
