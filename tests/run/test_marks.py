"""Marks of a person: asked for in a file, put into the recording while it goes on."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.errors import ImumonError, Reason
from imumon.recordings.folder import open_session
from imumon.recordings.wire_reader import WireReader
from imumon.run.marks import REQUESTS, Marks, append_request, ask_for_mark
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.reader import Event, EventKind
from imumon.view.items import Log
from tests.run.test_live import AX1, Watcher, start
from tests.waiting import wait_until

KINDS = (EventKind.MARK, EventKind.START, EventKind.STOP)


def test_marks_are_events_of_the_recording_and_lanes_of_the_view(tmp_path: Path) -> None:
    watcher, folder = Watcher(), tmp_path / "s"
    with VirtualDevice(AX1, tmp_path / "ahrs") as ahrs:
        run = start(ahrs.port.path, folder, watcher)
        wait_until(lambda: run.progress.counters.packets > 20)
        ask_for_mark(folder, EventKind.START, "cold soak")
        ask_for_mark(folder, EventKind.MARK, "fan on")
        wait_until(lambda: "INFO mark: fan on" in watcher.lines)
        ask_for_mark(folder, EventKind.STOP, "cold soak")
        run.stop()
    events = [item for item in WireReader(folder / "wire.mcap") if isinstance(item, Event)]
    said = [(event.kind, event.detail) for event in events if event.kind in KINDS]
    assert said == [
        (EventKind.START, "cold soak"),
        (EventKind.MARK, "fan on"),
        (EventKind.STOP, "cold soak"),
    ]
    assert watcher.states("part") == ["cold soak", "between parts"]
    assert watcher.states("mark") == ["fan on"]
    assert any(isinstance(item, Log) and item.text == "end of part: cold soak" for item in watcher.items)
    assert not (folder / REQUESTS).exists()
    assert open_session(folder).metadata.results_digest is not None


def test_what_is_not_recorded_cannot_be_marked(tmp_path: Path) -> None:
    with VirtualDevice(AX1, tmp_path / "ahrs") as ahrs:
        run = start(ahrs.port.path, tmp_path / "s", Watcher())
        with pytest.raises(ImumonError, match="is empty"):
            ask_for_mark(tmp_path / "s", EventKind.MARK, " ")
        run.stop()
    with pytest.raises(ImumonError, match="not being recorded") as error:
        ask_for_mark(tmp_path / "s", EventKind.MARK, "late")
    assert error.value.reason is Reason.BAD_CONFIG


@given(st.lists(st.binary(max_size=40), max_size=5), st.integers(1, 7))
def test_no_line_stops_the_recording_and_none_is_taken_twice(
    tmp_path_factory: pytest.TempPathFactory, lines: list[bytes], cut: int
) -> None:
    folder = tmp_path_factory.mktemp("marks", numbered=True)
    asked = b'{"kind": "mark", "text": "a"}\n'
    data = b"".join(line.replace(b"\n", b"") + b"\n" for line in lines) + asked
    marks, found = Marks(folder), list[Event]()
    for end in (len(data) - cut, len(data)):
        (folder / REQUESTS).write_bytes(data[:end])
        found += marks.take(7)
    assert found.count(Event(EventKind.MARK, 7, "a")) == 1
    assert marks.take(8) == []
    marks.close()


def test_a_mark_has_the_time_at_which_it_was_requested(tmp_path: Path) -> None:
    before_ns = time.time_ns()
    append_request(tmp_path, EventKind.MARK, "fan on")
    after_ns = time.time_ns()
    time.sleep(0.2)
    (mark,) = Marks(tmp_path).take(time.time_ns())
    assert before_ns - 100_000_000 <= mark.time_ns <= after_ns + 100_000_000


@pytest.mark.parametrize("at", [0, 1 << 70, "-Infinity", "Infinity", "NaN", -(1 << 70), "true"])
def test_a_mark_with_the_time_of_another_clock_is_of_now(tmp_path: Path, at: object) -> None:
    (tmp_path / REQUESTS).write_text(f'{{"kind": "stop", "text": "a", "steady_ns": {at}}}\n')
    now_ns = 100_000_000_100
    assert Marks(tmp_path).take(now_ns) == [Event(EventKind.STOP, now_ns, "a")]


def test_a_clock_that_is_set_moves_no_mark(tmp_path: Path) -> None:
    append_request(tmp_path, EventKind.MARK, "fan on")
    session_ns = time.time_ns() - 30_000_000_000  # the computer's clock has been set since the session began
    (mark,) = Marks(tmp_path).take(session_ns)
    assert session_ns - 5_000_000_000 < mark.time_ns <= session_ns
