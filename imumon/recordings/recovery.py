"""A wire file that was cut short or damaged, written anew; the original stays beside it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from imumon.errors import ImumonError, Reason
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.metadata import PortUsed, SessionMetadata, begun_of
from imumon.recordings.source import wire_device
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.transport.reader import Bytes, Event, Reads

ORIGINAL = "original"
FLUSH_BYTES = 1 << 20


def refuse_recording(path: Path) -> None:
    """Raise BUSY when a program writes this wire file at the moment."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ImumonError(Reason.BUSY, f"{path} is being recorded", "stop the recording first") from error


def metadata_anew(path: Path, device_name: str | None) -> tuple[SessionMetadata, list[str]]:
    """Return the metadata of a session from what its wire file says; the state is open.

    Beside it stands what could not be known, one sentence each.

    Raises BAD_CONFIG when nothing says what device it was; BAD_DATA when the file holds no message.

    Parameters
    ----------
    device_name : str or None
        Known name or path of a device file; it comes before the one that the wire file holds.
    """
    text = None if device_name is None else device_text(device_name)[0]
    written = WireReader(path).metadata()
    begun = begun_of(written)
    if begun is not None:
        unknown = [
            "what was written into session.yaml after the start is not known, as a serial number",
            "the digest of the live results is not known: a replay has nothing to be compared with",
        ]
        if text is not None:
            device = parse_device(text, str(device_name))
            begun = begun.model_copy(update={"device": device.name, "axes": device.axes, "device_yaml": text})
        return begun, unknown
    device = wire_device(WireReader(path)) if text is None else parse_device(text, str(device_name))
    first = next(iter(WireReader(path)), None)
    if first is None:
        raise ImumonError(Reason.BAD_DATA, f"{path} holds no message", "there is nothing to recover")
    port = written.get("port")
    metadata = SessionMetadata.begun(
        "simulation" if written.get("source") == "simulation" else "live",
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
    return metadata, unknown


def is_sound(summary: WireSummary) -> bool:
    """Return whether a wire file is whole and as it was written."""
    damage = summary.damage
    is_whole = damage.places == summary.recovered.places and not damage.events
    return summary.complete and summary.checksum_ok is not False and is_whole


def rewrite(path: Path, bytes_missing: int = 0, ended_ns: int = 0) -> Path:
    """Write a wire file anew with all that can be read of it, and return where the original is now.

    What is missing is noted in the new file at its place.  How many bytes of the device are missing in all,
    and when the recording ended, is noted at its end, where the session knows it.  Until the new file is on
    the medium under the name of the old one, the old one is there.

    Raises OSError when the disk is full or fails; the file is then as it was.
    """
    partial = path.with_name(f"{path.name}.partial")
    partial.unlink(missing_ok=True)
    try:
        with closing(WireWriter(partial, WireReader(path).metadata())) as writer:
            flushed = 0
            for item in _items(path, writer, bytes_missing, ended_ns):
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


def _items(path: Path, writer: WireWriter, bytes_missing: int, ended_ns: int) -> Iterator[Bytes | Event]:
    """Yield what can be read; say where messages are missing before those behind the place."""
    reader = WireReader(path)
    written = last_ns = 0
    for batch in reader.batches():
        first_ns, after_ns = _times(batch)
        missing = reader.damage.messages + reader.damage.events - written
        if missing:
            writer.missing(last_ns, first_ns, missing)
        written, last_ns = written + missing, after_ns
        if isinstance(batch, Event):
            yield batch
        else:
            yield from batch
    missing = reader.damage.messages + reader.damage.events - written
    if missing or bytes_missing:
        writer.missing(last_ns, max(last_ns, ended_ns), missing, bytes_missing)


def _times(batch: Reads | Event) -> tuple[int, int]:
    """Return when the first and the last of what belongs together came."""
    if isinstance(batch, Event):
        return batch.time_ns, batch.time_ns
    return int(batch.arrivals_ns[0]), int(batch.arrivals_ns[-1])


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
