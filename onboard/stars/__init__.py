"""The star list of a frame: peaks, fits, the shape of the PSF, trailed stars; and stars remembered from earlier frames."""
