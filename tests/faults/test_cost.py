from __future__ import annotations

import time

import numpy as np
import pytest

from imumon.protocols.device import device_names, load_device
from tests.faults.cost import STEEPEST, growth, hostile_streams, sample_packet

MOST_NOTICES = 100
LONGEST_NOTICE = 1000


@pytest.mark.parametrize("name", device_names())
def test_the_cost_of_a_call_grows_as_its_bytes_do(name: str) -> None:
    device, steep = load_device(name), set[str]()
    for attempt in range(6):  # what a busy machine does goes by
        time.sleep(0.5 * attempt)
        found = {item[0] for item in growth(device) if item[2] > STEEPEST}
        steep = found & steep if attempt else found
        if not steep:
            return
    raise AssertionError(steep)


@pytest.mark.parametrize("name", device_names())
def test_notices_and_warnings_are_bounded(name: str) -> None:
    device, rng = load_device(name), np.random.default_rng(1)
    decoder = device.decoder()
    packet = sample_packet(device)
    streams = hostile_streams(packet)
    said = []
    for _ in range(10):
        for make in streams.values():
            decoder.feed(make(2000), 0)
            changed = bytearray(packet * 20)
            for at in rng.integers(0, len(changed), 20):
                changed[at] = rng.integers(256)
            decoder.feed(bytes(changed) + b"$XX,1,2,3\r\n" + rng.bytes(30).hex().encode() + b"\r\n", 0)
            said += decoder.notices() + decoder.warnings()
    assert len(said) <= MOST_NOTICES
    assert max(map(len, said), default=0) <= LONGEST_NOTICE
