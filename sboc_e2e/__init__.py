"""End-to-end demonstrator of a space-based optical camera (SBOC) for debris."""

__version__ = "0.1.0"
