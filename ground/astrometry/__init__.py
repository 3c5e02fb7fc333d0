"""Star list to camera: apparent directions of catalogue stars, matching, and the fit of attitude and distortion."""
