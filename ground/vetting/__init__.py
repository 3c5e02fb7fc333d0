"""Vetting: the probability that a fitted streak is a real object."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ground.vetting.likelihood import LikelihoodVetter

__all__ = ["LikelihoodVetter"]


def __getattr__(name: str) -> Any:
    """Import on first use: what a frame shows of its own false lines is learned without the fits of streaks."""
    if name not in __all__:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.likelihood"), name)
