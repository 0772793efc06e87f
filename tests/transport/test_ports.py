from __future__ import annotations

import os
from pathlib import Path

import pytest
from serial.tools import list_ports_common

from imumon.transport import ports
from imumon.transport.ports import describe_ports, holders, list_ports


@pytest.fixture
def adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """An FTDI adapter in a copy of the folders in which Linux shows one; returns its device."""
    usb = tmp_path / "devices" / "1-2"
    tty = usb / "1-2:1.0" / "ttyUSB0"
    tty.mkdir(parents=True)
    (usb / "idVendor").write_text("0403\n")
    (usb / "idProduct").write_text("6001\n")
    (tty / "latency_timer").write_text("16\n")
    drivers = tmp_path / "drivers" / "ftdi_sio"
    drivers.mkdir(parents=True)
    (tty / "driver").symlink_to(drivers)
    (tmp_path / "tty" / "ttyUSB0").mkdir(parents=True)
    (tmp_path / "tty" / "ttyUSB0" / "device").symlink_to(tty)
    device = tmp_path / "dev" / "ttyUSB0"
    (tmp_path / "by-id").mkdir()
    device.parent.mkdir()
    device.touch(mode=0o600)
    (tmp_path / "by-id" / "usb-FTDI_A1-if00").symlink_to(device)
    monkeypatch.setattr(ports, "SYS_TTY", tmp_path / "tty")
    monkeypatch.setattr(ports, "BY_ID", tmp_path / "by-id")
    return str(device)


def pyserial_finds(monkeypatch: pytest.MonkeyPatch, *devices: str) -> None:
    def make(device: str) -> list_ports_common.ListPortInfo:
        info = list_ports_common.ListPortInfo(device)
        info.description, info.vid, info.pid, info.serial_number = "FT232R USB UART", 0x403, 0x6001, "A1"
        return info

    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [make(device) for device in devices])


def test_a_port_is_listed_with_all_that_linux_knows(adapter: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pyserial_finds(monkeypatch, adapter)
    (port,) = list_ports()
    assert (port.device, port.usb_id, port.serial_number) == (adapter, "0403:6001", "A1")
    assert (port.driver, port.latency_timer_ms, port.accessible) == ("ftdi_sio", 16, True)
    assert port.by_id is not None
    assert port.by_id.endswith("usb-FTDI_A1-if00")
    assert str(port) == f"{adapter} (FT232R USB UART, 0403:6001)"


def test_a_port_without_usb_has_no_usb_facts(adapter: str) -> None:
    other = adapter.replace("ttyUSB0", "ttyS9")
    assert ports.driver(other) is None
    assert ports.latency_timer_ms(other) is None


def test_the_ports_are_named_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    pyserial_finds(monkeypatch, "/dev/ttyUSB1", "/dev/ttyUSB0")
    ports_text = "/dev/ttyUSB0 (FT232R USB UART), /dev/ttyUSB1 (FT232R USB UART)"
    assert describe_ports() == f"ports that exist: {ports_text}"
    pyserial_finds(monkeypatch)
    assert describe_ports() == "no serial ports exist"


def test_the_real_ports_of_this_computer_can_be_listed() -> None:
    assert all(Path(port.device).exists() for port in list_ports())


def test_holders_reads_command_and_pid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for pid, target in ((41, "/dev/ttyUSB0"), (42, "/dev/null"), (os.getpid(), "/dev/ttyUSB0")):
        folder = tmp_path / str(pid) / "fd"
        folder.mkdir(parents=True)
        (folder / "3").symlink_to(target)
        (folder.parent / "cmdline").write_bytes(b"minicom\0-D\0/dev/ttyUSB0\0")
    (tmp_path / "43").mkdir()  # a process that has ended
    monkeypatch.setattr(ports, "PROC", tmp_path)
    assert holders("/dev/ttyUSB0") == ["minicom -D /dev/ttyUSB0 (pid 41)"]


def test_an_adapter_unplugged_while_ports_are_listed_does_no_harm(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []

    def stumble() -> list[list_ports_common.ListPortInfo]:
        calls.append(1)
        if len(calls) == 1:
            raise TypeError("int() argument must be a string, not 'NoneType'")
        return [list_ports_common.ListPortInfo("/dev/ttyACM0")]

    monkeypatch.setattr("serial.tools.list_ports.comports", stumble)
    assert describe_ports() == "ports that exist: /dev/ttyACM0"
