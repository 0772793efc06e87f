"""The account of a session: outages, wall-clock times, sizes of files, and doubts about the device file."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

import numpy as np

from imumon.blocks import SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.intake import GRAVITIES, RANGES
from imumon.pipeline import PipelineCounters
from imumon.recordings.wire_reader import WireReader
from imumon.transport.reader import Bytes, Event, EventKind, Item, Reads

BEGINS = {EventKind.SILENT: "silent", EventKind.LOST: "lost"}
ENDS = {EventKind.OPENED, EventKind.RESUMED}
NAMED = 20
"""Outages that are named one by one."""

LEAST_ROWS = 50
"""Fewer are no evidence about a device file: the unit may have been dropped."""
SKIPPED = 0.25
"""Share of the bytes in no packet.  A length that is wrong by a byte loses every second packet."""

LIMITS = {
    "gyro": (*RANGES["gyro_"], 0.1, "byte order, type and place of its fields"),
    "accel": (*RANGES["accel_"], 0.1, "byte order, type and place of its fields"),
    "specific force": (*GRAVITIES, "times gravity", 0.5, "byte order, scale and unit"),
}
"""Least and greatest reading, the unit, the share beyond that is too much (of floats with swapped bytes
nearly half are), and what in the device file contradicts them."""


@dataclass(slots=True)
class Outage:
    """A time without bytes: from the last byte before it to the port's return, Unix time, ns.

    `ended_ns` is None while it lasts.
    """

    kind: str
    began_ns: int
    ended_ns: int | None = None


@dataclass(slots=True)
class Outages:
    """Finds the outages of a port in what comes from it."""

    found: list[Outage] = field(default_factory=list)
    last_ns: int = 0
    """Time of the last byte or event."""

    def item(self, item: Item | Reads) -> None:
        """Take what came from the port."""
        if not isinstance(item, Event):
            arrivals_ns = [item.time_ns] if isinstance(item, Bytes) else item.arrivals_ns[-1:].tolist()
            self.last_ns = max(arrivals_ns, default=self.last_ns)
            return
        lasting = next((one for one in self.found if one.ended_ns is None), None)
        if item.kind in BEGINS:
            if lasting is None:
                lasting = Outage("", self.last_ns or item.time_ns)
                self.found.append(lasting)
            lasting.kind = BEGINS[item.kind]  # it may have been silent before it was lost
        elif item.kind in ENDS and lasting is not None:
            lasting.ended_ns = item.time_ns
        self.last_ns = max(self.last_ns, item.time_ns)

    def watch(self, items: Iterable[Item] | Iterable[SampleBlock]) -> Iterator[Item | Reads | SampleBlock]:
        """Yield what was recorded, and look at it."""
        for item in items.batches() if isinstance(items, WireReader) else items:
            if not isinstance(item, SampleBlock):
                self.item(item)
            yield item

    def seconds(self, outage: Outage) -> float:
        """Return the length of an outage, up to the last item when it lasts."""
        return ((outage.ended_ns or self.last_ns) - outage.began_ns) * 1e-9

    def describe(self) -> str:
        """Return all outages with their lengths, in one phrase."""
        if not self.found:
            return "none"
        lengths = [self.seconds(outage) for outage in self.found]
        named = [
            f"{wall_clock(outage.began_ns)} {outage.kind} {length:.1f} s"
            for outage, length in zip(self.found[:NAMED], lengths, strict=False)
        ]
        more = [f"{len(lengths) - NAMED} more"] if len(lengths) > NAMED else []
        return f"{len(lengths)}, {sum(lengths):.1f} s in all: {', '.join([*named, *more])}"

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
    length = f"{(ended_ns - began_ns) * 1e-9:.1f} s"
    return f"{wall_clock(began_ns, day=True)} to {wall_clock(ended_ns)}, {length}"


def file_sizes(folder: Path) -> dict[str, int]:
    """Return the bytes on disk of every file of a session, by its name."""
    return {path.name: path.stat().st_size for path in sorted(folder.iterdir()) if path.is_file()}


def describe_disk(folder: Path) -> str:
    """Return the size of every file of a session, and of all together."""
    from rich.filesize import decimal

    sizes = file_sizes(folder)
    named = ", ".join(f"{name} {decimal(size)}" for name, size in sizes.items())
    return f"{decimal(sum(sizes.values()))}: {named}"


class Doubts:
    """What contradicts the device file in a capture that was decoded with it: readings that no unit has.

    `described` is whether the device file states how long a packet is and where its checksum stands.
    """

    def __init__(self, described: bool) -> None:
        self._described = described
        self._counts = {name: np.zeros(2, np.int64) for name in LIMITS}
        """Readings beyond the limits, and all of them."""

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks as they are."""
        for block in blocks:
            readings = {"gyro": block.gyro, "accel": block.accel}
            if (force := block.accel) is not None:
                with np.errstate(over="ignore"):
                    readings["specific force"] = np.sqrt((force**2).sum(axis=1)) / STANDARD_GRAVITY
            for name, values in readings.items():
                if values is not None:
                    low, high = LIMITS[name][:2]
                    beyond = (values < low) | (values > high)
                    self._counts[name] += [beyond.sum(), (~np.isnan(values)).sum()]
            yield block

    def found(self, counters: PipelineCounters) -> list[str]:
        """Return the warnings, each with its likely cause; nothing where all fits the device file."""
        texts = []
        skipped, received = counters.bytes_skipped, counters.bytes_received
        if self._described and skipped > SKIPPED * received:
            cause = "length of the packet (a wrong one swallows the beginning of the next)"
            if counters.checksum_errors > counters.packets:
                cause = "checksum, with its place and byte order,"
            texts.append(
                f"{skipped / received:.0%} of the bytes are in no packet: is the {cause} right in the device"
                " file?  Else the line is damaged, or something else sends on it"
            )
        for name, (low, high, unit, share, cause) in LIMITS.items():
            beyond, count = self._counts[name]
            if count >= LEAST_ROWS and beyond > share * count:
                texts.append(
                    f"{beyond / count:.0%} of the {name} readings are not within {low:g} to {high:g} {unit},"
                    f" as they must be: are {cause} right in the device file?"
                )
        return texts
