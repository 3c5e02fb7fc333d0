"""Coverage-guided fuzz targets (extra `fuzz`): ``python -m tests.fuzz packets -runs=1000000``."""
