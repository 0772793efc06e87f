"""A disk that is full, read-only or gone while a live run records to it."""

from __future__ import annotations

import errno
import os
import shutil
import stat
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from imumon.recordings.source import open_source
from imumon.recordings.wire_reader import WireReader
from imumon.run.live import warm_up
from imumon.run.setup import Setup
from imumon.transport.reader import Bytes
from tests.faults.line import DEVICE, Line, Watched
from tests.faults.rows import Row
from tests.waiting import LIMIT_S, wait_until

HARM_S = 1.0
PENDING = 4096
"""Bytes kept for a disk that takes none, in place of 8 MiB, so that some are given up within `HARM_S`."""
SHOWN = 30
"""Samples that the view gets meanwhile."""
TMPFS = "size=2m"


@contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Put a file system of 2 MB at a folder, if this user may; tell whether it is there."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", TMPFS, "tmpfs", str(folder)]
    mounted = shutil.which("mount") is not None and (
        subprocess.run(mount, capture_output=True, check=False).returncode == 0
    )
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextmanager
def full(folder: Path) -> Iterator[None]:
    """Fill the file system."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(4096)) == 4096:
            pass
    yield
    ballast.unlink()


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Let writes fail as on a disk that was set read-only for its errors: no user can do that here."""
    del folder
    with failing(errno.EROFS):
        yield


@contextmanager
def vanished(folder: Path) -> Iterator[None]:
    """Remove the session's folder."""
    shutil.rmtree(folder / "session")
    yield


@contextmanager
def failing(number: int) -> Iterator[None]:
    """Let every write of the recording fail; a port is no file."""
    really = os.write

    def write(descriptor: int, data: bytes) -> int:
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(number, os.strerror(number))
        return really(descriptor, data)

    with patch("imumon.recordings.wire.os.write", write):
        yield


@dataclass(frozen=True, slots=True)
class DiskFault:
    """What happens to the disk, and what must be said of it."""

    harm: Callable[[Path], object]
    said: str


FAULTS = {
    "disk full": DiskFault(full, os.strerror(errno.ENOSPC)),
    "disk read-only": DiskFault(read_only, os.strerror(errno.EROFS)),
    "folder of the session vanished": DiskFault(vanished, "has vanished"),
}


def strike(folder: Path, name: str, seed: int) -> list[str]:
    """Let a disk fail for a while; return what was not as promised."""
    warm_up(DEVICE, Setup())
    fault, wrong = FAULTS[name], []
    with small_disk(folder) as mounted, patch("imumon.recordings.wire.PENDING_LIMIT", PENDING):
        harm = failing(errno.ENOSPC) if fault.harm is full and not mounted else fault.harm(folder)
        line = Line(folder.with_name(f"{folder.name}-ahrs"), seed)
        try:
            watched = Watched(line, folder / "session")
            line.send(0.4)
            with harm:  # type: ignore[attr-defined]  # a context manager
                before, end = len(watched.rows()), time.monotonic() + LIMIT_S
                line.send(HARM_S)
                while (shown := len(watched.rows()) - before) < SHOWN and time.monotonic() < end:
                    line.send(0.1)
            line.send(0.8)
            wait_until(lambda: "recording goes on" in watched.said)
            line.settle()
            summary = watched.run.stop()
        finally:
            line.close()
        if shown < SHOWN:
            wrong.append(f"the view got {shown} samples meanwhile")
        if not any(fault.said in text for text in watched.said) or "recording goes on" not in watched.said:
            wrong.append(f"said: {watched.said}")
        reader = WireReader(folder / "session" / "wire.mcap")
        kept = sum(len(item.data) for item in reader if isinstance(item, Bytes))
        if kept + reader.summary.bytes_unrecorded != summary.wire.bytes or not reader.summary.complete:
            wrong.append(f"{kept} kept, {reader.summary.bytes_unrecorded} missing of {summary.wire.bytes}")
        if not 0 < reader.summary.bytes_unrecorded == summary.wire.bytes_unrecorded:
            wrong.append(f"{summary.wire.bytes_unrecorded} bytes were given up")
        source = open_source(folder / "session")
        assert isinstance(source.items, WireReader)
        list(source.items)
        if not any("could not be recorded" in text for text in source.warnings()):
            wrong.append("a replay does not say so")
    return wrong


def attack_all(folder: Path, times: int) -> Iterator[Row]:
    """Let each fault happen so many times."""
    for name in FAULTS:
        wrong = [text for n in range(times) for text in strike(folder / f"{name} {n}", name, n)]
        said = (
            "reported; the view went on; the recording goes on afterwards; a replay reports what is missing"
        )
        yield Row(f"{name} for {HARM_S:g} s", times, "; ".join(wrong) or said, held=not wrong)
