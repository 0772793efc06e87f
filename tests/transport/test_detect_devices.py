"""Every device that comes with imumon is named from the middle of its stream, beside all others."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.protocols.device import device_names, load_device
from imumon.transport.detect import Verdict, detect
from tests.transport.helpers import tcp_server
from tests.waiting import LIMIT_S

pytestmark = pytest.mark.usefixtures("no_leaks")
LOOK_ALIKES = {"xsens": {"xsens", "xsens-legacy"}}


@pytest.mark.parametrize("name", device_names())
def test_a_device_is_named_from_the_middle_of_its_stream(name: str) -> None:
    rng = np.random.default_rng(1)
    n = 400
    vectors = {f"{what}_{axis}": rng.normal(0, 0.5, n) for what in ("gyro", "accel", "mag") for axis in "xyz"}
    block = SampleBlock(
        {**vectors, "device_ticks": np.arange(n) * 10_000, "packet_counter": np.arange(n) % 100}
    )
    stream = b"".join(load_device(name).encoder().encode(block))[13:]
    candidates = {known: load_device(known).decoder for known in device_names()}
    with tcp_server(lambda client: client.sendall(stream)) as port:
        evidence = detect(f"socket://127.0.0.1:{port}", candidates, seconds_each=LIMIT_S)
    fit = [item.protocol for item in evidence if item.verdict is Verdict.FRAMES]
    assert name in fit
    assert evidence[0].samples > 0
    assert evidence[0].protocol == name
    assert sum({item.baudrate: item.seconds for item in evidence}.values()) < LIMIT_S
    assert set(fit) <= LOOK_ALIKES.get(name, {name})
