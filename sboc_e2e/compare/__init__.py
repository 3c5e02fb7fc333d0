"""Compare choices of one seam on the same frames: paired differences, curves, a gallery, and what each costs."""

from sboc_e2e.compare.compare import Request, compare

__all__ = ["Request", "compare"]
