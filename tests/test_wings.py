"""The core knows no wing; what a wing brings is found."""

from __future__ import annotations

import re

from support import rooms

from imumon.cli import OWN, commands
from imumon.wing import GROUPS


def test_no_room_of_the_core_imports_a_wing() -> None:
    names = rooms.wings()
    core = [path for path in rooms.PACKAGE.rglob("*.py") if rooms.room_of(path) not in names]
    assert not [(path, room) for path in core for room in rooms.imported(path) if room in names]


def test_the_drawing_in_the_docs_is_that_of_the_imports() -> None:
    """But for the numbers of lines, which change with every edit."""

    def without_lines(text: str) -> list[str]:
        return [re.sub(r" [\d, ]+ lines", "", line) for line in text.splitlines() if line.startswith("    ")]

    page = rooms.PAGE.read_text(encoding="utf-8").partition(rooms.BEGIN)[2].partition(rooms.END)[0]
    assert without_lines(page) == without_lines(rooms.drawing())


def test_every_command_stands_under_a_heading_of_the_help() -> None:
    assert {*OWN} <= {*GROUPS}
    assert {command.group for command in commands().values()} == {*GROUPS}
