"""Comments of CCSDS messages in keyword-value notation, in lines as long as 502.0-B and 503.0-B allow."""

import textwrap
from typing import Final

LONGEST_LINE: Final = 254
"""Characters of a line of KVN, at most."""


def comment_lines(text: str) -> list[str]:
    """The text as one comment line, or as many as it takes."""
    return [f"COMMENT {line}" for line in textwrap.wrap(text, LONGEST_LINE - len("COMMENT "), break_on_hyphens=False)]
