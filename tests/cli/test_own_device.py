"""What monitor, replay and detect say of a device file that is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from imumon.protocols.device import device_text, load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice
from imumon.simulation.virtual_port import VirtualPort
from tests.cli.command import answer, device, imumon
from tests.transport.test_detect import sending

COUNTED = "column: packet_counter"
FORCE = "accel_z], scale: 1.0e-6, unit: m/s^2"
DOUBT = "100% of the specific force readings are not within 0.3 to 3 times gravity but 0.001 in the mean"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six seconds of an AX1, of which every 50th packet is missing."""
    packets = load_device("ax1").encoder().encode(SimulatedUnit(load_scenario("bench")).samples(600))
    path = tmp_path_factory.mktemp("capture") / "ax1.raw"
    path.write_bytes(b"".join(packet for k, packet in enumerate(packets) if k % 50 != 25))
    return path


def test_losses_that_no_counter_shows_are_not_known(capture: Path, tmp_path: Path) -> None:
    typed = device(tmp_path, (COUNTED, "column: paket_counter"))
    command = ["decode", capture, "--device", typed, "--out", tmp_path / "t.csv", "--json"]
    done, right = imumon(*command), answer(*command[:3], "ax1", *command[4:-1])
    assert "losses      not known, as no packet_counter came" in done.stderr
    assert "column paket_counter is one of the device's own: if packet_counter is meant" in done.stderr
    result = json.loads(done.stdout)
    assert (result["packets_counted"], result["packets_missing"]) == (False, 0)
    assert (right["packets_counted"], right["packets_missing"]) == (True, 12)


def test_gaps_of_a_device_clock_are_shown_where_no_counter_counts_them(capture: Path, tmp_path: Path) -> None:
    text = device_text("ax1")[0]
    assert "device_ticks" in text
    typed = device(tmp_path, (COUNTED, "column: rolling"))
    done = imumon("decode", capture, "--device", typed, "--out", tmp_path / "t.csv")
    assert "not known, as no packet_counter came, 12 gaps by its clock, 0 checksum errors" in done.stderr
    assert "is one of the device's own" not in done.stderr


def test_fields_that_share_bytes_are_reported(capture: Path, tmp_path: Path) -> None:
    wrong = device(tmp_path, ("- {at: 46,", "- {at: 45,"))
    done = imumon("decode", capture, "--device", wrong, "--out", tmp_path / "t.csv")
    assert "share byte 45 of a packet" in done.stderr
    done = imumon("decode", capture, "--device", "ax1", "--out", tmp_path / "u.csv")
    assert "share byte" not in done.stderr


@pytest.mark.long
def test_monitor_and_replay_doubt_a_wrong_unit(tmp_path: Path) -> None:
    wrong = device(tmp_path, (FORCE, FORCE.replace("1.0e-6", "1.0e-9")))
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        command = ["monitor", ahrs.port.path, "--device", wrong, "--view", "none", "--seconds", 7]
        live = imumon(*command, "--out", tmp_path / "s")
    assert live.returncode == 0, live.stderr
    assert live.stderr.count(DOUBT) == 1
    assert imumon("replay", tmp_path / "s").stderr.count(DOUBT) == 1


@pytest.mark.long
def test_a_wrong_checksum_in_the_file_is_not_blamed_on_the_baud_rate(tmp_path: Path) -> None:
    wrong = device(tmp_path, ("type: fletcher16-256", "type: crc16-modbus"))
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        command = ["monitor", ahrs.port.path, "--device", wrong, "--view", "none", "--seconds", 1.5]
        live = imumon(*command, "--out", tmp_path / "s")
        found = imumon("detect", ahrs.port.path, "--device", wrong, "--baud", 115200)
    again = imumon("replay", tmp_path / "s")
    question = "is its checksum, or its length, another than in the device file?"
    assert live.returncode == 3
    assert question in live.stderr
    assert "wrong baud rate or device?  Try" not in live.stderr
    assert f"right headers: {question}" in found.stdout
    assert "type: fletcher16-256" in found.stdout
    assert "which --propose FILE writes" in found.stderr
    assert again.returncode == 0
    assert "no samples of ax1 in the" in again.stderr
    assert "another device?" in again.stderr


def test_of_rates_that_all_fit_the_first_is_proposed_and_what_waited_is_not_counted(tmp_path: Path) -> None:
    packets = [*load_device("ax1").encoder().encode(SimulatedUnit(load_scenario("bench")).samples(400))]
    board = tmp_path / "board.yaml"
    with VirtualPort() as port, sending(port, lambda n: packets[n % 400]):
        options = ["--device", "sbg", "--baud", 115200, "--baud", 57600, "--baud", 38400, "--seconds", 1]
        imumon("detect", port.path, "--propose", board, *options)
    assert load_device(str(board)).serial.baudrates == [115200]


@pytest.mark.parametrize(("display", "view"), [("", "web"), (":0", "native")])
def test_the_summary_proposes_a_view_that_can_be_shown(
    display: str, view: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        command = ["monitor", ahrs.port.path, "--device", "ax1", "--view", "none", "--seconds", 1]
        done = imumon(*command, "--out", tmp_path / "s")
    assert f"imumon replay {tmp_path / 's'} --view {view}" in done.stderr
