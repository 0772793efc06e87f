from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.run.narration import Narrator
from imumon.run.replay import replay
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.transport.reader import Bytes, Event, EventKind, Reads
from imumon.transport.settings import PortSettings
from imumon.view.items import Log, Numbers, State, Status, ViewItem

AX1 = load_device("ax1")
START = 1_700_000_000_000_000_000
S = 1_000_000_000


def narrated() -> tuple[Pipeline, Narrator, list[ViewItem]]:
    pipeline, items = Pipeline(AX1), list[ViewItem]()
    settings, card = PortSettings("/dev/ttyUSB0"), {"device": "x"}
    narrator = Narrator(pipeline, settings, [items.append], lambda *_: None, card)
    return pipeline, narrator, items


def send(pipeline: Pipeline, narrator: Narrator, seconds: int, damage: bool = False) -> int:
    """Send at 100 Hz with a tick twice a second; return the time at the end."""
    packets = AX1.encoder().encode(SimulatedUnit(load_scenario("bench")).samples(100 * seconds))
    now = START
    for number, packet in enumerate(packets):
        now = START + number * 10_000_000
        data = packet[:30] + packet[31:] if damage else packet
        pipeline.feed(data, now)
        narrator.item(Reads.of([Bytes(data, now)]))
        if number % 50 == 0:
            narrator.samples(pipeline.take())
            narrator.tick(now)
    return now


def states(items: list[ViewItem], lane: str) -> list[str]:
    return [item.state for item in items if isinstance(item, State) and item.lane == lane]


def test_rates_losses_and_lanes_follow_the_data() -> None:
    pipeline, narrator, items = narrated()
    now = send(pipeline, narrator, 62)
    progress = narrator.tick(now)
    assert 95 < progress.packets_per_s < 105
    assert progress.link_load is not None
    assert 0.45 < progress.link_load < 0.55
    assert states(items, "clock") == ["acquiring", "synchronised"]
    assert states(items, "data") == ["ok"]
    assert states(items, "status") == ["0x0007"]
    assert states(items, "link")[-1] == "ok"


def test_the_rates_of_a_run_that_has_ended_are_those_from_its_first_byte_to_its_last() -> None:
    pipeline, narrator, _ = narrated()
    last = narrator.tick(send(pipeline, narrator, 10) + 1_200_000_000)  # a port takes its time to close
    assert last.packets_per_s < 50
    ended = narrator.ended(last)
    assert ended.packets_per_s == pytest.approx(100.0)
    assert ended.link_load == pytest.approx(5800 / 11520, rel=1e-3)


def test_what_had_queued_up_before_the_start_is_no_load_of_the_run() -> None:
    pipeline, narrator, _ = narrated()
    narrator.item(Reads.of([Bytes(bytes(100_000), START)]))
    pipeline.feed(bytes(100_000), START)
    ended = narrator.ended(narrator.tick(send(pipeline, narrator, 10)))
    assert ended.link_load == pytest.approx(0.5, rel=0.02)


LINE = PortSettings("/dev/ttyUSB0", 100_000)  # carries 10 000 bytes/s


class Link:
    """Shows what arrives on a line, and ticks twice a second."""

    def __init__(self, settings: PortSettings) -> None:
        self._pipeline, self.items = Pipeline(AX1), list[ViewItem]()
        self._narrator = Narrator(self._pipeline, settings, [self.items.append], lambda *_: None, {})
        self._narrator.tick(START)
        self._next_ms = 500
        self.loads: list[float | None] = []

    @property
    def warned(self) -> bool:
        return "warning: full" in states(self.items, "link")

    @property
    def is_full(self) -> bool:
        return states(self.items, "link")[-1] == "warning: full"

    def until(self, time_ms: int) -> None:
        for tick_ms in range(self._next_ms, time_ms + 1, 500):
            self.loads.append(self._narrator.tick(START + tick_ms * 1_000_000).link_load)
            self._next_ms = tick_ms + 500

    def arrive(self, n_bytes: int, time_ms: int) -> None:
        self.until(time_ms - 1)
        now = START + time_ms * 1_000_000
        self._pipeline.feed(bytes(n_bytes), now)
        self._narrator.item(Reads.of([Bytes(bytes(n_bytes), now)]))

    def stream(self, bytes_per_s: int, start_s: float, stop_s: float) -> None:
        for time_ms in range(round(start_s * 1000), round(stop_s * 1000), 10):
            self.arrive(bytes_per_s // 100, time_ms)
        self.until(round(stop_s * 1000))


def test_nothing_received_is_no_load() -> None:
    link = Link(LINE)
    link.until(5000)
    assert set(link.loads) == {0.0}
    assert not link.warned


@pytest.mark.parametrize("seconds", [1.0, 7.0])
def test_a_steady_stream_has_its_load_soon_and_late(seconds: float) -> None:
    link = Link(LINE)
    link.stream(5000, 0.0, seconds)
    assert link.loads[-1] == pytest.approx(0.5, abs=0.011)


def test_the_load_decays_to_zero_when_the_device_goes_silent() -> None:
    link = Link(LINE)
    link.stream(5000, 0.0, 4.0)
    link.until(7500)
    assert link.loads[9] == pytest.approx(0.25, abs=0.011)
    assert link.loads[-1] == 0.0


def test_parity_and_stop_bits_load_the_line() -> None:
    link = Link(PortSettings("/dev/ttyUSB0", 100_000, parity="E", stopbits=2))
    link.stream(5000, 0.0, 4.0)
    assert link.loads[-1] == pytest.approx(0.6, abs=0.011)


def test_the_warning_comes_above_80_percent_and_goes_below_70() -> None:
    link, seen = Link(LINE), []
    steps = [(7800, False), (8200, True), (7500, True), (6800, False), (7500, False)]
    for index, (rate, _) in enumerate(steps):
        link.stream(rate, 4.0 * index, 4.0 * index + 4.0)
        seen.append(link.is_full)
    assert seen == [warned for _, warned in steps]


def test_a_network_stream_has_no_load() -> None:
    link = Link(PortSettings("socket://host:4000"))
    link.stream(9_000_000, 0.0, 2.0)
    assert set(link.loads) == {None}
    assert not states(link.items, "link")


def test_a_backlog_at_the_start_is_no_overload() -> None:
    link = Link(PortSettings("/dev/ttyUSB0", 115200))
    link.arrive(40_000, 0)
    link.stream(5760, 0.0, 6.0)
    assert not link.warned


def late(arrivals_ms: range, stalls_s: list[tuple[float, float]]) -> list[int]:
    """Return the times at which reads end that cannot happen during the stalls (begin and end, s), ms."""
    ends = []
    for time_ms in arrivals_ms:
        stall = next((stop for start, stop in stalls_s if start <= time_ms / 1000 < stop), None)
        ends.append(time_ms if stall is None else int(stall * 1000))
    return ends


@pytest.mark.parametrize(
    "stalls_s",
    [
        [(10.0, 10.9)],
        [(10.05, 10.5)],
        [(10.0, 14.0)],
        [(10.0, 50.0)],
        [(10.0, 14.0), (14.3, 15.9)],
        [(0.0, 9.0)],
    ],
)
def test_a_read_that_comes_late_is_no_load(stalls_s: list[tuple[float, float]]) -> None:
    link = Link(LINE)
    for time_ms in late(range(0, 60_000, 10), stalls_s):
        link.arrive(50, time_ms)
    assert max(load or 0.0 for load in link.loads) < 0.6
    assert link.loads[-1] == pytest.approx(0.5, abs=0.011)
    assert not link.warned


@pytest.mark.parametrize("bytes_per_s", [9000, 11_500])
def test_a_line_that_is_full_is_reported_on_a_busy_computer_too(bytes_per_s: int) -> None:
    link = Link(LINE)
    for time_ms in late(range(0, 30_000, 10), [(10.0, 11.0), (20.0, 20.4)]):
        link.arrive(bytes_per_s // 100, time_ms)
    assert link.warned


def test_bytes_that_do_not_frame_are_called_so_once() -> None:
    pipeline, narrator, items = narrated()
    send(pipeline, narrator, 6, damage=True)
    assert states(items, "data") == ["bad: does not frame"]
    lines = [item for item in items if isinstance(item, Log)]
    assert len(lines) == 1
    assert "wrong baud rate or device" in lines[0].text


def test_two_devices_on_one_line_are_called_so_once_and_not_at_each_packet() -> None:
    pipeline, narrator, items = narrated()
    packets = AX1.encoder().encode(SimulatedUnit(load_scenario("bench")).samples(6000))
    both = [
        packet for one, other in zip(packets[:500], packets[5000:], strict=False) for packet in (one, other)
    ]
    for number, packet in enumerate([*packets[:200], *both, *packets[500:900]]):
        now = START + number * 10_000_000
        pipeline.feed(packet, now)
        narrator.item(Reads.of([Bytes(packet, now)]))
        if number % 25 == 0:
            narrator.samples(pipeline.take())
            narrator.tick(now)
    lines = [item.text for item in items if isinstance(item, Log)]
    assert pipeline.counters.clock_restarts > 100
    assert sum("two devices" in line for line in lines) == 1
    assert sum("started anew: segment" in line for line in lines) < 10


def test_a_lost_port_does_not_fill_the_recording() -> None:
    pipeline, narrator, items = narrated()
    now = send(pipeline, narrator, 4)
    narrator.item(Event(EventKind.LOST, now, "gone"))
    for tick in range(10):
        narrator.tick(now + tick * S)
    settled = len(items)
    for tick in range(10, 10_000):
        narrator.tick(now + tick * S)
    kinds = [type(item) for item in items[settled:]]
    assert kinds.count(Status) + kinds.count(Numbers) == 0
    assert len(kinds) < 5


def test_a_table_is_shown_at_the_times_of_its_own_clock() -> None:
    pipeline, items = Pipeline(None), list[ViewItem]()
    narrator = Narrator(pipeline, None, [items.append], lambda *_: None, {})
    time_ns, zeros = 10_000_000 * np.arange(1000), np.zeros(1000, np.int64)
    moved = zeros.copy()
    moved[400:600] = 1
    table = {"device_time_ns": time_ns, "segment": zeros, "gyro_x": np.zeros(1000), "at_rest": 1 - moved}
    assert sum(map(len, replay([SampleBlock(table)], pipeline, narrator))) == 1000
    events = [item for item in items if isinstance(item, State | Status | Numbers)]
    assert all(item.at.host_ns is None for item in events)
    motion = [item for item in events if isinstance(item, State) and item.lane == "motion"]
    assert [(item.state, item.at.device_ns) for item in motion] == [
        ("rest", 0),
        ("moving", 4 * S),
        ("rest", 6 * S),
    ]
