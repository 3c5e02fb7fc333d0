"""Three kinds of errors: the user can mend it, the data break the contract, or a plug-in is at fault."""


class SbocError(Exception):
    """Base of every error that the project raises on purpose; its text is one line.

    Texts quote what users and files wrote: line breaks and control characters in them become spaces.
    """

    def __init__(self, text: str) -> None:
        super().__init__("".join(letter if letter.isprintable() else " " for letter in str(text)))


class UserError(SbocError):
    """Something the user can mend: one line that says what is wrong, where, and what is allowed (exit code 2)."""


class ContractError(UserError, ValueError):
    """A value that breaks the contract: names the field, what was expected and what came."""


class PluginError(SbocError):
    """A swappable step raised, or returned what its Protocol forbids; names the step (exit code 3)."""
