"""What the summary of a session says of time and disk: outages, wall-clock times, sizes of files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from imumon.blocks import SampleBlock
from imumon.recordings.wire_reader import WireReader
from imumon.transport.reader import Bytes, Event, EventKind, Item, Reads

BEGINS = {EventKind.SILENT: "silent", EventKind.LOST: "lost"}
ENDS = {EventKind.OPENED, EventKind.RESUMED}
NAMED = 20
"""Outages that are named one by one."""


@dataclass(frozen=True, slots=True)
class Outage:
    """A time without bytes: from the last byte before it to the port's return, Unix time, ns.

    `ended_ns` is None while it lasts.
    """

    kind: str
    began_ns: int
    ended_ns: int | None = None

    def seconds(self, now_ns: int) -> float:
        """Return its length, up to now when it lasts."""
        return ((self.ended_ns or now_ns) - self.began_ns) * 1e-9


@dataclass(slots=True)
class Outages:
    """Finds the outages of a port in what comes from it."""

    found: list[Outage] = field(default_factory=list)
    last_ns: int = 0
    """Time of the last byte or event."""

    def received(self, time_ns: int) -> None:
        """Take the time of bytes."""
        self.last_ns = time_ns

    def event(self, event: Event) -> None:
        """Take an event of the port."""
        lasting = bool(self.found) and self.found[-1].ended_ns is None
        if event.kind in BEGINS and not lasting:
            self.found.append(Outage(BEGINS[event.kind], self.last_ns or event.time_ns))
        elif event.kind in BEGINS:  # it was silent before it was lost
            self.found[-1] = replace(self.found[-1], kind=BEGINS[event.kind])
        elif event.kind in ENDS and lasting:
            self.found[-1] = replace(self.found[-1], ended_ns=event.time_ns)
        self.last_ns = max(self.last_ns, event.time_ns)

    def watch(self, items: Iterable[Item] | Iterable[SampleBlock]) -> Iterator[Item | Reads | SampleBlock]:
        """Yield what was recorded, and look at it."""
        for item in items.batches() if isinstance(items, WireReader) else items:
            if isinstance(item, Event):
                self.event(item)
            elif isinstance(item, Bytes):
                self.received(item.arrival_ns)
            elif isinstance(item, Reads) and len(item.arrivals_ns):
                self.received(int(item.arrivals_ns[-1]))
            yield item

    def describe(self) -> str:
        """Return all outages with their lengths, in one phrase."""
        if not self.found:
            return "none"
        lengths = [outage.seconds(self.last_ns) for outage in self.found]
        named = [
            f"{wall_clock(outage.began_ns)} {outage.kind} {length:.1f} s"
            for outage, length in zip(self.found[:NAMED], lengths, strict=False)
        ]
        more = [f"{len(lengths) - NAMED} more"] if len(lengths) > NAMED else []
        return f"{len(lengths)}, {sum(lengths):.1f} s in all: {', '.join([*named, *more])}"

    def as_data(self) -> list[dict[str, object]]:
        """Return the outages as ``--json`` has them."""
        return [
            {
                "kind": outage.kind,
                "began_ns": outage.began_ns,
                "seconds": round(outage.seconds(self.last_ns), 3),
            }
            for outage in self.found
        ]


def wall_clock(time_ns: int, *, day: bool = False) -> str:
    """Return a Unix time as the clock on the wall shows it here, with the day if that is asked for."""
    at = datetime.fromtimestamp(time_ns * 1e-9).astimezone()
    return f"{at:%Y-%m-%d %H:%M:%S}" if day else f"{at:%H:%M:%S}"


def describe_span(began_ns: int, ended_ns: int) -> str:
    """Return when something began and ended, and how long it took."""
    length = f"{(ended_ns - began_ns) * 1e-9:.1f} s"
    return f"{wall_clock(began_ns, day=True)} to {wall_clock(ended_ns)}, {length}"


def file_sizes(folder: Path) -> dict[str, int]:
    """Return the bytes on disk of every file of a session, by its name."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.is_file()}


def describe_disk(folder: Path) -> str:
    """Return the size of every file of a session, and of all together."""
    sizes = file_sizes(folder)
    named = ", ".join(f"{name} {_size(size)}" for name, size in sizes.items())
    return f"{_size(sum(sizes.values()))}: {named}"


def _size(count: float) -> str:
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.3g} {unit}"
        count /= 1000.0
    return f"{count:.4g} GB"
