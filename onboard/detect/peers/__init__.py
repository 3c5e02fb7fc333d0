"""Published methods and common baselines, for comparison with the detector that flies. None is meant to fly."""
