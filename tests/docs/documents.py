"""What the documents tell a reader to type: commands in `sh` blocks, files to write, commands named in a sentence."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
DOCUMENTS: Final = (
    "README.md",
    "CHANGELOG.md",
    "LICENSES.md",
    "CONTRIBUTING.md",
    "sboc_e2e/icd/ICD.md",
    *(str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))),
)
PROGRAMS: Final = ("sboc", ".venv/bin/sboc", "make", "python", "pip", "pytest")

_BLOCK = re.compile(r"^```(\w*)([^\n]*)\n(.*?)^```[ ]*$", re.MULTILINE | re.DOTALL)
_INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")


@dataclass(frozen=True, kw_only=True)
class Block:
    """A fenced block: its language, the note after the language ("file=..." or "run"), its text."""

    language: str
    note: str
    text: str

    @property
    def file(self) -> str | None:
        """The file that the reader is told to write."""
        return self.note.removeprefix("file=") if self.note.startswith("file=") else None

    @property
    def commands(self) -> tuple[str, ...]:
        """Lines of a block of commands, without the remarks behind them."""
        if self.language != "sh":
            return ()
        lines = (line.partition("  #")[0].strip() for line in self.text.splitlines())
        return tuple(line for line in lines if line)


def text_of(document: str) -> str:
    """The text of a document."""
    return (ROOT / document).read_text(encoding="utf-8")


def blocks(document: str) -> tuple[Block, ...]:
    """Fenced blocks in order."""
    found = _BLOCK.findall(text_of(document))
    return tuple(Block(language=language, note=note.strip(), text=text) for language, note, text in found)


def starts_a_program(line: str) -> bool:
    """Whether a line is something to type."""
    return line.strip().partition(" ")[0] in PROGRAMS


def hidden_commands(document: str) -> list[str]:
    """Commands outside `sh` blocks and sentences, where nothing would run them."""
    fenced = [
        line for b in blocks(document) if b.language in ("", "text", "console", "bash", "shell") for line in b.text.splitlines()
    ]
    rest = _BLOCK.sub("", text_of(document)).splitlines()
    return [line for line in fenced if starts_a_program(line)] + [
        line for line in rest if line.startswith(("    ", "\t")) and starts_a_program(line)
    ]


def named_commands(document: str) -> list[str]:
    """Commands that a sentence or a table names, such as `sboc schema`."""
    rest = _BLOCK.sub("", text_of(document))
    return [text for text in _INLINE.findall(rest) if starts_a_program(text)]
