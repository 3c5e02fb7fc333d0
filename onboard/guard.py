"""Calls of swappable steps. An exception, or a result that breaks the Protocol, stops the run and names the step."""

from collections.abc import Callable
from typing import Any

from sboc_e2e.icd.errors import ContractError, PluginError, UserError


def guarded(seam: str, step: object, call: Callable[..., Any], *arguments: Any) -> Any:
    """Call a step, or a check of its result, and return the result. An exception becomes a `PluginError` that names the step.

    seam : such as "detector". A `UserError` about something that the user can mend passes; a record that breaks the contract
    is the step's fault.
    """
    try:
        return call(*arguments)
    except Exception as error:  # a plug-in may raise anything; it is reported by name
        if isinstance(error, UserError) and not isinstance(error, ContractError):
            raise
        what = str(error) if isinstance(error, ContractError) else f"{type(error).__name__}: {error}"
        raise PluginError(f"onboard.{seam} {type(step).__module__}:{type(step).__qualname__}: {what}") from error
