"""Reads a wire file in order of arrival, whatever happened to it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from imumon.files import readable
from imumon.recordings.wire_format import FORMAT, MAGIC
from imumon.recordings.wire_kernels import HEAD
from imumon.recordings.wire_scan import Damage, Scan, WireSummary
from imumon.transport.reader import Event, Item, Reads

READ_SIZE = 1 << 20
PROFILE = FORMAT.rpartition("/")[0].encode()


def is_wire(path: Path) -> bool:
    """Tell whether a file is MCAP by its first bytes, or by the profile behind them where these are damaged.

    Raises BAD_DATA when it cannot be read.
    """
    return _head(path).startswith(MAGIC) or is_own(path)


def is_own(path: Path) -> bool:
    """Tell whether imumon recorded a file, by the profile at its begin.  Raises BAD_DATA as `is_wire`."""
    return PROFILE in _head(path)


def _head(path: Path) -> bytes:
    with readable(path), path.open("rb") as file:
        return file.read(HEAD)


class WireReader:
    """Reads a wire file in order of arrival, in constant memory.

    One that was cut short is read to its cut, and one that is damaged is read on behind each damaged place.

    Each iteration reads the file anew; `summary` is that of the last iteration that came to the end.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.summary = WireSummary()
        self.damage = Damage()
        """What was found so far by the iteration that goes on."""

    def __iter__(self) -> Iterator[Item]:
        """Yield the items in the order in which they were written, each read by itself.

        Raises ImumonError as `batches`.
        """
        for item in self.batches():
            if isinstance(item, Event):
                yield item
            else:
                yield from item

    def said(self) -> dict[str, str]:
        """Return what the recording program wanted to say, at the begin of the file; empty if damaged.

        Raises BAD_DATA when the file cannot be read, or is of another program.
        """
        scan = Scan(self.path)
        with readable(self.path), self.path.open("rb") as file:
            file.read(len(MAGIC))
            scan.begin(MAGIC)  # what is behind it does not depend on it
            for _ in scan.feed(file.read(READ_SIZE)):
                pass
        return scan.found.metadata

    def batches(self) -> Iterator[Reads | Event]:
        """Yield the items in the order in which they were written, reads that follow each other together.

        Raises BAD_DATA, when the file cannot be read or is not a wire file.
        """
        scan = Scan(self.path)
        self.damage = scan.found.damage
        with readable(self.path), self.path.open("rb") as file:
            scan.begin(file.read(len(MAGIC)))
            while not scan.done and (data := file.read(READ_SIZE)):
                yield from scan.feed(data)
            yield from scan.feed(b"", end=True)
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - len(MAGIC)))
            scan.finish(size, file.read())
            self.summary = scan.found
