"""A wire file that was cut short or damaged, written anew; the original stays beside it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.folder import SessionMetadata, begun_of
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.transport.reader import Bytes, Event

FLUSH_BYTES = 1 << 20


def refuse_recording(path: Path) -> None:
    """Raise BUSY when a program writes this wire file at the moment."""
    with path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ImumonError(Reason.BUSY, f"{path} is being recorded", "stop the recording first") from error


def metadata_anew(path: Path, device_name: str | None) -> tuple[SessionMetadata, list[str]]:
    """Return the metadata of a session as its wire file holds them since its start; the state is open.

    Beside it stands what could not be known, one sentence each.

    Raises BAD_CONFIG when the file does not hold them and no device is named; BAD_DATA without any message.

    `device_name`: known name or path of a device file; it comes before the one that the wire file holds.
    """
    begun = begun_of(WireReader(path).metadata())
    unknown = [
        "what was written into session.yaml after the start is not known, as a serial number",
        "the digest of the live results is not known: a replay has nothing to be compared with",
    ]
    if begun is None:
        seen = f"{path} does not hold the session.yaml of its start: it is old, or its beginning is damaged"
        if device_name is None:
            raise bad_config(seen, "add --device NAME; imumon devices lists them")
        first = next(iter(WireReader(path)), None)
        if first is None:
            raise bad_data(f"{path} holds no message", "there is nothing to recover")
        at_ns = first.arrival_ns if isinstance(first, Bytes) else first.time_ns
        begun = SessionMetadata.begun("live", at_ns, device=device_name)
        unknown = [f"{seen}; only the device is known, and it began with its first message"]
    if device_name is not None:
        text, source = device_text(device_name)
        device = parse_device(text, source)
        begun = begun.model_copy(update={"device": device.name, "axes": device.axes, "device_yaml": text})
    return begun, unknown


def is_sound(summary: WireSummary) -> bool:
    """Return whether a wire file is whole and as it was written."""
    is_whole = summary.damage.places == summary.recovered.places
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
        folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
    finally:
        partial.unlink(missing_ok=True)
    return original


def keep_original(path: Path) -> Path:
    """Give a file a second name, NAME.original or with a number, and return it."""
    number, original = 1, path.with_name(f"{path.name}.original")
    while original.exists():
        number += 1
        original = path.with_name(f"{path.name}.original-{number}")
    original.hardlink_to(path)
    return original


def _items(path: Path, writer: WireWriter, bytes_missing: int, ended_ns: int) -> Iterator[Bytes | Event]:
    """Yield what can be read; say where messages are missing before those behind the place."""
    reader = WireReader(path)
    written = last_ns = 0
    for item in reader:
        time_ns = item.time_ns if isinstance(item, Event) else item.arrival_ns
        missing = reader.summary.damage.messages - written
        if missing:
            writer.missing(last_ns, time_ns, missing)
        written, last_ns = written + missing, time_ns
        yield item
    missing = reader.summary.damage.messages - written
    if missing or bytes_missing:
        writer.missing(last_ns, max(last_ns, ended_ns), missing, bytes_missing)
