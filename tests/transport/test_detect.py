from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from imumon.errors import ImumonError, Reason, bad_config
from imumon.simulation.virtual_port import VirtualPort
from imumon.transport.detect import COMMON_BAUDRATES, Verdict, baudrates_to_try, detect, failure
from imumon.transport.port import Port, open_port
from imumon.transport.settings import PortSettings
from imumon.transport.statistics import Counters
from tests.transport.helpers import tcp_server
from tests.waiting import LIMIT_S

pytestmark = pytest.mark.usefixtures("no_leaks")

TEXT_S = 2.0
"""Text and packets in part are listened to for as long as asked: enough for some to come."""


class Framer:
    """Packets of 16 bytes: two sync bytes, 13 of payload, the sum of the payload."""

    def __init__(self, sync: bytes, understands: bool = True) -> None:
        self.sync, self.understands, self.taken = sync, understands, 0
        self.held = b""
        self.received = self.framed = self.packets = self.errors = 0

    def feed(self, data: bytes, arrival_ns: int) -> None:
        assert arrival_ns >= 0
        self.received += len(data)
        self.held += data
        while len(self.held) >= 16:
            good = self.held[15] == sum(self.held[2:15]) & 0xFF
            if self.held.startswith(self.sync) and good:
                self.packets += 1
                self.framed += 16
                self.held = self.held[16:]
            else:
                self.errors += self.held.startswith(self.sync)
                self.held = self.held[1:]

    def finish(self) -> None: ...

    def take(self) -> range:
        new, self.taken = self.packets - self.taken, self.packets
        return range(new if self.understands else 0)

    def counters(self) -> Counters:
        skipped = self.received - self.framed - len(self.held)
        return Counters(self.received, self.framed, skipped, self.packets, self.errors)


CANDIDATES: dict[str, Callable[[], Framer]] = {
    "other": lambda: Framer(b"\x75\x65"),
    "mine": lambda: Framer(b"\xaa\x55"),
}


def packet(number: int) -> bytes:
    payload = bytes((number * 7 + k * k) & 0xFF for k in range(13))
    return b"\xaa\x55" + payload + bytes([sum(payload) & 0xFF])


@contextmanager
def sending(device: VirtualPort, make: Callable[[int], bytes] = packet) -> Iterator[None]:
    """Let the device send all the time."""
    stopping = threading.Event()

    def run() -> None:
        number = 0
        while not stopping.is_set():
            device.write(make(number))
            number += 1
            time.sleep(0.002)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join()


def test_rate_and_protocol_are_found_among_wrong_ones() -> None:
    tried: list[int] = []

    def begin(settings: PortSettings) -> bytearray:
        tried.append(settings.baudrate)
        return bytearray()

    with VirtualPort(baudrate=57600) as device, sending(device):
        evidence = detect(
            device.path,
            CANDIDATES,
            [115200, 230400, 57600, 9600],
            LIMIT_S,
            begin,
        )
    best = evidence[0]
    assert (best.protocol, best.baudrate, best.verdict) == ("mine", 57600, Verdict.FRAMES)
    assert best.share_framed > 0.8
    assert best.bytes_per_s == best.bytes_received / best.seconds
    assert tried == [115200, 230400, 57600]  # 9600 need not be tried any more
    assert {item.verdict for item in evidence[1:]} <= {Verdict.NOTHING, Verdict.PARTLY}
    assert failure(device.path, evidence) is None


def test_of_two_that_frame_the_one_that_understands_the_packets_comes_first() -> None:
    relatives = {"deaf": lambda: Framer(b"\xaa\x55", understands=False), "mine": CANDIDATES["mine"]}
    with VirtualPort(baudrate=115200) as device, sending(device):
        first, second = detect(device.path, relatives, [115200], LIMIT_S)
    assert (first.protocol, second.protocol) == ("mine", "deaf")
    assert (first.verdict, second.verdict) == (Verdict.FRAMES, Verdict.UNREAD)
    assert first.samples == first.packets >= 5
    assert second.samples == 0


def test_listening_ends_early_when_the_evidence_is_overwhelming() -> None:
    with VirtualPort(baudrate=921600) as device, sending(device):
        evidence = detect(device.path, CANDIDATES, [921600], LIMIT_S)
    assert evidence[0].packets >= 50
    assert evidence[0].seconds < LIMIT_S


@pytest.mark.parametrize("refused", [[57600], [115200]])
def test_a_rate_that_the_adapter_refuses_takes_no_evidence_away(
    monkeypatch: pytest.MonkeyPatch, refused: list[int]
) -> None:
    def opened(settings: PortSettings) -> Port:
        if settings.baudrate in refused:
            raise bad_config("not offered by this driver")
        return open_port(settings)

    monkeypatch.setattr("imumon.transport.detect.open_port", opened)
    with VirtualPort(baudrate=9600) as device:
        rates = [115200, 57600]
        evidence = detect(device.path, CANDIDATES, rates, 0.1)
        assert {item.baudrate for item in evidence} == {*rates} - {*refused}
        refused += rates
        with pytest.raises(ImumonError, match="not offered"):
            detect(device.path, CANDIDATES, rates, 0.1)


def test_a_silent_port_is_an_honest_result() -> None:
    with VirtualPort() as device:
        evidence = detect(device.path, CANDIDATES, seconds_each=0.05)
    assert {item.verdict for item in evidence} == {Verdict.SILENT}
    assert len({item.baudrate for item in evidence}) == 3
    error = failure(device.path, evidence)
    assert error is not None
    assert error.reason is Reason.SILENT
    assert "RX and TX" in error.hint


def test_a_protocol_that_nobody_knows_is_a_wrong_baud_rate_or_protocol() -> None:
    with (
        VirtualPort(baudrate=115200) as device,
        sending(device, lambda n: bytes([n & 0xFF, 3, 129, 77, 200]) * 10),
    ):
        evidence = detect(device.path, CANDIDATES, [115200], TEXT_S)
        error = failure(device.path, evidence)
    assert evidence[0].verdict is Verdict.NOTHING
    assert error is not None
    assert error.reason is Reason.WRONG_BAUD
    assert "0.0% of them frame" in error.seen
    assert "115200" in error.hint


def test_text_points_to_command_mode() -> None:
    with VirtualPort(baudrate=115200) as device, sending(device, lambda _: b"cmd> \r\n"):
        error = failure(device.path, detect(device.path, CANDIDATES, [115200], TEXT_S))
    assert error is not None
    assert "command mode" in error.hint


def test_text_is_listened_to_for_as_long_as_requested_at_its_rate() -> None:
    heard, tried = bytearray(), list[int]()

    def begin(settings: PortSettings) -> bytearray:
        heard.clear()
        tried.append(settings.baudrate)
        return heard

    with VirtualPort(baudrate=57600) as device, sending(device, lambda n: b"%d,2,3\r\n" % n * 10):
        evidence = detect(device.path, CANDIDATES, [115200, 57600, 9600], TEXT_S, begin)
    assert tried == [115200, 57600]
    assert all(item.seconds >= TEXT_S for item in evidence if item.baudrate == 57600)
    assert heard.count(b"\n") > 100


def test_bytes_of_one_kind_point_to_the_line() -> None:
    with VirtualPort(baudrate=115200) as device, sending(device, lambda _: b"\x00\xff\x00" * 20):
        error = failure(device.path, detect(device.path, CANDIDATES, [115200], TEXT_S))
    assert error is not None
    assert "inverted" in error.hint


def test_damaged_packets_frame_in_part() -> None:
    def damaged(number: int) -> bytes:
        return packet(number)[: 16 if number % 2 else 11]

    with VirtualPort(baudrate=115200) as device, sending(device, damaged):
        evidence = detect(device.path, CANDIDATES, [115200], TEXT_S)
        error = failure(device.path, evidence)
    assert evidence[0].verdict is Verdict.PARTLY
    assert error is not None
    assert "damaged or missing" in error.hint


def test_a_network_stream_is_listened_to_once() -> None:
    with tcp_server(lambda client: client.sendall(b"".join(map(packet, range(100))))) as number:
        evidence = detect(f"socket://127.0.0.1:{number}", CANDIDATES, seconds_each=LIMIT_S)
    assert (evidence[0].protocol, evidence[0].baudrate) == ("mine", None)
    assert evidence[0].verdict is Verdict.FRAMES


def test_a_port_that_does_not_exist_is_an_error() -> None:
    with pytest.raises(ImumonError) as caught:
        detect("/dev/ttyUSB77", CANDIDATES)
    assert caught.value.reason is Reason.NOT_FOUND


def test_rates_of_known_devices_come_first_and_none_twice() -> None:
    rates = baudrates_to_try([460800, 9600])
    assert rates[:3] == [460800, 9600, 115200]
    assert sorted(rates) == sorted(COMMON_BAUDRATES)
    assert all(PortSettings("x", rate) for rate in rates)
