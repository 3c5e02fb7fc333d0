"""Validation: a simulated frame beside a real one, statistic by statistic."""

from sboc_e2e.validation.validate import Request, validate

__all__ = ["Request", "validate"]
