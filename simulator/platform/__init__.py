"""Platform: where the camera is, where it looks, and what its clock, GPS and star tracker say of it."""
