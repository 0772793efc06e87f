"""What was recorded, run through a pipeline: a session, live or imported, a raw capture or a table.

`run_over` has the samples as they were sent, for tables.  A `Recording` is read as whoever computes from
samples needs them: what no estimate may be made from is left out, as it is for all stages.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import SampleBlock
from imumon.columns import BodyAxes, Column
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.files import readable
from imumon.pipeline import UNDATED, Estimator, Pipeline
from imumon.protocols.device import DeviceFile, load_device, parse_device
from imumon.protocols.ranges import Ranges, declared
from imumon.recordings.folder import (
    METADATA_NAME,
    Session,
    begun_of,
    fingerprint,
    is_session,
    lost_metadata,
    open_session,
)
from imumon.recordings.importing import TableImport
from imumon.recordings.table import SUFFIXES, iterate_samples, iterate_table, read_columns
from imumon.recordings.wire_reader import WireReader, WireSummary, is_wire
from imumon.transport.reader import Bytes, EventKind, Item, Reads

READ_SIZE = 1 << 16
RECORDING = "recording: "
"""What a warning begins with that names what a recording lacks."""
SHOWN_PLACES = 5
"""Damaged places that are reported one by one."""
BATCH_BYTES = 1 << 19
"""Samples are handed on about as often as so many bytes were fed: thousands at once, as each block costs."""


@dataclass(frozen=True, slots=True)
class Source:
    """Something recorded, ready to be run over."""

    path: Path
    items: Iterable[Item] | Iterable[SampleBlock]
    """What `run_over` takes."""
    device: DeviceFile | None
    """What sent the bytes; None for an imported session."""
    session: Session | None
    """None for a raw capture."""
    imported: tuple[Column, ...] = ()
    """Columns of an imported session's table."""
    table: TableImport | None = None
    """The table from elsewhere that is read with its map, without a session."""

    def columns(self, pipeline: Pipeline) -> list[Column]:
        """Return the columns that the run's blocks have so far; `pipeline` is the one it runs through."""
        own = {column.name for column in self.imported}
        return [*self.imported, *(column for column in pipeline.columns if column.name not in own)]

    @property
    def axes(self) -> BodyAxes | None:
        """Body axes of the samples; None where they are not stated."""
        if self.device is not None:
            return self.device.axes
        if self.session is not None:
            return self.session.metadata.axes
        return None if self.table is None else self.table.map.axes

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

    def refuse_output(self, out: Path | None) -> None:
        """Raise EXISTS when the output would replace what is read."""
        read = [self.path] if self.session is None else [self.session.wire_path, self.session.samples_path]
        if out is not None and out.exists() and any(path.exists() and out.samefile(path) for path in read):
            raise ImumonError(Reason.EXISTS, f"{out} is what is read", "give another name for the table")

    def warnings(self) -> list[str]:
        """Return what is missing from the recording, as it is known after the run."""
        if isinstance(self.items, WireReader):
            return self.lacks(self.items.summary)
        return [] if self.table is None else self.table.warnings()

    def lacks(self, summary: WireSummary) -> list[str]:
        """Return what a wire file and its session lack, one sentence each, by what was found in the file."""
        name = self.path.name if self.session is None else self.session.wire_path.name
        state = None if self.session is None else self.session.state
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
        began_ns = None if self.session is None else self.session.metadata.created_ns
        where = []
        for place in summary.damage.where:
            at_s = None
            if began_ns is not None and place.after_ns is not None:
                at_s = round((place.after_ns - began_ns) * 1e-9, 6)
            # Blocks that are not as they were written are left out.
            where.append({**asdict(place), "at_s": at_s, "seconds": place.seconds, "altered": False})
        whole = asdict(summary)
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
        return replace(source_of(open_session(path), device, rate_hz), path=path)
    if not path.is_file() and not path.is_fifo():
        open_session(path)  # raises, naming what is there
    wire = WireReader(path) if path.is_file() and is_wire(path) else None
    if device is None:
        if wire is None:
            hint = "add --device NAME; imumon devices lists them"
            raise bad_config(f"{path} is not a session, so its device must be named", hint)
        metadata = wire.metadata()
        begun = begun_of(metadata)
        if begun is None or begun.device_yaml is None:
            hint = f"add --device {metadata.get('device', 'NAME')}, or the path of its file"
            raise bad_config(f"{path} does not hold its device file", hint)
        device = parse_device(begun.device_yaml, f"{path} (device_yaml)")
    return Source(path, wire or capture_items(path), device.at_rate(rate_hz), None)


def source_of(session: Session, device: DeviceFile | None = None, rate_hz: float | None = None) -> Source:
    """Return what is read of a session; its device as recorded unless another is given.

    Raises BAD_DATA when it keeps no device file and none is given; BAD_CONFIG as `open_source`.
    """
    if session.metadata.source == "import":
        if rate_hz is not None:
            what = f"--rate, and the samples of {session.path} have their times already"
            raise bad_config(what, "rate_hz in the map of an import spaces rows without a time")
        columns = tuple(read_columns(session.samples_path).values())
        return Source(session.path, iterate_samples(session), None, session, columns)
    if device is None:
        text = session.metadata.device_yaml
        if text is None:
            raise bad_data(f"{session.path}: session.yaml has no device_yaml")
        device = parse_device(text, f"{session.path / METADATA_NAME} (device_yaml)")
    return Source(session.path, WireReader(session.wire_path), device.at_rate(rate_hz), session)


def capture_items(path: Path) -> Iterator[Item]:
    """Yield the bytes of a raw capture, whose arrival times are not known.

    Raises BAD_DATA when the file cannot be read.
    """
    hint = "give a raw capture, or a session folder (which has a session.yaml)"
    with readable(path, hint), path.open("rb") as file:
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


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording that is open; its samples can be read once."""

    source: Source
    """What is read."""
    pipeline: Pipeline
    """What it runs through."""
    count: Count
    """Takes how many more bytes were read."""
    truth: Path
    """The file that everything follows from."""
    name: str
    """Of its folder or file."""
    device: str | None
    """What sent it; None for a table."""
    axes: BodyAxes | None
    """In which body axes it is; None where it is not stated."""
    serial: str | None
    """Serial number of the unit, as its session has it."""
    columns: dict[str, Column]
    """Columns of a table or an imported session; empty for a recording that has to be decoded."""

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
        return fingerprint(self.truth)


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
    session, there = source.session, {column.name: column for column in source.imported}
    made = stages(source.device)
    wanted = [stage for stage in made if there.keys().isdisjoint(column.name for column in stage.columns)]
    return Recording(
        source, Pipeline(source.device, wanted, source.range), count,
        truth=source.path if session is None else session.truth_path,
        name=(path if session is None else session.path).name or str(path),
        device=None if source.device is None else source.device.name,
        axes=source.axes,
        serial=None if session is None else session.metadata.serial,
        columns=there,
    )  # fmt: skip


def _open(path: Path, map_path: Path | None) -> Source:
    if is_session(path) or not path.is_file():
        return open_source(path)
    if map_path is not None:
        table = TableImport(path, map_path)
        return Source(path, table.blocks(), None, None, tuple(table.columns.values()), table)
    if path.suffix not in SUFFIXES:
        if lost_metadata(path) is not None:
            open_session(path)  # raises, with what to do
        what = f"{path} is neither a session nor a table ({', '.join(SUFFIXES)})"
        hint = "a raw capture becomes a table first: imumon decode FILE --device NAME --out TABLE.parquet"
        raise bad_data(what, hint)
    columns = read_columns(path)
    if "device_time_ns" not in columns:
        seen = f"{path}: has no column device_time_ns, so it is no table of imumon"
        raise bad_data(seen, "a table from elsewhere needs a map: imumon import")
    # Without a column segment it is one segment.
    blocks = (
        block if "segment" in block else block.with_columns({"segment": np.zeros(len(block), np.int64)})
        for block in iterate_table(path)
    )
    return Source(path, blocks, None, None, tuple(columns.values()))
