"""What ``imumon detect`` suggests."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from imumon.protocols.device import device_text, load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice
from imumon.simulation.virtual_port import VirtualPort
from tests.cli.command import answer, imumon
from tests.transport.test_detect import sending


def test_a_device_file_given_by_path_is_suggested_by_path(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(device_text("sbg")[0], encoding="utf-8")
    with VirtualDevice(load_device("sbg"), tmp_path / "sbg") as device:
        path = device.port.path
        done = imumon("detect", path, "--device", mine, "--device", "sbg", "--baud", 115200)
        result = answer("detect", path, "--device", mine, "--baud", 115200)
    assert f"imumon monitor {path} --device {mine} --baud 115200" in done.stdout
    assert "more than one fits" in done.stdout
    assert "--device sbg --baud 115200" in done.stdout
    assert result["fit"] == [{"device": str(mine), "baudrate": 115200}]


def test_lines_of_text_get_a_device_file_that_reads_them(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    rows = np.column_stack([rng.normal((0, 0, 9.8), 0.05, (200, 3)), rng.normal(0, 0.2, (200, 3))])
    lines = [(",".join(f"{x:.3f}" for x in row) + "\r\n").encode() for row in rows]
    board, capture = tmp_path / "board.yaml", tmp_path / "capture.txt"
    capture.write_bytes(b"".join(lines))
    with VirtualPort(baudrate=115200) as port, sending(port, lambda n: lines[n % 200]):
        done = imumon("detect", port.path, "--propose", board, "--baud", 115200, "--seconds", 1)
    assert done.returncode == 3, done.stderr
    assert "gravity is 9.80665" in done.stdout
    assert "frame" not in done.stderr
    assert f"then: imumon monitor {port.path} --device {board}" in done.stderr
    result = answer("decode", capture, "--device", board, "--out", tmp_path / "t.csv")
    assert result["samples"] == 199  # the first line may be torn
    assert imumon("detect", "/dev/ttyNONE", "--propose", board).returncode == 2


def test_devices_say_against_what_they_were_checked() -> None:
    assert "checked against 24 frames" in imumon("devices").stdout
    assert all(device["verified"] != "not given" for device in answer("devices").values())


def test_binary_packets_get_a_device_file_that_reads_them(tmp_path: Path) -> None:
    unit = SimulatedUnit(load_scenario("bench")).samples(400)
    packets = list(load_device("ax1").encoder().encode(unit))
    board, capture = tmp_path / "board.yaml", tmp_path / "capture.bin"
    capture.write_bytes(b"".join(packets))
    rates = ["--baud", 57600, "--baud", 115200]
    with VirtualPort(baudrate=115200) as port, sending(port, lambda n: packets[n % 400]):
        done = imumon("detect", port.path, "--propose", board, "--device", "sbg", *rates, "--seconds", 1)
    assert done.returncode == 3, done.stderr
    assert "no device file describes what came" in done.stdout
    assert "type: fletcher16-256" in done.stdout
    assert load_device(str(board)).serial.baudrates == [115200]
    result = answer("decode", capture, "--device", board, "--out", tmp_path / "t.csv")
    assert result["samples"] == 400


def test_a_file_is_no_port_but_can_be_decoded(tmp_path: Path) -> None:
    capture = tmp_path / "capture.txt"
    capture.write_text("1,2,3\n")
    done = imumon("detect", capture)
    assert done.returncode == 3
    assert f"imumon decode {capture} --device NAME" in done.stderr


def test_noise_gets_no_device_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    with VirtualPort(baudrate=115200) as port, sending(port, lambda _: rng.bytes(40)):
        options = ["--device", "sbg", "--baud", 115200, "--seconds", 1]
        done = imumon("detect", port.path, "--propose", tmp_path / "board.yaml", *options)
    assert done.returncode == 3, done.stderr
    assert not (tmp_path / "board.yaml").exists()


def test_the_help_states_in_plain_words_when_no_device_was_found() -> None:
    text = " ".join(imumon("detect", "--help").stdout.split())
    assert (
        "3: the port cannot be opened, no bytes arrived, or the bytes are not packets of any device" in text
    )


def test_what_came_is_saved_by_rate_to_report_a_device(tmp_path: Path) -> None:
    report, rates = tmp_path / "report", ["--baud", 115200, "--baud", 57600]
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        options = ["--device", "openimu", *rates, "--seconds", 1, "--save", report]
        done = imumon("detect", ahrs.port.path, *options)
        again = imumon("detect", ahrs.port.path, *options)
        port = ahrs.port.path
    assert done.returncode == 3, done.stderr
    found = json.loads((report / "evidence.json").read_text())
    assert "57600.bin" in found["files"]
    assert sorted(path.name for path in report.iterdir()) == ["115200.bin", "57600.bin", "evidence.json"]
    sizes = {row["baudrate"]: row["bytes_received"] for row in found["evidence"]}
    assert sizes == {rate: (report / f"{rate}.bin").stat().st_size for rate in (57600, 115200)}
    assert port not in (report / "evidence.json").read_text()
    result = answer("decode", report / "115200.bin", "--device", "ax1", "--out", tmp_path / "t.csv")
    assert result["samples"] > 10
    assert again.returncode == 2
    assert "is there already" in again.stderr


def test_nothing_is_saved_of_a_port_that_cannot_be_opened(tmp_path: Path) -> None:
    assert imumon("detect", "/dev/ttyNONE", "--save", tmp_path / "report").returncode == 3
    assert list(tmp_path.iterdir()) == []
