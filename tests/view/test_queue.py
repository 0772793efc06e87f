from __future__ import annotations

import threading
import time

from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.view.items import DropOldestQueue, Log, Samples, State, Status, Timebase, ViewItem
from tests.view.streams import block
from tests.waiting import LIMIT_S


def samples(count: int) -> list[Samples]:
    timebase = Timebase()
    return [timebase.samples(block(10 * k, 10)) for k in range(count)]


@settings(max_examples=50, deadline=None)
@given(count=st.integers(1, 40), room=st.integers(1, 20))
def test_newest_survive_and_the_rest_are_counted(count: int, room: int) -> None:
    items = samples(count)
    queue = DropOldestQueue(room * items[0].nbytes)
    for item in items:
        queue.put(item)
    kept = queue.take(0.0, 0.0)
    assert kept == items[-room:]
    assert queue.dropped == 10 * max(0, count - room)


def test_latest_state_and_status_outlive_their_place() -> None:
    items = samples(5)
    at = Timebase().at(0)
    queue = DropOldestQueue(2 * items[0].nbytes)
    lasting: list[ViewItem] = [
        State(at, "port", "opening"),
        State(at, "port", "lost"),
        Status(at, {"a": "1"}),
    ]
    for item in [*lasting, Log(at, "gone"), *items]:
        queue.put(item)
    assert queue.take(0.0, 0.0) == [*lasting[1:], *items[-2:]]
    assert queue.dropped == 31


def test_an_item_larger_than_the_queue_is_dropped_and_counted() -> None:
    item = samples(1)[0]
    queue = DropOldestQueue(item.nbytes - 1)
    queue.put(item)
    assert queue.take(0.0, 0.0) == []
    assert queue.dropped == 10


def test_take_waits_for_the_first_item() -> None:
    queue = DropOldestQueue(1 << 20)
    item = samples(1)[0]
    timer = threading.Timer(0.05, queue.put, [item])
    timer.start()
    assert queue.take(0.0, LIMIT_S) == [item]
    timer.join()


def test_batches_come_at_once_but_not_sooner_after_each_other() -> None:
    queue = DropOldestQueue(1 << 20)
    first, *rest = samples(3)
    asked = time.monotonic()
    queue._taken_s = asked - LIMIT_S  # as if nothing had come for so long
    queue.put(first)
    assert queue.take(LIMIT_S, 0.0) == [first]
    assert time.monotonic() - asked < LIMIT_S
    taken = time.monotonic()
    queue.put(rest[0])
    timer = threading.Timer(0.05, queue.put, [rest[1]])
    timer.start()
    assert queue.take(0.5, 0.0) == rest
    assert time.monotonic() - taken > 0.4
    timer.join()


def test_close_ends_waiting_and_gathering() -> None:
    queue = DropOldestQueue(1 << 20)
    queue.put(samples(1)[0])
    timer = threading.Timer(0.05, queue.close)
    timer.start()
    started = time.monotonic()
    assert len(queue.take(2 * LIMIT_S, 2 * LIMIT_S)) == 1
    assert queue.take(2 * LIMIT_S, 2 * LIMIT_S) == []
    timer.join()
    assert time.monotonic() - started < LIMIT_S
