"""Reads a wire file in order of arrival, whatever happened to it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from imumon.errors import ImumonError, Reason
from imumon.recordings.wire_format import MAGIC
from imumon.recordings.wire_scan import Damage, Scan
from imumon.transport.reader import Event, Item, Reads

READ_SIZE = 1 << 20


@dataclass(frozen=True, slots=True)
class WireSummary:
    """What a wire file held, known after it was read to its end."""

    reads: int = 0
    bytes: int = 0
    events: int = 0
    bytes_unrecorded: int = 0
    """Bytes that the recorder got and could not write, as the file says."""
    tail_bytes: int = 0
    """Bytes at the end of the file that are not a whole record, or are damaged: not of use."""
    complete: bool = False
    """The file was finished in order; False after a power failure, a kill or a full disk."""
    checksum_ok: bool | None = None
    """Whether the checksum over the file agrees; None when there is none because it was not finished."""
    last_ns: int = 0
    """Unix time of the last message."""
    damage: Damage = field(default_factory=Damage)
    """What is missing in the middle, or is not as it was written."""
    metadata: dict[str, str] = field(default_factory=dict)
    """What the recording program wanted to say."""


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

        Raises
        ------
        ImumonError
            As `batches`.
        """
        for item in self.batches():
            if isinstance(item, Event):
                yield item
            else:
                yield from item

    def batches(self) -> Iterator[Reads | Event]:
        """Yield the items in the order in which they were written, reads that follow each other together.

        Raises
        ------
        ImumonError
            BAD_DATA, when the file cannot be read or is not a wire file.
        """
        scan = Scan(self.path)
        self.damage = scan.found.damage
        try:
            with self.path.open("rb") as file:
                scan.begin(file.read(len(MAGIC)))
                while not scan.done and (data := file.read(READ_SIZE)):
                    yield from scan.feed(data)
                yield from scan.feed(b"", end=True)
                size = file.seek(0, os.SEEK_END)
                file.seek(max(0, size - len(MAGIC)))
                self.summary = _summary(scan, size, file.read())
        except OSError as error:
            raise ImumonError(Reason.BAD_DATA, f"{self.path}: cannot be read: {error.strerror}") from error


def _summary(scan: Scan, size: int, last: bytes) -> WireSummary:
    tail, found = scan.finish(size), scan.found
    return WireSummary(
        found.reads,
        found.bytes,
        found.events,
        found.unrecorded,
        tail_bytes=tail,
        complete=found.data_ended and last == MAGIC,
        checksum_ok=found.checksum_ok,
        last_ns=scan.last_ns,
        damage=found.damage,
        metadata=found.metadata,
    )
