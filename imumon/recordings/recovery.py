"""A wire file that was cut short or damaged, written anew; the original stays beside it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from imumon.errors import ImumonError, Reason
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.metadata import PortUsed, SessionMetadata, begun_of
from imumon.recordings.source import wire_device
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import WireReader
from imumon.recordings.wire_scan import WireSummary
from imumon.transport.reader import Bytes, Event

ORIGINAL = "original"
FLUSH_BYTES = 1 << 20


def refuse_recording(path: Path) -> None:
    """Raise BUSY when a program writes this wire file at the moment."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ImumonError(Reason.BUSY, f"{path} is being recorded", "stop the recording first") from error


def read_summary(path: Path) -> WireSummary:
    """Read a wire file to its end, and return what it holds."""
    reader = WireReader(path)
    for _ in reader.batches():
        pass
    return reader.summary


@dataclass(frozen=True, slots=True)
class Anew:
    """What a session.yaml is when it was made anew from the wire file."""

    metadata: SessionMetadata
    unknown: list[str]
    """What could not be known, one sentence each."""


def metadata_anew(path: Path, device_name: str | None) -> Anew:
    """Return the metadata of a session from what its wire file says; the state is open.

    Raises BAD_CONFIG when nothing says what device it was; BAD_DATA when the file holds no message.

    Parameters
    ----------
    device_name : str or None
        Known name or path of a device file; it comes before the one that the wire file holds.
    """
    text = None if device_name is None else device_text(device_name)[0]
    said = WireReader(path).said()
    begun = begun_of(said)
    if begun is not None:
        unknown = [
            "what was written into session.yaml after the start is not known, as a serial number",
            "the digest of the live results is not known: a replay has nothing to be compared with",
        ]
        if text is not None:
            device = parse_device(text, str(device_name))
            begun = begun.model_copy(update={"device": device.name, "axes": device.axes, "device_yaml": text})
        return Anew(begun, unknown)
    device = wire_device(WireReader(path)) if text is None else parse_device(text, str(device_name))
    first = next(iter(WireReader(path)), None)
    if first is None:
        raise ImumonError(Reason.BAD_DATA, f"{path} holds no message", "there is nothing to recover")
    source: Literal["live", "simulation"] = "live"
    if said.get("source") == "simulation":
        source = "simulation"
    port = said.get("port")
    metadata = SessionMetadata.begun(
        source,
        first.arrival_ns if isinstance(first, Bytes) else first.time_ns,
        device=device.name,
        axes=device.axes,
        device_yaml=text,
        port=None if port is None else PortUsed(url=port, settings={}),
    )
    unknown = [
        f"{path.name} does not hold the session.yaml of its start: the device file is the one named",
        "not known are place, bias model and parameters (pipeline_yaml), the serial number, the versions "
        "that recorded it and the digest of the live results; it began with its first message",
    ]
    return Anew(metadata, unknown)


def is_sound(summary: WireSummary) -> bool:
    """Tell whether a wire file is whole and as it was written."""
    damage = summary.damage
    return summary.complete and summary.checksum_ok is not False and not (damage.places or damage.events)


def rewrite(path: Path) -> Path:
    """Write a wire file anew with all that can be read of it, and return where the original is now.

    What is missing is said in the new file at its place.  Until the new file is on the medium under the name
    of the old one, the old one is there.

    Raises OSError when the disk is full or fails; the file is then as it was.
    """
    partial = path.with_name(f"{path.name}.partial")
    partial.unlink(missing_ok=True)
    try:
        with closing(WireWriter(partial, WireReader(path).said())) as writer:
            flushed = 0
            for item in _items(path, writer):
                writer.write(item)
                flushed += len(item.data) if isinstance(item, Bytes) else 0
                if flushed > FLUSH_BYTES:
                    writer.flush()
                    flushed = 0
        original = keep_original(path)
        partial.replace(path)
        _sync_folder(path.parent)
    finally:
        partial.unlink(missing_ok=True)
    return original


def keep_original(path: Path) -> Path:
    """Give a file a second name, NAME.original or with a number, and return it."""
    number = 1
    while True:
        original = path.with_name(f"{path.name}.{ORIGINAL}{'' if number == 1 else f'-{number}'}")
        try:
            original.hardlink_to(path)
        except FileExistsError:
            number += 1
        else:
            return original


def _items(path: Path, writer: WireWriter) -> Iterator[Bytes | Event]:
    """Yield what can be read; say where messages are missing before those behind the place."""
    reader = WireReader(path)
    said_messages = said_bytes = 0
    for batch in reader.batches():
        damage = reader.damage
        if damage.messages + damage.events > said_messages:
            time_ns = batch.time_ns if isinstance(batch, Event) else int(batch.arrivals_ns[0])
            missing = damage.messages + damage.events - said_messages
            writer.missing(time_ns, missing, damage.bytes - said_bytes)
        said_messages, said_bytes = damage.messages + damage.events, damage.bytes
        if isinstance(batch, Event):
            yield batch
        else:
            yield from batch


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
