"""Names in the code and of the tests: the field's words, not who said or was told what."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import imumon

ROOT = Path(imumon.__file__).parent
BANNED = {
    "told": "estimated, reported or known",
    "said": "reported, or what it is: text, warnings, metadata",
    "heard": "received",
    "asked": "requested or queried",
    "judge": "evaluate or test",
    "judged": "evaluated or tested",
}
"""Words of which no name consists, and what may be meant."""
ALLOWED = {"not_told_apart"}
"""A predicate of the verdict table, as its sentence reads."""


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of all that a module defines."""
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.ClassDef():
                yield node.lineno, node.name
            case ast.arg():
                yield node.lineno, node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.lineno, node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.lineno, node.attr


def test_names_are_words_of_the_field() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}: {BANNED[word]}?"
        for path in sorted(ROOT.rglob("*.py"))
        for line, name in names(ast.parse(path.read_text(encoding="utf-8")))
        for word in re.split(r"_+", name.lower())
        if word in BANNED and name not in ALLOWED
    ]
    assert found == []


def test_names_of_tests_are_words_of_the_field() -> None:
    found = [
        f"{path.name}: {name}: {BANNED[word]}?"
        for path in sorted(Path(__file__).parent.rglob("test_*.py"))
        for name in re.findall(r"def (test_\w+)", path.read_text(encoding="utf-8"))
        for word in name.replace("not_told_apart", "").split("_")
        if word in BANNED
    ]
    assert found == []
