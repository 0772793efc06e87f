"""What was recorded, run through a pipeline: a session, live or imported, a raw capture or a table.

`run_over` has the samples as they were sent, for tables.  A `Recording` is read as whoever computes from
samples needs them: what no estimate may be made from is left out, as it is for all stages.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import SampleBlock
from imumon.columns import BodyAxes, Column
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.files import readable
from imumon.pipeline import UNDATED, Estimator, Pipeline
from imumon.protocols.base import MAIN
from imumon.protocols.device import DeviceFile, load_device, parse_device
from imumon.protocols.ranges import Ranges, declared
from imumon.transport.reader import Bytes, EventKind, Item, Reads

from .folder import (
    METADATA_NAME,
    Session,
    begun_of,
    fingerprint,
    is_session,
    lost_metadata,
    open_session,
)
from .importing import TableImport
from .table import SUFFIXES, iterate_samples, iterate_table, read_columns
from .wire_reader import WireReader, WireSummary, is_wire

READ_SIZE = 1 << 16
RECORDING = "recording: "
"""What a warning begins with that names what a recording lacks."""
SHOWN_PLACES = 5
"""Damaged places that are reported one by one."""
BATCH_BYTES = 1 << 19
"""Samples are handed on about as often as so many bytes were fed: thousands at once, as each block costs."""


@dataclass(frozen=True)
class Source:
    """Something recorded, ready to be run over."""

    path: Path
    items: Iterable[Item] | Iterable[SampleBlock]  # what `run_over` takes
    device: DeviceFile | None = None  # what sent the bytes; None for a table
    session: Session | None = None  # None for a raw capture or a table
    imported: Mapping[str, Column] = field(default_factory=dict)  # of a table; empty for bytes
    table: TableImport | None = None  # the table from elsewhere that is read with its map, without a session
    axes: BodyAxes | None = None  # body axes of the samples; None where they are not stated

    def columns(self, pipeline: Pipeline, stream: str = MAIN) -> list[Column]:
        """Return the columns that the run's blocks have so far; `pipeline` is the one it runs through."""
        if stream != MAIN:
            return pipeline.stream_columns(stream)
        rest = [column for column in pipeline.columns if column.name not in self.imported]
        return [*self.imported.values(), *rest]

    @property
    def range(self) -> Ranges:
        """Of its sensors, as pipeline file or map declare it: it comes before that of the device file.

        Raises BAD_CONFIG when what the session keeps of them cannot be read.
        """
        if self.session is None:
            return Ranges() if self.table is None else self.table.map.range
        name, metadata = self.session.path / METADATA_NAME, self.session.metadata
        by_map = None if metadata.table is None else metadata.table.map_yaml
        by_pipeline = declared(metadata.pipeline_yaml, f"{name} (pipeline_yaml)")
        return by_pipeline.over(declared(by_map, f"{name} (map_yaml)"))

    @property
    def truth(self) -> Path:
        """The file that everything follows from."""
        return self.path if self.session is None else self.session.truth_path

    def refuse_output(self, out: Path | None) -> None:
        """Raise EXISTS when the output would replace what is read."""
        if out is not None and out.exists() and out.samefile(self.truth):
            raise ImumonError(Reason.EXISTS, f"{out} is what is read", "give another name for the table")

    def warnings(self) -> list[str]:
        """Return what is missing from the recording, as it is known after the run."""
        if not isinstance(self.items, WireReader):
            return [] if self.table is None else self.table.warnings()
        name, state, summary = self.truth.name, self.session and self.session.state, self.items.summary
        missing, damage = bytes_missing(self.session, summary), summary.damage
        sent = summary.bytes + summary.bytes_unrecorded + missing
        is_damaged = damage.places > summary.recovered.places
        verb = "is damaged" if is_damaged else "was damaged, before it was recovered,"
        places = f"{damage.places:,} place{'s' if damage.places > 1 else ''}"
        texts: dict[str, object] = {
            "the session was not closed: it is still being recorded, or was interrupted": (
                state == "interrupted"
            ),
            f"{missing:,} bytes are not in {name}, of the {sent:,} that had come from the device as"
            f" {METADATA_NAME} states": missing,
            f"the end of {name} is missing, though the session was closed": (
                state == "closed" and not missing and not summary.complete
            ),
            f"{summary.tail_bytes:,} bytes at the end of {name} are not a whole block": summary.tail_bytes,
            f"{summary.bytes_unrecorded:,} bytes could not be recorded at the time, or were lost since": (
                summary.bytes_unrecorded
            ),
            f"{name} {verb} in {places}, {damage.seconds:.3f} s in all: {damage.messages:,} reads or"
            f" events missing, {damage.bytes:,} bytes of no use": damage.places,
            **{f"damaged: {place}": True for place in damage.where[:SHOWN_PLACES]},
            f"{name} was changed after it was recorded: its checksum differs": summary.checksum_ok is False,
        }
        return [f"{RECORDING}{text}" for text, holds in texts.items() if holds]

    def losses(self) -> dict[str, Any]:
        """Return what is missing from the recording as ``--json`` has it, as it is known after the run."""
        if not isinstance(self.items, WireReader):
            return {}
        summary = self.items.summary
        whole, where = asdict(summary), []
        for place in summary.damage.where:
            at_s = None
            if self.session is not None and place.after_ns is not None:
                at_s = round((place.after_ns - self.session.metadata.created_ns) * 1e-9, 6)
            # Blocks that are not as they were written are left out.
            where.append({**asdict(place), "at_s": at_s, "seconds": place.seconds, "altered": False})
        lacking = {
            name: whole[name] for name in ("complete", "checksum_ok", "bytes_unrecorded", "tail_bytes")
        }
        lacking["bytes_missing"] = bytes_missing(self.session, summary)
        lacking["damage"] = {**whole["damage"], "events": 0, "bytes_altered": 0, "where": where}
        return {"recording": lacking}


def bytes_missing(session: Session | None, summary: WireSummary) -> int:
    """Return how many bytes less its wire file has than a closed session reports from the device."""
    if session is None or session.state != "closed":
        return 0
    received = session.metadata.counters.get("bytes_received", 0)
    return max(0, received - summary.bytes - summary.bytes_unrecorded)


def no_samples(source: Source, pipeline: Pipeline) -> ImumonError:
    """Return why a run over a source gave no rows."""
    counters = pipeline.counters
    if not counters.bytes_received:
        return bad_data(f"{source.path} is empty: there are no samples")
    others = ", ".join(f"{count} {name}" for name, count in counters.packets_by_type.items())
    device = source.device.name if source.device is not None else "table"
    return bad_data(
        f"no samples of {device} in the {counters.bytes_received:,} bytes of {source.path}: "
        f"{counters.checksum_errors} checksum errors, {counters.length_errors} length errors, "
        f"{others or 'no other'} messages",
        "is it another device, or text?  Give its --device; imumon devices lists those that are known",
    )


def open_source(path: Path, device_name: str | None = None, rate_hz: float | None = None) -> Source:
    """Open a session folder, a wire file without one, or a raw capture of the device named.

    Raises BAD_DATA when there is nothing to read; BAD_CONFIG for a capture without a device, or a rate for an
    imported session, whose samples have their times.

    `rate_hz`: packets per second, which dates those of a device that sends no time; default: the device
    file's.
    """
    device = None if device_name is None else load_device(device_name)
    if is_session(path):
        return source_of(open_session(path), device, rate_hz)
    if not path.is_file() and not path.is_fifo():
        open_session(path)  # raises, naming what is there
    wire = WireReader(path) if path.is_file() and is_wire(path) else None
    if device is None:
        if wire is None:
            raise bad_config(
                f"{path} is not a session, so its device must be named",
                "add --device NAME; imumon devices lists them",
            )
        metadata = wire.metadata()
        begun = begun_of(metadata)
        if begun is None or begun.device_yaml is None:
            raise bad_config(
                f"{path} does not hold its device file",
                f"add --device {metadata.get('device', 'NAME')}, or the path of its file",
            )
        device = parse_device(begun.device_yaml, f"{path} (device_yaml)")
    return Source(path, wire or capture_items(path), device.at_rate(rate_hz), axes=device.axes)


def source_of(session: Session, device: DeviceFile | None = None, rate_hz: float | None = None) -> Source:
    """Return what is read of a session; its device as recorded unless another is given.

    Raises BAD_DATA when it keeps no device file and none is given; BAD_CONFIG as `open_source`.
    """
    if session.metadata.source == "import":
        if rate_hz is not None:
            raise bad_config(
                f"--rate, and the samples of {session.path} have their times already",
                "rate_hz in the map of an import spaces rows without a time",
            )
        columns, axes = read_columns(session.truth_path), session.metadata.axes
        return Source(session.path, iterate_samples(session), None, session, columns, axes=axes)
    if device is None:
        if session.metadata.device_yaml is None:
            raise bad_data(f"{session.path}: session.yaml has no device_yaml")
        name = f"{session.path / METADATA_NAME} (device_yaml)"
        device = parse_device(session.metadata.device_yaml, name)
    wire = WireReader(session.wire_path)
    return Source(session.path, wire, device.at_rate(rate_hz), session, axes=device.axes)


def capture_items(path: Path) -> Iterator[Item]:
    """Yield the bytes of a raw capture, whose arrival times are not known.

    Raises BAD_DATA when the file cannot be read.
    """
    with (
        readable(path, "give a raw capture, or a session folder (which has a session.yaml)"),
        path.open("rb") as file,
    ):
        while data := file.read(READ_SIZE):
            yield Bytes(data, UNDATED)


Count = Callable[[int], object]
"""Takes how many more bytes of a recording were read, for a progress bar."""


def no_count(_: int) -> None:
    """Show no progress."""


def recorded_bytes(path: Path) -> int | None:
    """Return how many bytes `run_over` will count; None where that is not known before, as of a table."""
    if not is_session(path):
        return path.stat().st_size if path.is_file() and path.suffix not in SUFFIXES else None
    session = open_session(path)
    if session.metadata.source == "import":
        return None
    return session.metadata.counters.get("bytes_received") or session.wire_path.stat().st_size


def run_over(
    items: Iterable[Item | Reads | SampleBlock], pipeline: Pipeline, count: Count = no_count
) -> Iterator[SampleBlock]:
    """Run what was recorded through a new pipeline; yield the samples in order, to the last byte.

    `items`: from `WireReader`, `capture_items` or `iterate_samples`.
    `count`: called with the number of bytes read since the last call.
    """
    fed = 0
    for item in items.batches() if isinstance(items, WireReader) else items:
        fed += feed(item, pipeline)
        if fed >= BATCH_BYTES:
            count(fed)
            fed = 0
            yield pipeline.take()
    count(fed)
    pipeline.finish()
    yield pipeline.take()


def feed(item: Item | Reads | SampleBlock, pipeline: Pipeline) -> int:
    """Give a pipeline bytes, samples or an event; return how many bytes there were."""
    if isinstance(item, SampleBlock):
        pipeline.push(item)
        return sum(values.nbytes for values in item.columns.values())
    if isinstance(item, Bytes | Reads):
        reads = item if isinstance(item, Reads) else Reads.of([item])
        pipeline.feed_reads(reads.data, reads.ends, reads.arrivals_ns)
        return len(item.data)
    if item.kind is EventKind.OPENED:
        pipeline.port_opened()
    elif item.kind in (EventKind.SILENT, EventKind.LOST):
        pipeline.pause()
    return 0


Stages = Callable[[DeviceFile | None], Sequence[Estimator]]
"""Makes the stages for a device, or for a table when there is none."""


def no_stages(_: DeviceFile | None) -> Sequence[Estimator]:
    """Return no stages."""
    return ()


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording that is open; its samples can be read once."""

    source: Source  # what is read
    pipeline: Pipeline  # what it runs through
    count: Count  # takes how many more bytes were read
    name: str  # of its folder or file
    device: str | None  # what sent it; None for a table
    serial: str | None  # serial number of the unit, as its session has it

    def blocks(self) -> Iterator[SampleBlock]:
        """Yield the samples in order, with device_time_ns, segment and what the stages add to them.

        What cannot be is missing, and so are rows whose time does not go on: `warnings` counts them.
        """
        blocks = list[SampleBlock]()
        self.pipeline.sink = blocks.append
        for _ in run_over(self.source.items, self.pipeline, self.count):
            yield from blocks
            blocks.clear()

    def warnings(self) -> list[str]:
        """Return, once the samples were read, what the recording lacks and what the stages report."""
        return [*self.source.warnings(), *self.pipeline.warnings()]

    def sha256(self) -> str:
        """Return the fingerprint of its bytes."""
        return fingerprint(self.source.truth)


def open_recording(
    path: Path, stages: Stages = no_stages, map_path: Path | None = None, count: Count = no_count
) -> Recording:
    """Open a session, live or imported, or a table: one that imumon wrote, or any with its map.

    Raises BAD_DATA when there is nothing to read, or something that is no recording; BAD_CONFIG for a wrong
    map.

    `path`: folder of a session or its session.yaml, or a table.
    `stages`: what the samples run through; a stage of which a table has a column already is left out.
    `map_path`: states what is in which column of a table from elsewhere.
    `count`: takes how many more bytes were read, for a progress bar.
    """
    source = _open(path, map_path)
    made, there = stages(source.device), source.imported.keys()
    wanted = [stage for stage in made if there.isdisjoint(column.name for column in stage.columns)]
    return Recording(
        source,
        Pipeline(source.device, wanted, source.range),
        count,
        name=source.path.name or str(source.path),
        device=None if source.device is None else source.device.name,
        serial=None if source.session is None else source.session.metadata.serial,
    )


def _open(path: Path, map_path: Path | None) -> Source:
    if is_session(path) or not path.is_file():
        return open_source(path)
    if map_path is not None:
        table = TableImport(path, map_path)
        return Source(path, table.blocks(), imported=table.columns, table=table, axes=table.map.axes)
    if path.suffix not in SUFFIXES:
        if lost_metadata(path) is not None:
            open_session(path)  # raises, with what to do
        raise bad_data(
            f"{path} is neither a session nor a table ({', '.join(SUFFIXES)})",
            "a raw capture becomes a table first: imumon decode FILE --device NAME --out TABLE.parquet",
        )
    columns = read_columns(path)
    if "device_time_ns" not in columns:
        raise bad_data(
            f"{path}: has no column device_time_ns, so it is no table of imumon",
            "a table from elsewhere needs a map: imumon import",
        )
    # Without a column segment it is one segment.
    blocks = (
        block if "segment" in block else block.with_columns({"segment": np.zeros(len(block), np.int64)})
        for block in iterate_table(path)
    )
    return Source(path, blocks, imported=columns)
