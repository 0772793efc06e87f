"""How a device is found that is to be configured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from imumon.configure import command_link
from imumon.configure.command_link import HEAR_S, connect
from imumon.configure.core import family_of
from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.detect import GLANCE_S, Evidence, Verdict, detect


def test_a_device_that_a_glance_received_too_little_of_is_listened_to_for_longer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of one that sends once a second, or when the host stalls."""
    listened = list[float]()

    def cut(*where: Any) -> list[Evidence]:
        listened.append(where[-1])
        if where[-1] > GLANCE_S:
            return detect(*where)
        return [Evidence("witmotion", rate, GLANCE_S, 7, 0, 7, 0, 0, 0, 0, 0.0, 0.0) for rate in where[2]]

    monkeypatch.setattr(command_link, "detect", cut)
    device = load_device("witmotion")
    with VirtualDevice(device, tmp_path / "imu") as virtual:
        link = connect(virtual.port.path, device, family_of(device), None)
        link.port.close()
    assert cut(virtual.port.path, {}, (9600,), GLANCE_S)[0].verdict is Verdict.NOTHING
    assert listened[:2] == [GLANCE_S, HEAR_S]
    assert link.streaming
