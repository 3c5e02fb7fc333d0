"""Optics: where light falls (projection), how wide (PSF, defocus) and how much (vignetting)."""
