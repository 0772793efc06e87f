"""A session that was interrupted or damaged, made whole: its wire file and its counters.

A file that is replaced stays beside the new one.
"""

import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.files import replacing
from imumon.protocols.device import device_text, parse_device
from imumon.recordings import folder
from imumon.recordings.folder import METADATA_NAME, Session, SessionMetadata
from imumon.recordings.source import Source, bytes_missing, run_over, source_of
from imumon.recordings.wire import WireWriter, is_recorded
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.transport.reader import Bytes, Event

from .live import summary_of
from .setup import recorded_setup
from .stages import pipeline_of

FLUSH_BYTES = 1 << 20
"""Bytes of the device after which a file that is written anew goes to the disk."""
VIEWS = "view*.rrd"
"""What the view's recorder wrote; of an interrupted run it ends where that ended."""


@dataclass
class Recovered:
    """What a recovery did."""

    session: Path
    before: WireSummary  # what the wire file held before
    # What was written, one sentence each; empty when there was nothing to do.
    done: list[str] = field(default_factory=list)
    originals: list[Path] = field(default_factory=list)  # where the files are that were replaced
    warnings: list[str] = field(default_factory=list)  # what the recording lacks


def recover(path: Path, device_name: str | None = None) -> Recovered:
    """Make a session whole that was interrupted or damaged; one that is whole is left as it is.

    Raises BAD_DATA when this is no session with a wire file; BAD_CONFIG when session.yaml is lost and nothing
    names the device, or when a device is named of a session that knows its own; BUSY when it is being
    recorded; OSError when the disk is full or fails; each file is then as it was, or whole and new.

    `device_name` is a known name or the path of a device file, where session.yaml is lost and the wire file
    does not hold it.
    """
    lost = folder.lost_metadata(path)
    if lost is not None:
        metadata, unknown = _metadata_anew(lost, device_name)
        session = Session(lost.parent, metadata)
    else:
        unknown, session = [], folder.open_session(path)
        if device_name is not None:
            raise bad_config(f"--device, and {path} knows its device", "leave it out")
    if session.metadata.source == "import":
        raise bad_data(
            f"{path} is an imported session, which has no bytes",
            "it follows from its table: imumon import makes it anew",
        )
    wire = session.wire_path
    if is_recorded(wire):
        raise ImumonError(Reason.BUSY, f"{wire} is being recorded", "stop the recording first")
    source = source_of(session)
    assert isinstance(source.items, WireReader)
    for _ in source.items.batches():
        pass
    before = source.items.summary
    missing, result = bytes_missing(session, before), Recovered(session.path, before)
    if missing or not before.is_sound:
        result.originals.append(rewrite(wire, missing, session.metadata.ended_ns or 0))
        result.done.append(f"{wire.name}: {before.reads:,} reads written anew, finished")
    elif lost is None and session.state == "closed":
        result.warnings = source.warnings()
        return result
    metadata, warnings = _run_again(session, source)
    if lost is not None or metadata != session.metadata:
        if (session.path / METADATA_NAME).exists():
            result.originals.append(_keep_original(session.path / METADATA_NAME))
        session.save(metadata)
        made = f", made anew from what {wire.name} holds" if lost is not None else ""
        result.done.append(f"{METADATA_NAME}: closed, with the counters of what there is{made}")
    result.warnings = [*unknown, *warnings]
    return result


def _run_again(session: Session, source: Source) -> tuple[SessionMetadata, list[str]]:
    """Run over the bytes as the live run did; return the metadata of a closed session, and the warnings."""
    pipeline = pipeline_of(source, recorded_setup(session))
    for _ in run_over(source.items, pipeline):
        pass
    assert isinstance(source.items, WireReader)
    summary = source.items.summary
    closed = session.metadata.closed(
        session.metadata.ended_ns or max(summary.last_ns, session.metadata.created_ns),
        **summary_of(pipeline.counters, summary.bytes_unrecorded),
        events=summary.events,
        views=sorted(path.name for path in session.path.glob(VIEWS)),
    )
    return closed, [*source.warnings(), *pipeline.warnings()]


def _metadata_anew(wire: Path, device_name: str | None) -> tuple[SessionMetadata, list[str]]:
    """Return the metadata of a session as its wire file holds them since its start, and what is not known.

    Raises BAD_CONFIG when the file does not hold them and no device is named, which comes before the one that
    the file holds; BAD_DATA without any message.
    """
    begun = folder.begun_of(WireReader(wire).metadata())
    unknown = [
        "what was written into session.yaml after the start is not known, as a serial number",
        "the digest of the live results is not known: a replay has nothing to be compared with",
    ]
    if begun is None:
        seen = f"{wire} does not hold the session.yaml of its start: it is old, or its beginning is damaged"
        if device_name is None:
            raise bad_config(seen, "add --device NAME; imumon devices lists them")
        first = next(iter(WireReader(wire)), None)
        if first is None:
            raise bad_data(f"{wire} holds no message", "there is nothing to recover")
        begun = SessionMetadata.begun("live", first.time_ns, device=device_name)
        unknown = [f"{seen}; only the device is known, and it began with its first message"]
    if device_name is not None:
        text, source = device_text(device_name)
        device = parse_device(text, source)
        begun = begun.model_copy(update={"device": device.name, "axes": device.axes, "device_yaml": text})
    return begun, unknown


def rewrite(path: Path, bytes_missing: int = 0, ended_ns: int = 0) -> Path:
    """Write a wire file anew with all that can be read of it, and return where the original is now.

    What is missing is noted in the new file at its place.  How many bytes of the device are missing in all,
    and when the recording ended, is noted at its end, where the session knows it.  The new file takes the
    name of the old one when it is on the medium.

    Raises OSError when the disk is full or fails; the file is then as it was.
    """
    with replacing(path) as partial:
        partial.unlink(missing_ok=True)
        with closing(WireWriter(partial, WireReader(path).metadata())) as writer:
            flushed = 0
            for item in _items(path, writer, bytes_missing, ended_ns):
                writer.write(item)
                flushed += len(item.data) if isinstance(item, Bytes) else 0
                if flushed > FLUSH_BYTES:
                    writer.flush()
                    flushed = 0
        return _keep_original(path)


def _keep_original(path: Path) -> Path:
    """Give a file a second name, NAME.original or with a number, and return it."""
    original = folder.unused(path.with_name(f"{path.name}.original"))
    try:
        original.hardlink_to(path)
    except OSError:  # as exFAT, this disk has no links
        with replacing(original) as partial:
            shutil.copy2(path, partial)
    return original


def _items(path: Path, writer: WireWriter, bytes_missing: int, ended_ns: int) -> Iterator[Bytes | Event]:
    """Yield what can be read; report where messages are missing before those behind the place."""
    reader = WireReader(path)
    written = last_ns = 0
    for item in reader:
        missing = reader.summary.damage.messages - written
        if missing:
            writer.missing(last_ns, item.time_ns, missing)
        written, last_ns = written + missing, item.time_ns
        yield item
    missing = reader.summary.damage.messages - written
    if missing or bytes_missing:
        writer.missing(last_ns, max(last_ns, ended_ns), missing, bytes_missing)
