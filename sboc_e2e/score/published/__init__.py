"""The published files of a run, read by independent readers and compared with the truth.

Nothing here knows the code that wrote the files: messages are read by their standards (CCSDS 502.0-B, 503.0-B), tables by the
names of their columns. A defect of a writer therefore shows here, even if the tables of the run are right.
"""

from sboc_e2e.score.published.section import published_products

__all__ = ["published_products"]
