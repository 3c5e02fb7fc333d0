"""What a run publishes, read from its files by readers of their own and compared with the truth.

Nothing here knows the code that wrote the files: messages are read by their standards (CCSDS 502.0-B, 503.0-B), tables by the
names of their columns. A defect of a writer therefore shows here, whatever the tables inside the run say.
"""

from sboc_e2e.score.published.section import published_products

__all__ = ["published_products"]
