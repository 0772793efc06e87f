from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from imumon.errors import ImumonError
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice
from tests.cli.command import IMUMON
from tests.waiting import LIMIT_S


def read(path: str, n_bytes: int) -> bytes:
    """Open the port as a host does and read until so many bytes have come."""
    descriptor, data = os.open(path, os.O_RDONLY | os.O_NOCTTY), b""
    end = time.monotonic() + LIMIT_S
    try:
        while len(data) < n_bytes and time.monotonic() < end:
            data += os.read(descriptor, 4096)
    finally:
        os.close(descriptor)
    return data


@pytest.mark.usefixtures("no_leaks")
def test_a_scenario_comes_out_of_the_port() -> None:
    device, scenario = load_device("ax1"), load_scenario("crs05-ramp")
    with VirtualDevice(device, seed=5, scenario=scenario) as virtual:
        data = read(virtual.port.path, 58 * 40)
    pipeline = Pipeline(device)
    pipeline.feed(data)
    block = pipeline.take()
    sent = SimulatedUnit(scenario, 5).samples(2000)
    found = block["packet_counter"]
    assert len(found) >= 38
    np.testing.assert_allclose(block["gyro_y"], sent["gyro_y"][found], atol=1e-8)
    np.testing.assert_allclose(block["accel_z"], sent["accel_z"][found], atol=1e-6)


def test_a_scenario_that_is_too_fast_for_the_line_is_refused() -> None:
    with pytest.raises(ImumonError, match="503%"):
        VirtualDevice(load_device("ax1"), rate_hz=1000.0, scenario=load_scenario("crs05-ramp"))


DEVICE = """
format: imumon-device/1
name: mine
title: IMU of my own
protocol: fixed
serial: {baudrates: [BAUD]}
rate_hz: 100
axes: FLU
packet:
  length: 9
  byte_order: little
  sync: [0xAA, 0x55]
  checksum: {type: sum8, first: 2, last: 7, at: 8}
  fields:
    - {at: 2, type: i16, columns: [gyro_x, gyro_y, gyro_z], scale: 1/SCALE, unit: deg/s}
"""


@pytest.mark.parametrize(
    ("baudrate", "scale", "code", "cause"),
    [(1200, 16, 2, "of a line at 1200 baud"), (115200, 10_000_000, 4, "does not fit")],
)
def test_a_demo_that_cannot_send_ends_with_the_cause(
    tmp_path: Path, baudrate: int, scale: int, code: int, cause: str
) -> None:
    device = tmp_path / "mine.yaml"
    device.write_text(DEVICE.replace("BAUD", str(baudrate)).replace("SCALE", str(scale)))
    options = ("--view", "none", "--seconds", "1", "--out", str(tmp_path / "s"))
    done = subprocess.run(
        [IMUMON, "demo", "--device", str(device), *options], capture_output=True, text=True, check=False
    )
    assert done.returncode == code
    *_, reported, _ = done.stderr.splitlines()
    assert cause in reported
    assert "not found" not in done.stderr
