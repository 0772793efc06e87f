"""The core knows no wing; what a wing brings is found, also that of another package."""

from __future__ import annotations

import re
import sys
from importlib.metadata import EntryPoint
from types import ModuleType

import pytest
from support import rooms

from imumon import plugins, wing
from imumon.cli import OWN, commands
from imumon.wing import GROUPS, Command, Wing


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


def test_a_wing_of_another_package_brings_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("another_wing")
    commands_of = {"other": Command("Devices", "Do something else.", "another_wing")}
    module.WING = Wing("another", commands_of, import_log="json:loads")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "another_wing", module)
    entry = EntryPoint("another", "another_wing:WING", plugins.WINGS)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [entry] if group == plugins.WINGS else [])
    plugins.plugins.cache_clear()
    commands.cache_clear()
    try:
        assert wing.wings()[-1].name == "another"
        ours, theirs = wing.offers("import_log")
        assert (ours.__module__, theirs.__module__) == ("imumon.logs.importing", "json")
        assert commands(of_plugins=True)["other"].help == "Do something else."
        assert "other" not in commands()
    finally:
        plugins.plugins.cache_clear()
        commands.cache_clear()
