"""The server for Foxglove, and a client that speaks its protocol over a real WebSocket."""

from __future__ import annotations

import json
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from imumon.publishing.publisher import Publisher
from imumon.publishing.target import parse_target
from imumon.view.items import ViewSetup
from tests.view.streams import GYRO, Stream
from tests.waiting import LIMIT_S, wait_until

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: scripts/environment dev")
client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")

PROTOCOL = "foxglove.sdk.v1"
DATA = struct.Struct("<BIQ")
"""Of a message: opcode 1, subscription, time in ns; then the payload."""


class Viewer:
    """Subscribes to everything, as Foxglove does for the topics of its panels."""

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self.channels: dict[int, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}

    def read(self, seconds: float) -> bool:
        """Take what comes in this time; tell whether samples have come by now."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                self._take(self._connection.recv(timeout=left))
            except TimeoutError:
                break
        return "/imu" in self.messages

    def rows(self, topic: str) -> list[dict[str, Any]]:
        return [json.loads(payload) for _, payload in self.messages.get(topic, [])]

    def _take(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            opcode, channel, time_ns = DATA.unpack_from(message)
            assert opcode == 1
            topic = self.channels[channel]["topic"]
            self.messages.setdefault(topic, []).append((time_ns, message[DATA.size :]))
        elif (said := json.loads(message))["op"] == "advertise":
            self.channels |= {channel["id"]: channel for channel in said["channels"]}
            wanted = [{"id": one["id"], "channelId": one["id"]} for one in said["channels"]]
            self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


@contextmanager
def publishing(port: int) -> Iterator[Publisher]:
    target = parse_target(f"foxglove=127.0.0.1:{port}")
    publisher = Publisher(target, ViewSetup("bench", "bench", {"mag_x": "gauss"})).start()
    try:
        yield publisher
    finally:
        publisher.close()


@pytest.fixture
def port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        found: int = free.getsockname()[1]
        return found


def test_a_viewer_sees_samples_with_units_states_and_the_log(port: int) -> None:
    with publishing(port) as publisher:
        stream = Stream(publisher.publish)
        stream.run_until(lambda: publisher.state.ready, "serving")
        assert publisher.state.text == f"ws://127.0.0.1:{port}"
        with client.connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL]) as connection:
            viewer = Viewer(connection)
            stream.run_until(lambda: viewer.read(0.1), "subscribed")
            before = stream.sent
            stream.run(1.0)
            assert wait_until(
                lambda: viewer.read(0.1) and viewer.rows("/imu")[-1]["sample"] == stream.sent - 1
            )
            rows = viewer.rows("/imu")
            assert [row["sample"] for row in rows] == [*range(rows[0]["sample"], stream.sent)]
            for name in GYRO:
                sent = np.concatenate([one[name] for one in stream.blocks])[rows[0]["sample"] :]
                assert [row[name] for row in rows] == sent.tolist()
            (first_ns, _), row = viewer.messages["/imu"][0], rows[0]
            assert first_ns == row["host_time_ns"]
            assert viewer.rows("/state")[-1] == {"port": "open"}
            assert before < stream.sent
    described = {one["topic"]: one for one in viewer.channels.values()}
    assert described["/log"]["schemaName"] == "foxglove.Log"
    properties = json.loads(described["/imu"]["schema"])["properties"]
    assert properties["gyro_x"]["description"] == "rad/s: angular rate, x"
    assert properties["mag_x"]["description"] == "gauss: magnetic field, x"
    assert publisher.state.dropped == 0


def test_a_port_that_another_program_has_is_reported_and_tried_again(port: int) -> None:
    with socket.create_server(("127.0.0.1", port)) as other, publishing(port) as publisher:
        stream = Stream(publisher.publish)
        stream.run_until(lambda: "cannot serve" in publisher.state.text, "said")
        assert not publisher.state.ready
        other.close()
        stream.run_until(lambda: publisher.state.ready, "serving")
        assert publisher.state.dropped > 0


@pytest.mark.long
def test_a_viewer_that_does_not_read_is_reported_and_holds_nobody_up(port: int) -> None:
    with publishing(port) as publisher:
        stream = Stream(publisher.publish)
        stream.run_until(lambda: publisher.state.ready, "serving")
        with client.connect(f"ws://127.0.0.1:{port}", subprotocols=[PROTOCOL], max_queue=1) as connection:
            viewer = Viewer(connection)
            stream.run_until(lambda: viewer.read(0.1), "subscribed")
            end = time.monotonic() + LIMIT_S
            while "too slow" not in publisher.state.text and time.monotonic() < end:
                stream.send(1000)
                time.sleep(0.01)
            assert "too slow" in publisher.state.text
            assert publisher.state.ready
