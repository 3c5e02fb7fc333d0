"""Vetting: the probability that a fitted streak is a real object."""

from ground.vetting.likelihood import LikelihoodVetter

__all__ = ["LikelihoodVetter"]
