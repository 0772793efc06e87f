"""What a summary says of time and disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from imumon.run.account import NAMED, Outages, describe_disk, file_sizes
from imumon.transport.reader import Bytes, Event, EventKind, Reads

SECOND = 1_000_000_000


def watched(*items: Reads | Event) -> Outages:
    outages = Outages()
    for item in items:
        outages.item(item)
    return outages


def event(kind: EventKind, second: float) -> Event:
    return Event(kind, round(second * SECOND), "")


def data(second: float) -> Reads:
    return Reads.of([Bytes(b"x", round(second * SECOND))])


def test_an_outage_lasts_from_the_last_byte_to_the_ports_return() -> None:
    found = watched(
        event(EventKind.OPENED, 0),
        data(1),
        event(EventKind.SILENT, 2),
        event(EventKind.LOST, 3),
        event(EventKind.UNAVAILABLE, 4),
        event(EventKind.OPENED, 6),
        data(7),
        event(EventKind.SILENT, 8),
        event(EventKind.RESUMED, 8.5),
        data(9),
    )
    assert [(one["kind"], one["seconds"]) for one in found.as_data()] == [("lost", 5.0), ("silent", 1.5)]
    assert "2, 6.5 s in all" in found.describe()


def test_a_mark_does_not_shorten_an_outage() -> None:
    found = watched(
        data(1),
        event(EventKind.MARK, 1.9),
        event(EventKind.SILENT, 2),
        event(EventKind.START, 3),
        event(EventKind.RESUMED, 5),
    )
    assert found.as_data()[0]["seconds"] == pytest.approx(4.0)


def test_an_outage_that_lasts_ends_with_the_recording() -> None:
    found = watched(data(1), event(EventKind.LOST, 2), event(EventKind.CLOSED, 5))
    assert found.as_data()[0]["seconds"] == pytest.approx(4.0)


def test_no_outage_is_reported_as_none_and_many_are_counted() -> None:
    assert watched(event(EventKind.OPENED, 0), data(1), event(EventKind.CLOSED, 2)).describe() == "none"
    flapping = [event(kind, k) for k in range(NAMED + 5) for kind in (EventKind.LOST, EventKind.OPENED)]
    assert "5 more" in watched(*flapping).describe()


def test_every_file_is_counted(tmp_path: Path) -> None:
    (tmp_path / "wire.mcap").write_bytes(b"x" * 1500)
    (tmp_path / "session.yaml").write_bytes(b"x" * 20)
    assert file_sizes(tmp_path) == {"session.yaml": 20, "wire.mcap": 1500}
    assert describe_disk(tmp_path) == "1.5 kB: session.yaml 20 bytes, wire.mcap 1.5 kB"
