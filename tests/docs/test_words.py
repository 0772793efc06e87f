"""Words of docs, help and messages: what is estimated, detected or tested is not "told" or "said"."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import imumon

CODE = Path(imumon.__file__).parent
ROOT = CODE.parent
BANNED = {
    r"told": "estimated, reported, distinguished or set",
    r"said": "reported, warned of or written",
    r"nobody": "say what is unknown or not recorded",
    r"hears?|heard": "received, or listens",
    r"asked|asks": "queried, requested or required",
    r"judge[sd]?": "evaluated or tested",
    r"lively": "noisy",
    r"sound": "valid",
    r"says? so": "name the message, the warning or the comment",
    r"(?:is|are|was|were) seen": "detected, measured or shown",
}
"""Words with private meanings, and what may be meant (regular expressions, whole words)."""
ALLOWED = re.compile("not told apart|not_told_apart")
"""A sentence of the verdict table."""
PAGES = [
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "tutorials").glob("*.md")),
    *sorted((ROOT / "docs" / "how-to").glob("*.md")),
    *sorted((ROOT / "docs" / "appendix").glob("*.md")),
    *sorted((ROOT / ".github").rglob("*.*")),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
]


def found_in(text: str) -> list[str]:
    """Return the banned words in a text, and what may be meant."""
    rest = ALLOWED.sub("", text)
    return [
        f"{match[0]}: {instead}?  ...{rest[max(0, match.start() - 40) : match.end() + 30]!r}"
        for word, instead in BANNED.items()
        for match in re.finditer(rf"\b(?:{word})\b", rest, re.IGNORECASE)
    ]


def texts(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of literals of several words, docstrings among them."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield node.lineno, node.value


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_page_has_the_words_of_the_field(page: Path) -> None:
    assert found_in(page.read_text(encoding="utf-8")) == []


def test_messages_and_docstrings_have_the_words_of_the_field() -> None:
    assert [
        f"{path.relative_to(CODE)}:{line}: {word}"
        for path in sorted(CODE.rglob("*.py"))
        for line, text in texts(ast.parse(path.read_text(encoding="utf-8")))
        for word in found_in(text)
    ] == []


def test_the_words_are_found() -> None:
    assert len(found_in("Nobody said that this was seen; they cannot be told apart.")) == 4
    assert found_in("gyro_x: lag or dead_time, not told apart; the sounding saying") == []
