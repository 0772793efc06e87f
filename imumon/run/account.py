"""The account of a session: outages, wall-clock times, sizes of files, and doubts about the device file."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from imumon.blocks import SampleBlock
from imumon.intake import SpecificForce
from imumon.pipeline import PipelineCounters
from imumon.recordings.wire_reader import WireReader
from imumon.transport.reader import Event, EventKind, Item, Reads

from .marks import KINDS

BEGINS = {EventKind.SILENT: "silent", EventKind.LOST: "lost"}
ENDS = {EventKind.OPENED, EventKind.RESUMED}
SKIPPED = 0.25
"""Share of the bytes in no packet.  A length that is wrong by a byte loses every second packet."""
NAMED = 20
"""Outages that are named one by one."""


@dataclass
class Outage:
    """A time without bytes: from the last byte before it to the port's return, Unix time, ns.

    `ended_ns` is None while it lasts.
    """

    kind: str
    began_ns: int
    ended_ns: int | None = None


@dataclass
class Outages:
    """Finds the outages of a port in what comes from it."""

    found: list[Outage] = field(default_factory=list)
    last_ns: int = 0  # time of the last byte, or event other than a mark

    def item(self, item: Reads | Event) -> None:
        """Take what came from the port."""
        if isinstance(item, Reads):
            self.last_ns = int(item.arrivals_ns[-1])
            return
        lasting = next((one for one in self.found if one.ended_ns is None), None)
        if item.kind in BEGINS:
            if lasting is None:
                lasting = Outage("", self.last_ns or item.time_ns)
                self.found.append(lasting)
            lasting.kind = BEGINS[item.kind]  # it may have been silent before it was lost
        elif item.kind in ENDS and lasting is not None:
            lasting.ended_ns = item.time_ns
        if item.kind not in KINDS.values():
            self.last_ns = max(self.last_ns, item.time_ns)

    def watch(self, items: Iterable[Item] | Iterable[SampleBlock]) -> Iterator[Item | Reads | SampleBlock]:
        """Yield what was recorded, and look at it."""
        for item in items.batches() if isinstance(items, WireReader) else items:
            if isinstance(item, Reads | Event):
                self.item(item)
            yield item

    def seconds(self, outage: Outage) -> float:
        """Return the length of an outage, up to the last item when it lasts."""
        return ((outage.ended_ns or self.last_ns) - outage.began_ns) * 1e-9

    def describe(self) -> str:
        """Return all outages with their lengths, in one phrase."""
        if not self.found:
            return "none"
        first, more = self.found[:NAMED], len(self.found) - NAMED
        named = [f"{wall_clock(one.began_ns)} {one.kind} {self.seconds(one):.1f} s" for one in first]
        named += [f"{more} more"] if more > 0 else []
        return f"{len(self.found)}, {sum(map(self.seconds, self.found)):.1f} s in all: {', '.join(named)}"

    def as_data(self) -> list[dict[str, object]]:
        """Return the outages as ``--json`` has them."""
        return [
            {"kind": one.kind, "began_ns": one.began_ns, "seconds": round(self.seconds(one), 3)}
            for one in self.found
        ]


def wall_clock(time_ns: int, *, day: bool = False) -> str:
    """Return a Unix time as the clock on the wall shows it here, with the day if requested."""
    at = datetime.fromtimestamp(time_ns * 1e-9).astimezone()
    return f"{at:%Y-%m-%d %H:%M:%S}" if day else f"{at:%H:%M:%S}"


def describe_span(began_ns: int, ended_ns: int) -> str:
    """Return when something began and ended, and how long it took."""
    length_s = (ended_ns - began_ns) * 1e-9
    return f"{wall_clock(began_ns, day=True)} to {wall_clock(ended_ns)}, {length_s:.1f} s"


def file_sizes(folder: Path) -> dict[str, int]:
    """Return the bytes on disk of every file of a session, by its name."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.is_file()}


def describe_disk(folder: Path) -> str:
    """Return the size of every file of a session, and of all together."""
    from rich.filesize import decimal

    sizes = file_sizes(folder)
    named = ", ".join(f"{name} {decimal(size)}" for name, size in sizes.items())
    return f"{decimal(sum(sizes.values()))}: {named}"


def doubts(described: bool, counters: PipelineCounters, force: SpecificForce) -> list[str]:
    """Return what contradicts the device file in a capture, each with its likely cause.

    `described` is whether the device file states how long a packet is and where its checksum stands.
    """
    skipped, received = counters.bytes_skipped, counters.bytes_received
    texts = [force.doubt()]
    if described and skipped > SKIPPED * received:
        texts.insert(
            0,
            f"{skipped / received:.0%} of the bytes are in no packet: are length and checksum of it right"
            " in the device file?  Else the line is damaged, or something else sends on it",
        )
    return [*filter(None, texts)]
