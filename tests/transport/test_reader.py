from __future__ import annotations

import queue
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from imumon.errors import ImumonError, Reason
from imumon.simulation.virtual_port import VirtualPort
from imumon.transport import port as port_module
from imumon.transport.reader import Event, EventKind, Item, Reader, Sink
from imumon.transport.settings import PortSettings
from tests.faults.port import FaultyPort
from tests.transport.helpers import Collector, tcp_server
from tests.waiting import LIMIT_S, wait_until

pytestmark = pytest.mark.usefixtures("no_leaks")

PACKET = b"\xaa\x55" + bytes(range(40))


@contextmanager
def reading(settings: PortSettings, *sinks: Sink, silent_after_s: float = LIMIT_S) -> Iterator[Reader]:
    """Read a port; without `silent_after_s` nothing is silent, however slowly the test goes on."""
    reader = Reader(settings, *sinks, silent_after_s=silent_after_s)
    reader.start()
    try:
        yield reader
    finally:
        reader.stop()


def test_bytes_and_events_come_in_order_with_stamps_that_never_go_back() -> None:
    sink, before = Collector(), time.time_ns()
    with VirtualPort(baudrate=921600) as device, reading(PortSettings(device.path, 921600), sink):
        for n in range(1, 5):
            device.write(PACKET)
            assert sink.got(PACKET * n)  # handed on as it comes, not at the end
    after = time.time_ns()
    stamps = [item.time_ns for item in sink.items]
    assert sink.kinds == [EventKind.OPENED, EventKind.CLOSED]
    assert isinstance(sink.items[0], Event)
    assert stamps == sorted(stamps)
    assert before <= stamps[0] <= stamps[-1] <= after
    assert len(stamps) >= 6


def test_every_sink_gets_everything() -> None:
    items: queue.SimpleQueue[Item] = queue.SimpleQueue()
    sink = Collector()
    with VirtualPort() as device, reading(PortSettings(device.path), sink, items.put):
        device.write(PACKET)
        assert sink.got(PACKET)
    assert [items.get_nowait() for _ in range(items.qsize())] == sink.items


RATE = 2_000_000
BURST = 90
"""Packets; a pseudo-terminal holds 4 kB when nobody is run who reads."""


def test_packets_cut_in_pieces_and_bursts_arrive_unchanged() -> None:
    sink = Collector()
    with VirtualPort(baudrate=RATE) as device, reading(PortSettings(device.path, RATE), sink):
        device.write(PACKET[:7])
        assert sink.got(PACKET[:7])
        device.write(PACKET[7:])
        assert sink.got(PACKET)
        for n in range(1, 16):
            device.write(PACKET * BURST)
            assert sink.got(PACKET * (1 + n * BURST))


def test_a_port_that_was_never_there_is_not_waited_for() -> None:
    sink = Collector()
    with pytest.raises(ImumonError) as caught:
        Reader(PortSettings("/dev/ttyUSB77"), sink).start()
    assert caught.value.reason is Reason.NOT_FOUND
    assert sink.items == []


def test_silence_is_reported_once_and_ends_with_the_next_byte() -> None:
    sink = Collector()
    with FaultyPort() as device, reading(PortSettings(device.path), sink, silent_after_s=0.1):
        device.write(PACKET)
        assert sink.saw(EventKind.SILENT)
        silences = sink.kinds.count(EventKind.SILENT)
        time.sleep(0.2)
        device.write(PACKET)
        assert sink.saw(EventKind.RESUMED, times=silences)
        device.silence()
        assert sink.saw(EventKind.SILENT, times=silences + 1)
    opened, *between, closed = sink.kinds
    assert (opened, closed) == (EventKind.OPENED, EventKind.CLOSED)
    assert between[::2] == [EventKind.SILENT] * (silences + 1), "each is said once"
    assert between[1::2] == [EventKind.RESUMED] * silences
    assert "0 bytes in the last " in sink.events[1].detail


def test_a_device_that_never_spoke_is_silent_too() -> None:
    sink = Collector()
    with VirtualPort() as device, reading(PortSettings(device.path), sink, silent_after_s=0.05):
        assert sink.saw(EventKind.SILENT)


@pytest.mark.parametrize("all_read", [True, False])
def test_an_unplugged_device_is_lost_and_found_again(all_read: bool, tmp_path: Path) -> None:
    sink = Collector()
    with VirtualPort(tmp_path / "ttyIMU") as device, reading(PortSettings(device.path), sink):
        device.write(PACKET)
        assert sink.got(PACKET)
        device.write(PACKET * 3)
        if all_read:
            assert sink.got(PACKET * 4)
        device.unplug()
        assert sink.saw(EventKind.LOST)
        assert sink.saw(EventKind.UNAVAILABLE)
        device.replug()
        assert sink.saw(EventKind.OPENED, times=2)
        device.write(PACKET[::-1])
        assert sink.got(PACKET[::-1])
    assert sink.kinds[:3] == [EventKind.OPENED, EventKind.LOST, EventKind.UNAVAILABLE]
    assert sink.kinds[-2:] == [EventKind.OPENED, EventKind.CLOSED]
    assert "ENOENT" in sink.events[2].detail
    assert "; Plug the device in" in sink.events[2].detail  # an event is a line of the log
    assert "\n" not in sink.events[2].detail
    assert "again after" in sink.events[-2].detail


def test_a_device_that_reboots_several_times_is_followed(tmp_path: Path) -> None:
    sink = Collector()
    with VirtualPort(tmp_path / "ttyIMU") as device, reading(PortSettings(device.path), sink):
        for boot in range(4):
            assert sink.saw(EventKind.OPENED, times=boot + 1)
            message = b"boot %d" % boot
            device.write(message)
            assert sink.got(message)
            device.unplug()
            device.replug()
    assert sink.data == b"boot 0boot 1boot 2boot 3"


def test_low_latency_is_requested_at_every_opening(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def ask(handle: serial.Serial) -> str:
        asked.append(str(handle.port))
        return f"opening {len(asked)}"

    monkeypatch.setattr("imumon.transport.port._set_low_latency", ask)
    sink = Collector()
    with VirtualPort(tmp_path / "ttyIMU") as device, reading(PortSettings(device.path), sink):
        device.unplug()
        device.replug()
        assert sink.saw(EventKind.OPENED, times=2)
    opened = [event.detail for event in sink.events if event.kind is EventKind.OPENED]
    assert asked == [device.path] * 2
    assert [detail.endswith(f"low latency: opening {n + 1}") for n, detail in enumerate(opened)] == [True] * 2


def test_a_silent_port_that_was_replaced_is_reopened(tmp_path: Path) -> None:
    sink, link = Collector(), tmp_path / "ttyIMU"
    with VirtualPort() as old, VirtualPort() as new:
        link.symlink_to(old.path)
        with reading(PortSettings(str(link)), sink, silent_after_s=0.05):
            assert sink.saw(EventKind.SILENT)
            link.unlink()
            link.symlink_to(new.path)
            assert sink.saw(EventKind.OPENED, times=2)
            new.write(PACKET)
            assert sink.got(PACKET)
    lost = next(event for event in sink.events if event.kind is EventKind.LOST)
    assert "device node" in lost.detail


def test_a_host_at_the_wrong_rate_gets_bytes_that_are_not_those_sent() -> None:
    sink = Collector()
    with VirtualPort(baudrate=115200) as device, reading(PortSettings(device.path, 57600), sink):
        device.write(PACKET * 20)
        assert device.drain()
        assert wait_until(lambda: len(sink.data) > 100)
    assert PACKET not in sink.data
    assert sink.kinds == [EventKind.OPENED, EventKind.CLOSED]


def test_another_program_that_reads_along_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(port_module, "holders", lambda _device: ["cat /dev/ttyUSB0 (pid 7)"])
    sink = Collector()
    with VirtualPort() as device, reading(PortSettings(device.path), sink):
        device.write(PACKET)
        assert sink.got(PACKET)
    assert sink.kinds == [EventKind.OPENED, EventKind.SHARED, EventKind.CLOSED]
    assert "pid 7" in sink.events[1].detail


def test_a_closed_connection_is_lost_and_made_again() -> None:
    def serve(client: socket.socket) -> None:
        client.sendall(PACKET)

    sink = Collector()
    with tcp_server(serve) as number, reading(PortSettings(f"socket://127.0.0.1:{number}"), sink):
        assert sink.saw(EventKind.LOST, times=2)
    assert sink.data[: 2 * len(PACKET)] == PACKET * 2


@pytest.mark.parametrize("state", ["reading", "silent", "lost"])
def test_stopping_works_in_every_state_and_twice(state: str, tmp_path: Path) -> None:
    sink = Collector()
    # Under a name of its own: the number of a pulled pty is given to the next one that any process opens.
    with VirtualPort(tmp_path / "ttyIMU") as device:
        with reading(PortSettings(device.path), sink, silent_after_s=0.05) as reader:
            if state == "silent":
                assert sink.saw(EventKind.SILENT)
            elif state == "lost":
                device.unplug()
                assert sink.saw(EventKind.UNAVAILABLE)
            reader.stop()
        assert sink.kinds[-1] is EventKind.CLOSED


def test_event_kinds_are_written_into_recordings_and_keep_their_values() -> None:
    of_the_port = {"opened", "silent", "resumed", "lost", "unavailable", "shared", "closed"}
    assert {kind.value for kind in EventKind} == of_the_port | {"mark", "start", "stop"}
