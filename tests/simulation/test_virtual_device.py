from __future__ import annotations

import os
import time

import numpy as np
import pytest

from imumon.errors import ImumonError
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice
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
