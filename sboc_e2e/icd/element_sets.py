"""Lines of two-line element sets, as files carry them: which belong together, and whether their checksums are right.

Format: Hoots & Roehrich 1980, Spacetrack Report 3; a set may have a line with its name before it, which may begin with ``0 ``.
"""

from typing import Final

from sboc_e2e.icd.errors import UserError

LINE: Final = 69
"""Characters of a line of elements."""


def element_sets(text: str, source: str) -> list[tuple[str, str, str]]:
    """Name (that of the line before, else the catalogue number), first and second line of each set; other lines are left out.

    UserError that begins with `source` and names the line: for a line of a set that is shorter than 69 characters or whose
    checksum is wrong, and for half a set.
    """
    lines = [line.rstrip() for line in text.splitlines()]
    found: list[tuple[str, str, str]] = []
    paired: set[int] = set()
    for k in range(len(lines) - 1):
        pair = lines[k], lines[k + 1]
        if not (pair[0].startswith("1 ") and pair[1].startswith("2 ")):
            continue
        paired |= {k, k + 1}
        for number, line in enumerate(pair, k + 1):
            if len(line) < LINE or checksum(line) != line[LINE - 1]:
                raise UserError(f"{source}, line {number}: not an element line of 69 characters with a right checksum")
        title = lines[k - 1].strip() if k > 0 and not lines[k - 1].startswith(("1 ", "2 ")) else ""
        found.append((title.removeprefix("0 ").strip() or pair[1][2:7].strip(), *pair))
    for k, line in enumerate(lines):
        if k not in paired and len(line) == LINE and line.startswith(("1 ", "2 ")):
            raise UserError(f"{source}, line {k + 1}: half an element set; its other line must stand beside it")
    return found


def checksum(line: str) -> str:
    """Last digit of the sum of the first 68 characters' digits, minus signs counting one."""
    return str(sum(int(c) if c.isdigit() else c == "-" for c in line[: LINE - 1]) % 10)
