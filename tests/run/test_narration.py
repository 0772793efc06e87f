from __future__ import annotations

import pytest

from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.run.narration import Narrator
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
