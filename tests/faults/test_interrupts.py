from __future__ import annotations

from collections.abc import Iterator

import pytest

from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice
from tests.faults.interrupts import COMMANDS, Stage, interrupt, staged


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("stage")
    with VirtualDevice(load_device("ax1"), folder / "ahrs", 100.0) as ahrs:
        yield staged(folder, ahrs.port.path)


# The command line loads, which all have in common; what the command needs loads, or it works.
@pytest.mark.parametrize(("name", "after_s"), [("monitor", 0.25), *((name, 0.75) for name in COMMANDS)])
def test_ctrl_c_while_a_command_begins_ends_it_as_documented(stage: Stage, name: str, after_s: float) -> None:
    assert not interrupt(stage, name, after_s).wrong
