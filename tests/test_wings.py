"""The core knows no wing; what a wing brings is found."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from support import rooms

from imumon import wings
from imumon.cli import OWN, commands
from imumon.errors import ImumonError, Reason
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.run.setup import Setup
from imumon.run.stages import estimators, temperature_rate
from imumon.wing import GROUPS

FIR = TemperatureRateParameters(method="fir_exponential", step_degc=0.05)


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


@pytest.mark.parametrize(
    "asked",
    [lambda: estimators(None, Setup(published=["fir"])), lambda: temperature_rate(FIR)],
    ids=["published", "fir"],
)
def test_what_only_an_absent_wing_has_is_refused(
    monkeypatch: pytest.MonkeyPatch, asked: Callable[[], object]
) -> None:
    monkeypatch.setattr(wings, "BUILT_IN", ("imumon.lab",))
    wings.wings.cache_clear()
    try:
        with pytest.raises(ImumonError, match="no wing that is installed has this method") as caught:
            asked()
    finally:
        wings.wings.cache_clear()
    assert caught.value.reason is Reason.BAD_CONFIG
