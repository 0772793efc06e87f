"""``imumon configure`` on a real pseudo-terminal: what a user types, and what the device then sends."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from imumon.configure.firmware import Firmware
from imumon.protocols.device import load_device
from imumon.recordings.table import read_table
from imumon.simulation.virtual_device import VirtualDevice
from tests.cli.command import IMUMON, answer, imumon
from tests.configure.faults import Faults, Spoilt
from tests.waiting import LIMIT_S, wait_until

ASKED = ("--rate", 20, "--outputs", "inertial,temperature")
DEVICES = ("xsens", "microstrain", "vectornav", "witmotion")

pytestmark = pytest.mark.usefixtures("no_leaks")


def firmware_of(virtual: VirtualDevice) -> Firmware:
    assert isinstance(virtual.firmware, Firmware)
    return virtual.firmware


def recorded(path: str, baudrate: int, seconds: float, to: Path) -> float:
    """Read a port as any other program does; return for how long, s."""
    with serial.Serial(path, baudrate, timeout=0.05) as port:
        began, data = time.monotonic(), b""
        while (took_s := time.monotonic() - began) < seconds:
            data += port.read(4096)
    to.write_bytes(data)
    return took_s


@pytest.mark.long
@pytest.mark.parametrize("name", DEVICES)
def test_the_device_sends_what_was_requested(name: str, tmp_path: Path) -> None:
    with VirtualDevice(load_device(name), tmp_path / "imu") as virtual:
        path = virtual.port.path
        done = answer("configure", path, "--device", name, *ASKED, "--baud", 230_400, "--save")
        assert (done["result"], done["saved"], done["restored"]) == ("done", True, [])
        assert done["stream"]["rate_hz"] == pytest.approx(20.0, rel=0.1)
        assert done["sent"][0]["bytes"]
        virtual.reboot()
        capture = tmp_path / "capture.bin"
        took_s = recorded(path, 230_400, 3.0, capture)
        now = answer("configure", path, "--device", name)
        assert now["result"] == "read"
        assert now["before"] == done["after"]
    decoded = answer("decode", capture, "--device", name, "--out", tmp_path / "t.parquet")
    assert decoded["samples"] == pytest.approx(20.0 * took_s, rel=0.25)  # a host that stalls
    table, _ = read_table(tmp_path / "t.parquet")
    names = set(table.columns)
    assert {"gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "temperature"} <= names
    assert not {"mag_x", "q_w", "roll", "pressure"} & names
    assert np.isfinite(table["gyro_x"]).mean() > 0.95


@pytest.mark.long
def test_without_save_nothing_survives_power_off(tmp_path: Path) -> None:
    with VirtualDevice(load_device("vectornav"), tmp_path / "imu") as virtual:
        path = virtual.port.path
        before = answer("configure", path, "--device", "vectornav")["before"]
        done = imumon("configure", path, "--device", "vectornav", *ASKED)
        assert done.returncode == 0, done.stderr
        assert "not saved: the settings are lost at power-off" in done.stderr
        virtual.reboot()
        assert answer("configure", path, "--device", "vectornav")["before"] == before


def test_what_an_mti_stores_at_once_needs_save(tmp_path: Path) -> None:
    with VirtualDevice(load_device("xsens"), tmp_path / "imu") as virtual:
        done = imumon("configure", virtual.port.path, "--device", "xsens", *ASKED)
        settings = firmware_of(virtual)
        assert settings.volatile == settings.flash == settings.delivered
    assert done.returncode == 2
    assert "add --save" in done.stderr
    assert "no setting was changed" in done.stderr


def test_a_refusal_is_reported_and_put_back(tmp_path: Path) -> None:
    with VirtualDevice(load_device("vectornav"), tmp_path / "imu") as virtual:
        firmware = firmware_of(virtual)
        Spoilt(Faults(ignored=frozenset([14]))).spoil(firmware)
        done = imumon("configure", virtual.port.path, "--device", "vectornav", *ASKED, "--baud", 921_600)
        assert firmware.volatile == firmware.delivered
        assert firmware.baudrate == virtual.port.baudrate == 115_200
        assert firmware.streaming
    assert done.returncode == 1, done.stderr
    assert "refused by the device: " in done.stderr
    assert "put back: " in done.stderr


def test_an_unplugged_device_is_reported_with_its_state(tmp_path: Path) -> None:
    with VirtualDevice(load_device("vectornav"), tmp_path / "imu") as virtual:
        Spoilt(Faults(unplugged_after=10), virtual.port.unplug).spoil(firmware_of(virtual))
        done = imumon("configure", virtual.port.path, "--device", "vectornav", *ASKED)
    assert done.returncode == 3
    assert "NOT put back: binary output 1" in done.stderr
    assert "switch the device off and on" in done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_puts_back(number: signal.Signals, tmp_path: Path) -> None:
    with VirtualDevice(load_device("microstrain"), tmp_path / "imu") as virtual:
        firmware = firmware_of(virtual)
        process = subprocess.Popen(
            [IMUMON, "configure", virtual.port.path, "--device", "microstrain", *map(str, ASKED), "--save"],
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert wait_until(lambda: firmware.volatile != firmware.delivered)
            process.send_signal(number)
            _, said = process.communicate(timeout=LIMIT_S)
        finally:
            process.kill()
        assert firmware.volatile == firmware.delivered == firmware.flash, said
        assert firmware.streaming, said
    assert process.returncode == 130
    assert "put back: sensor format" in said


def test_another_device_is_not_spoken_to(tmp_path: Path) -> None:
    with VirtualDevice(load_device("ax1"), tmp_path / "imu") as virtual:
        done = imumon("configure", virtual.port.path, "--device", "microstrain", *ASKED)
        assert virtual.port.read() == b""
    assert done.returncode == 3
    assert "this is no microstrain device" in done.stderr
    assert "nothing was sent" in done.stderr


def test_a_device_that_only_sends_is_reported_as_deaf(tmp_path: Path) -> None:
    with VirtualDevice(load_device("vectornav"), tmp_path / "imu") as virtual:
        Spoilt(Faults(unheard=frozenset(range(1000)))).spoil(firmware_of(virtual))
        done = imumon("configure", virtual.port.path, "--device", "vectornav", *ASKED)
    assert done.returncode == 3
    assert "sends, but no vectornav device answers" in done.stderr


@pytest.mark.long
def test_a_device_that_is_silent_is_found_by_asking_and_left_silent(tmp_path: Path) -> None:
    with VirtualDevice(load_device("microstrain"), tmp_path / "imu") as virtual:
        firmware = firmware_of(virtual)
        firmware.streaming, firmware.baudrate, virtual.port.baudrate = False, 460_800, 460_800
        firmware.volatile["baud rate"] = (460_800).to_bytes(4, "big")
        done = imumon("configure", virtual.port.path, "--device", "microstrain", "--rate", 3)
        assert not firmware.streaming
        looked = answer("configure", virtual.port.path, "--device", "microstrain", "--at", 460_800)
    assert done.returncode == 2
    assert "no rate of 3 Hz" in done.stderr
    assert looked["before"]["baud rate"] == "460800"
    assert looked["result"] == "read"


def test_json_states_what_failed(tmp_path: Path) -> None:
    with VirtualDevice(load_device("witmotion"), tmp_path / "imu") as virtual:
        Spoilt(Faults(ignored=frozenset(range(1000)))).spoil(firmware_of(virtual))
        done = imumon("configure", virtual.port.path, "--device", "witmotion", *ASKED, "--json")
    assert done.returncode == 1
    result = json.loads(done.stdout)
    assert result["result"] == "failed"
    assert not result["saved"]
    assert not result["flash_begun"]
    assert result["not_restored"] == []
    assert [item["answered"] for item in result["sent"]].count(None) >= 2


@pytest.mark.long
def test_on_its_own_imumon_sends_nothing(tmp_path: Path) -> None:
    with VirtualDevice(load_device("vectornav"), tmp_path / "imu") as virtual:
        path, firmware = virtual.port.path, firmware_of(virtual)
        heard: list[bytes] = []
        receive = firmware.receive
        firmware.receive = lambda data: heard.append(data) or receive(data)  # type: ignore[method-assign, func-returns-value]
        assert imumon("detect", path, "--device", "vectornav").returncode == 0
        out = ["--out", str(tmp_path / "session"), "--view", "none", "--seconds", "1"]
        subprocess.run([IMUMON, "monitor", path, "--device", "vectornav", *out], check=True)
        assert imumon("ports").returncode == 0
        assert heard == []
        assert imumon("configure", path, "--device", "vectornav").returncode == 0
        assert heard


def test_a_dry_run_opens_nothing() -> None:
    done = imumon("configure", "/dev/none", "--device", "vectornav", *ASKED, "--dry-run", "--save")
    assert done.returncode == 0, done.stderr
    assert "$VNWRG,75,1,40,05,0001,001C*" in done.stdout
    assert "$VNWNV*57" in done.stdout
    assert "nothing was sent" in done.stderr
    plan = answer("configure", "/dev/none", "--device", "witmotion", *ASKED, "--dry-run")
    assert plan["result"] == "planned"
    assert "FF AA 03 07 00" in [item["bytes"] for item in plan["plan"]]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--rate", 300, "--outputs", "inertial", "--dry-run"], "nearest: 266.667 and 400 Hz"),
        (["--outputs", "inertial,gyro"], "no output 'gyro'"),
        (["--outputs", "inertial,"], "a name is empty"),
        (["--baud", 12345], "no baud rate 12345"),
        (["--save"], "nothing to save"),
        (["--rate", 100, "--dry-run"], "give both --rate and --outputs"),
        (
            ["--rate", 800, "--outputs", "inertial,attitude", "--dry-run", "--at", 9600],
            "of what 9600 baud carry",
        ),
    ],
)
def test_what_is_wrong_is_reported_in_one_line_before_the_port_is_opened(
    options: list[Any], said: str
) -> None:
    done = imumon("configure", "/dev/none", "--device", "vectornav", *options)
    assert done.returncode == 2
    assert said in done.stderr


def test_a_port_that_does_not_exist() -> None:
    done = imumon("configure", "/dev/none", "--device", "vectornav", *ASKED)
    assert done.returncode == 3
    assert "/dev/none" in done.stderr
