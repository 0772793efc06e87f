from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from imumon.recordings import recorder as recorder_module
from imumon.recordings.recorder import Recorder
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import WireReader
from imumon.transport.reader import Bytes
from tests.faults.killed import Machine, allowed_s
from tests.waiting import LIMIT_S

CHILD = """
import sys, time
from pathlib import Path
from imumon.recordings.recorder import Recorder
from imumon.recordings.wire import WireWriter
from imumon.transport.reader import Bytes

recorder = Recorder(WireWriter(Path(sys.argv[1]), {}), lambda problem: None, lambda: None)
recorder.start()
start = time.monotonic()
index = 0
while True:
    now = time.time_ns()
    recorder.put(Bytes(index.to_bytes(4, "little") * 10, now))
    print(index, now, flush=True)
    index += 1
    time.sleep(max(0.0, start + index * 0.0025 - time.monotonic()))
"""


def test_everything_older_than_200_ms_is_readable_after_sigkill(tmp_path: Path) -> None:
    path = tmp_path / "wire.mcap"
    command = [sys.executable, "-c", CHILD, str(path)]
    with Machine() as machine, subprocess.Popen(command, stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        put = [child.stdout.readline() for _ in range(300)]
        time.sleep(0.05)
        killed_ns = time.time_ns()
        child.send_signal(signal.SIGKILL)
        put += child.stdout.readlines()
    stamps = [int(line.split()[1]) for line in put if line.endswith(b"\n")]
    reader = WireReader(path)
    reads = [item for item in reader if isinstance(item, Bytes)]
    assert [int.from_bytes(read.data[:4], "little") for read in reads] == list(range(len(reads)))
    assert all(len(read.data) == 40 for read in reads)
    due = sum(stamp < killed_ns - allowed_s(machine.late_s) * 1e9 for stamp in stamps)
    assert len(stamps) >= 300
    assert len(reads) >= due
    assert not reader.summary.complete


def test_a_stopped_recorder_has_written_everything(tmp_path: Path) -> None:
    recorder = Recorder(WireWriter(tmp_path / "w.mcap", {}), print, lambda: None)
    items = [Bytes(b"%05d" % index, index) for index in range(5000)]
    recorder.start()
    for item in items:
        recorder.put(item)
    counters = recorder.stop()
    assert (counters.reads, counters.bytes, counters.bytes_on_disk) == (5000, 25000, 25000)
    reader = WireReader(tmp_path / "w.mcap")
    assert list(reader) == items
    assert reader.summary.complete


def test_a_failing_disk_is_reported_once_and_the_recording_goes_on_when_it_works_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problems: list[str | None] = []
    said = threading.Event()
    broken = threading.Event()
    write = os.write

    def failing(descriptor: int, data: bytes) -> int:
        if broken.is_set():
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    def note(problem: str | None) -> None:
        problems.append(problem)
        said.set()

    recorder = Recorder(WireWriter(tmp_path / "w.mcap", {}), note, lambda: None)
    monkeypatch.setattr("imumon.recordings.wire.os.write", failing)
    recorder.start()
    broken.set()
    recorder.put(Bytes(b"one", 1))
    assert said.wait(LIMIT_S)
    assert recorder.problem == "the recording cannot be written: No space left on device"
    recorder.put(Bytes(b"two", 2))
    time.sleep(0.3)
    said.clear()
    broken.clear()
    assert said.wait(LIMIT_S)
    counters = recorder.stop()
    assert problems == ["the recording cannot be written: No space left on device", None]
    assert counters.bytes_on_disk == 6
    assert list(WireReader(tmp_path / "w.mcap")) == [Bytes(b"one", 1), Bytes(b"two", 2)]


def test_metadata_is_saved_again_and_again_and_its_failure_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "SAVE_PERIOD_S", 0.05)
    monkeypatch.setattr(recorder_module, "SYNC_PERIOD_S", 0.02)
    saved = threading.Semaphore(0)
    failed = threading.Event()

    def save() -> None:
        saved.release()
        if failed.is_set():
            raise OSError(errno.EIO, "Input/output error")

    told = threading.Event()
    recorder = Recorder(
        WireWriter(tmp_path / "w.mcap", {}), lambda problem: told.set() if problem else None, save
    )
    recorder.start()
    assert all(saved.acquire(timeout=LIMIT_S) for _ in range(3))
    failed.set()
    assert told.wait(LIMIT_S)
    recorder.stop()


def test_whatever_goes_wrong_with_the_metadata_is_reported_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "SAVE_PERIOD_S", 0.05)
    monkeypatch.setattr(recorder_module, "SYNC_PERIOD_S", 0.05)
    problems, saved = list[str | None](), threading.Event()

    def save() -> None:
        if not problems:
            raise RuntimeError("dictionary changed size during iteration")
        saved.set()

    recorder = Recorder(WireWriter(tmp_path / "w.mcap", {}), problems.append, save)
    recorder.start()
    assert saved.wait(LIMIT_S)
    recorder.stop()
    what = "the session's metadata cannot be written: dictionary changed size during iteration"
    assert problems == [what, None]
