"""The answer to one question of an exam."""

from collections.abc import Callable
from dataclasses import dataclass

from sboc_e2e.icd.errors import ContractError


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The answer to one question. detail : why it failed, or how well it was answered."""

    question: str
    passed: bool
    detail: str


class Failed(Exception):
    """A trial's finding."""


def asked(question: str, trial: Callable[[], object]) -> Verdict:
    """A verdict: passed unless the trial raises; a text that it returns says how well."""
    try:
        answer = trial()
    except Exception as error:  # noqa: BLE001 - a plug-in may raise anything; that is what is being examined
        text = str(error).splitlines()[0] if str(error) else "no reason given"
        kind = "" if isinstance(error, Failed | ContractError) else f"{type(error).__name__}: "
        return Verdict(question=question, passed=False, detail=f"{kind}{text}"[:200])
    return Verdict(question=question, passed=True, detail=answer if isinstance(answer, str) else "")


def expect(condition: bool, otherwise: str) -> None:
    """Raise `Failed` with a reason unless a condition holds."""
    if not condition:
        raise Failed(otherwise)
