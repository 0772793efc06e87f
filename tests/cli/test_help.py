"""What the help texts have: examples, scenarios, ranges as people write them, all within 80 columns."""

from __future__ import annotations

from collections.abc import Iterator

import click
import pytest

from imumon.cli import START, cli, commands
from imumon.files import bundled
from tests.cli.command import imumon

WIDTH = 80


def every_command(group: click.Group, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        assert command is not None
        yield (*path, name)
        if isinstance(command, click.Group):
            yield from every_command(command, (*path, name))


EVERY = sorted(every_command(cli))


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))


@pytest.mark.parametrize("path", EVERY, ids=" ".join)
def test_the_help_of_a_command_begins_with_an_example_and_is_narrow(path: tuple[str, ...]) -> None:
    lines = imumon(*path, "--help").stdout.splitlines()
    before_the_options = lines[: lines.index("Options:")]
    assert any(line.startswith(f"  imumon {' '.join(path)}") for line in before_the_options[:7])
    assert [line for line in lines if len(line) > WIDTH] == []
    text = " ".join(lines)
    assert not any(part in text for part in ("x<", "<x", "x>=", "RANGE", "{scenarios", "{sessions"))


def test_without_a_command_a_beginner_sees_five_and_the_names_of_all() -> None:
    done = imumon()
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert [line for line in lines if len(line) > WIDTH] == []
    at = lines.index("Start here:")
    assert [line.split()[1] for line in lines[at + 1 : at + 6]] == [usage.split()[0] for usage in START]
    assert lines[at + 6] == ""
    assert set(commands()) <= set(done.stdout.replace(",", " ").split())
    assert "imumon COMMAND --help" in lines[-1]


@pytest.mark.parametrize("name", ["simulate", "virtual"])
def test_the_scenarios_are_listed_unbroken(name: str) -> None:
    words = imumon(name, "--help").stdout.replace(",", " ").replace(". ", " ").split()
    assert {word.rstrip(".") for word in words} >= set(bundled("scenarios"))


def test_a_number_outside_of_its_range_gets_the_range_in_words() -> None:
    assert "is not in the range -90 to 90" in imumon("calibrate", "s", "--out", "m", "--latitude", 91).stderr
    assert "is not in the range above 0" in imumon("virtual", "--seconds", 0).stderr
    assert "is not in the range up to 1e+09" in imumon("virtual", "--seconds", "inf").stderr
