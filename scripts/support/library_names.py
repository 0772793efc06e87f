"""Write the table of public names at the end of docs/library.md from their docstrings."""

from __future__ import annotations

import inspect
from pathlib import Path

import imumon

PAGE = Path(__file__).resolve().parents[2] / "docs" / "library.md"
HEAD = "|---|---|\n"


def page() -> str:
    """Return the page as it should be."""
    before = PAGE.read_text(encoding="utf-8").rpartition(HEAD)[0]
    rows = [
        f"| `imumon.{name}{_signature(name)}` | {_first(name)} |" for name in imumon.__all__ if name[0] != "_"
    ]
    return before + HEAD + "\n".join(rows) + "\n"


def _signature(name: str) -> str:
    offered = getattr(imumon, name)
    if not inspect.isfunction(offered):
        return ""
    return "(" + ", ".join(inspect.signature(offered).parameters) + ")"


def _first(name: str) -> str:
    return (
        (inspect.getdoc(getattr(imumon, name)) or "")
        .partition("\n\n")[0]
        .replace("\n", " ")
        .replace("|", "\\|")
    )


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
