"""Every constant says what it is and why it has its value: words beside it or below it."""

import ast
import io
import re
import textwrap
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("simulator", "onboard", "ground", "sboc_e2e")
FEWEST_WORDS = 3  # a name, a verb and an object; "of the file" says nothing, but no test can tell
ORDERS_TO_TOOLS = re.compile(r"#\s*(noqa|type:|fmt:|ruff:|mypy:|pragma).*")


def _is_numeric(value: ast.expr) -> bool:
    """Whether an expression is a number, a tuple of numbers, or arithmetic of literals."""
    match value:
        case ast.Constant(value=number):
            return isinstance(number, int | float | complex) and not isinstance(number, bool)
        case ast.UnaryOp(operand=operand):
            return _is_numeric(operand)
        case ast.BinOp(left=left, right=right):
            return _is_numeric(left) and _is_numeric(right)
        case ast.Tuple(elts=elements):
            return bool(elements) and all(_is_numeric(element) for element in elements)
    return False


def _constants(tree: ast.Module) -> Iterator[tuple[ast.stmt, str, ast.stmt | None]]:
    """Assignments of numbers to uppercase names at module level, with the name and the statement that follows."""
    for statement, following in zip(tree.body, [*tree.body[1:], None], strict=True):
        match statement:
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                pass
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                pass
            case _:
                continue
        if name.isupper() and _is_numeric(value):
            yield statement, name, following


def bare_constants(source: str) -> list[tuple[int, str]]:
    """Line and name of each numeric constant of a module without enough words beside or below it."""
    beside: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            beside[token.start[0]] = ORDERS_TO_TOOLS.sub("", token.string)
    bare = []
    for statement, name, following in _constants(ast.parse(source)):
        lines = range(statement.lineno, (statement.end_lineno or statement.lineno) + 1)
        words = " ".join(beside.get(line, "") for line in lines)
        match following:
            case ast.Expr(value=ast.Constant(value=str(text))):
                words += f" {text}"
        if len(re.findall(r"\S*\w\S*", words)) < FEWEST_WORDS:
            bare.append((statement.lineno, name))
    return bare


def test_constants_have_words() -> None:
    """Numbers without a reason cannot be questioned; with one, the next reader can measure again."""
    offenders = [
        f"{path.relative_to(ROOT)}:{line} {name}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for line, name in bare_constants(path.read_text(encoding="utf-8"))
    ]
    assert not offenders, f"{len(offenders)} constants without {FEWEST_WORDS} words beside or below:\n" + "\n".join(offenders)


@pytest.mark.parametrize(
    ("source", "bare"),
    [
        ("A = 1\n", ["A"]),
        ("A: Final = 1  # metres of cable laid\n", []),
        ("A: Final = 1  # two words\n", ["A"]),
        ('A: Final = 1\n"""Metres of cable."""\n', []),
        ('A: Final = 1\nB: Final = 2\n"""Words below the second one."""\n', ["A"]),
        ("# words above are not beside it\nA = 1\n", ["A"]),
        ("A = 1  # noqa: E501 one two three\n", ["A"]),
        ('A = 1\nprint("no words of a constant at all")\n', ["A"]),
        ("A = (\n    1,  # the first number here\n    2,\n)\n", []),
        ("A = ((1.0, 2.0), (-3, 4 * 2**10))\n", ["A"]),
        ("_A = -1.0 / 12.0\n", ["_A"]),
        ('A = "1"\nB = True\nC = (1, "a")\nD = A + 1\nE = ()\nlower = 1\ndef f():\n    A = 1\n', []),
        ('A = 1\n"""# 1 2 three words"""\n', []),
    ],
)
def test_bare_constants_are_told(source: str, bare: list[str]) -> None:
    """What counts as words, and what counts as a constant."""
    assert [name for _, name in bare_constants(textwrap.dedent(source))] == bare
