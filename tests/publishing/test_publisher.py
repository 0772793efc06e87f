"""Publishing into real sockets, by a real process that may be stopped or killed."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from imumon.publishing.publisher import Publisher
from imumon.publishing.target import parse_target
from imumon.simulation.virtual_device import VirtualDevice
from imumon.view.fed import QUEUE_BYTES
from imumon.view.items import Timebase, ViewSetup
from tests.cli.command import answer, imumon
from tests.run.test_live import AX1
from tests.view.streams import GYRO, Stream, block
from tests.waiting import LIMIT_S, wait_until


class Receiver:
    """A program that reads datagrams of JSON, as PlotJuggler does."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.1)
        self.port: int = self._socket.getsockname()[1]
        self.messages: list[dict[str, Any]] = []
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def rows(self, topic: str) -> list[dict[str, Any]]:
        return [message[topic] for message in [*self.messages] if topic in message]

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while not self._ends.is_set():
            try:
                self.messages.append(json.loads(self._socket.recv(1 << 16)))
            except TimeoutError:
                continue


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    made.close()


@contextmanager
def publishing(to: str) -> Iterator[Publisher]:
    publisher = Publisher(parse_target(to), ViewSetup("bench", "bench")).start()
    try:
        yield publisher
    finally:
        publisher.close()


def publishing_process() -> psutil.Process:
    running = [
        process
        for process in psutil.Process().children()
        if "imumon.publishing.child" in " ".join(process.cmdline())
    ]
    (found,) = running
    return found


def test_every_sample_comes_as_it_was_published(receiver: Receiver) -> None:
    with publishing(f"udp-json=127.0.0.1:{receiver.port}") as publisher:
        stream = Stream(publisher.publish)
        assert wait_until(lambda: publisher.state.ready)  # what waits comes at once: too much for UDP
        for _ in range(20):  # as 1 kHz is published
            stream.send(80)
            assert wait_until(lambda: len(receiver.rows("imu")) == stream.sent)
        assert wait_until(lambda: publisher.state.sent == stream.sent + 2), publisher.state
        assert wait_until(lambda: len(receiver.rows("state")) >= 2), (
            "states are said again for who comes later"
        )
    rows = receiver.rows("imu")
    assert [row["sample"] for row in rows] == [*range(stream.sent)]
    for name in (*GYRO, "temperature", "host_time_ns"):
        sent = np.concatenate([one[name] for one in stream.blocks])
        assert [row[name] for row in rows] == sent.tolist(), "not a bit of it differs"
    stamps = [message["timestamp"] for message in receiver.messages if "imu" in message]
    assert stamps[0] == pytest.approx(rows[0]["host_time_ns"] * 1e-9, abs=1e-6)
    assert receiver.rows("log") == [{"level": "INFO", "text": "port opened"}]
    assert {json.dumps(row) for row in receiver.rows("state")} == {'{"port": "open"}'}
    assert publisher.state.dropped == 0


def test_a_process_that_takes_nothing_costs_samples_and_no_time(receiver: Receiver) -> None:
    with publishing(f"udp-json=127.0.0.1:{receiver.port}") as publisher:
        stream = Stream(publisher.publish)
        stream.run_until(lambda: len(receiver.rows("imu")) > 0, "sending")
        os.kill(publishing_process().pid, signal.SIGSTOP)
        large = Timebase().samples(block(0, 20_000))
        count, began = 2 * QUEUE_BYTES // large.nbytes + 20, time.monotonic()
        for _ in range(count):
            publisher.publish(large)
        assert time.monotonic() - began < LIMIT_S
        assert publisher.state.dropped >= 20_000
        begins_to_close = time.monotonic()
    assert time.monotonic() - begins_to_close < LIMIT_S
    state = publisher.state
    assert state.sent + state.dropped == stream.sent + count * large.rows + 2, "each is the one or the other"


def test_a_killed_process_is_started_again_and_what_it_missed_is_counted(receiver: Receiver) -> None:
    with publishing(f"udp-json=127.0.0.1:{receiver.port}") as publisher:
        stream = Stream(publisher.publish)
        stream.run_until(lambda: len(receiver.rows("imu")) > 0, "sending")
        os.kill(publishing_process().pid, signal.SIGKILL)
        stream.run_until(lambda: publisher.state.dropped > 0, "counted")
        seen = len(receiver.rows("imu"))
        stream.run_until(lambda: len(receiver.rows("imu")) > seen, "sending again")
        # A batch waits for 0.05 s in the queue, and what was sent is told four times a second.
        publisher.close()
    state = publisher.state
    assert state.sent + state.dropped == stream.sent + 2
    assert wait_until(lambda: len(receiver.rows("imu")) + len(receiver.rows("log")) + 1 >= state.sent), (
        "nothing is called sent that was not"
    )
    assert 0 < state.dropped < stream.sent


def test_nobody_listens_and_it_does_not_matter() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with publishing(f"udp-json=127.0.0.1:{port}") as publisher:
        stream = Stream(publisher.publish)
        stream.run_until(lambda: publisher.state.sent > 100, "sending")
        assert publisher.state.ready


def test_what_the_system_does_not_take_is_counted() -> None:
    with publishing("udp-json=255.255.255.255:9") as publisher:  # a broadcast, which needs a permission
        stream = Stream(publisher.publish)
        stream.run_until(lambda: publisher.state.dropped > 0, "counted")
        assert "cannot send: Permission denied" in publisher.state.text
        assert publisher.state.sent == 0


@pytest.mark.long
def test_monitor_publishes_what_it_records(receiver: Receiver, tmp_path: Path) -> None:
    with VirtualDevice(AX1, tmp_path / "ahrs") as ahrs:
        found = answer(
            "monitor", ahrs.port.path, "--device", "ax1", "--view", "none", "--seconds", 3,
            "--out", tmp_path / "s", "--publish", f"udp-json=127.0.0.1:{receiver.port}",
        )  # fmt: skip
    ((to, sent, dropped),) = [one.values() for one in found["published"]]
    assert to == f"udp-json=127.0.0.1:{receiver.port}"
    assert dropped == 0
    assert sent > found["samples"] > 100, "states and log lines are sent as well"
    assert wait_until(lambda: len(receiver.rows("imu")) > 0)
    rows = receiver.rows("imu")
    numbers = [row["sample"] for row in rows]
    assert numbers == sorted({*numbers}), "what a busy receiver missed are gaps, also at the end"
    assert numbers[-1] < found["samples"]
    assert {"gyro_x", "at_rest", "host_time_ns", "sample"} <= rows[-1].keys()


def test_monitor_states_what_leaves_this_computer_and_begins_nothing_it_cannot_do(tmp_path: Path) -> None:
    with VirtualDevice(AX1, tmp_path / "ahrs") as ahrs:
        port = (ahrs.port.path, "--device", "ax1", "--view", "none", "--out", tmp_path / "s", "--seconds", 1)
        done = imumon("monitor", *port, "--publish", "udp-json=192.0.2.7")
        assert "WARN" in done.stderr
        assert "the measurements go to 192.0.2.7" in done.stderr
        done = imumon("monitor", *port[:-3], tmp_path / "t", "--publish", "mqtt")
    assert done.returncode == 2
    assert not (tmp_path / "t").exists()
