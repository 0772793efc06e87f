from __future__ import annotations

from collections.abc import Iterator

import pytest

from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice
from tests.faults.interrupts import Stage, interrupt, staged


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("stage")
    with VirtualDevice(load_device("ax1"), folder / "ahrs", 100.0) as ahrs:
        yield staged(folder, ahrs.port.path)


# The command line loads, which all have in common; what the command needs loads, or it works: commands that
# record, show, write a table, draw, and search.  scripts/soak does it to every command at every moment.
@pytest.mark.parametrize(
    ("name", "after_s"),
    [
        ("monitor", 0.25),
        ("monitor with the web view", 0.75),
        ("replay in the web view", 0.75),
        ("decode", 0.75),
        ("allan", 0.75),
        ("diagnose", 0.75),
    ],
)
def test_ctrl_c_while_a_command_begins_ends_it_as_documented(stage: Stage, name: str, after_s: float) -> None:
    assert not interrupt(stage, name, after_s).wrong
