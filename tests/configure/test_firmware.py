"""Virtual devices that listen: a line of their own rate, settings that are lost or kept at power-off."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import serial

from imumon.configure.core import BAUD
from imumon.configure.vectornav import OUTPUT, VectorNav, VectorNavFirmware, frame
from imumon.protocols.device import load_device
from imumon.protocols.messages import TableDevice
from imumon.simulation.virtual_device import VirtualDevice
from imumon.simulation.virtual_port import VirtualPort
from tests.waiting import LIMIT_S


@pytest.fixture
def device() -> VectorNavFirmware:
    described = load_device("vectornav")
    assert isinstance(described, TableDevice)
    return VectorNavFirmware(described, 50.0)


def test_what_is_written_is_lost_at_power_off_unless_it_is_saved(device: VectorNavFirmware) -> None:
    write = frame("VNWRG,75,1,8,05,0001,001C")
    assert device.receive(write) == write
    assert device.receive(frame("VNRRG,75")) == frame("VNRRG,75,1,8,05,0001,001C")
    device.power_on()
    assert device.volatile[OUTPUT] == device.delivered[OUTPUT]
    device.receive(write + frame("VNWNV"))
    device.power_on()
    assert device.volatile[OUTPUT] == b"1,8,05,0001,001C"


@pytest.mark.parametrize(
    ("command", "error"),
    [("VNRRG,99", 8), ("VNWRG,99,1", 8), ("VNXYZ", 4)],
)
def test_what_it_does_not_know_is_refused(device: VectorNavFirmware, command: str, error: int) -> None:
    assert device.receive(frame(command)) == frame(f"VNERR,{error:02d}")
    assert device.volatile == device.delivered


def test_a_command_with_a_bad_checksum_is_not_answered(device: VectorNavFirmware) -> None:
    assert device.receive(b"$VNWNV*58\r\n$VNRRG,05") == b""
    assert device.receive(b"*76\r\n") == frame("VNRRG,05,115200")


def test_a_host_at_another_rate_is_not_understood() -> None:
    with VirtualPort(baudrate=115_200) as device, serial.Serial(device.path, 9600, timeout=1) as host:
        host.write(VectorNav().hello.frame)
        heard = device.read(LIMIT_S)
        assert heard
        assert VectorNav().messages(heard)[0] == []


@pytest.fixture
def virtual() -> Iterator[VirtualDevice]:
    with VirtualDevice(load_device("vectornav")) as device:
        yield device


@pytest.mark.usefixtures("no_leaks")
def test_the_answer_comes_at_the_old_rate_and_the_next_at_the_new(virtual: VirtualDevice) -> None:
    with serial.Serial(virtual.port.path, 115_200, timeout=0.05) as host:
        host.write(frame("VNASY,0") + frame("VNWRG,05,921600"))
        end, data = time.monotonic() + LIMIT_S, b""
        while frame("VNWRG,05,921600") not in data and time.monotonic() < end:
            data += host.read(4096)
        assert frame("VNWRG,05,921600") in data
        host.baudrate = 921_600
        host.write(frame("VNRRG,05"))
        while frame("VNRRG,05,921600") not in data and time.monotonic() < end:
            data += host.read(4096)
        assert frame("VNRRG,05,921600") in data
    virtual.reboot()
    end = time.monotonic() + LIMIT_S
    while virtual.port.baudrate != 115_200 and time.monotonic() < end:
        time.sleep(0.01)
    assert virtual.port.baudrate == 115_200
    assert virtual.firmware is not None
    assert virtual.firmware.volatile[BAUD] == b"115200"


def test_a_device_that_imumon_does_not_configure_does_not_listen() -> None:
    with VirtualDevice(load_device("ax1")) as device:
        assert device.firmware is None
