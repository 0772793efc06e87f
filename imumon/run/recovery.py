"""A session that was interrupted or damaged, made whole: its wire file and its counters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from imumon.errors import bad_config, bad_data
from imumon.recordings.folder import (
    METADATA_NAME,
    WIRE_NAME,
    Session,
    SessionMetadata,
    lost_metadata,
    open_session,
)
from imumon.recordings.recovery import is_sound, keep_original, metadata_anew, refuse_recording, rewrite
from imumon.recordings.source import Source, bytes_missing, run_over, source_of
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.run.live import summary_of
from imumon.run.narration import advised
from imumon.run.setup import recorded_setup
from imumon.run.stages import pipeline_of

VIEWS = "view*.rrd"
"""What the view's recorder wrote; of an interrupted run it ends where that ended."""


@dataclass(slots=True)
class Recovered:
    """What a recovery did."""

    session: Path
    before: WireSummary
    """What the wire file held before."""
    done: list[str] = field(default_factory=list)
    """What was written, one sentence each; empty when there was nothing to do."""
    originals: list[Path] = field(default_factory=list)
    """Where the files are that were replaced."""
    warnings: list[str] = field(default_factory=list)
    """What the recording lacks."""


def recover(path: Path, device_name: str | None = None) -> Recovered:
    """Make a session whole that was interrupted or damaged; one that is whole is left as it is.

    Raises BAD_DATA when this is no session with a wire file; BAD_CONFIG when session.yaml is lost and nothing
    says the device, or when a device is named of a session that knows its own; BUSY when it is being
    recorded; OSError when the disk is full or fails; each file is then as it was, or whole and new.

    `device_name` is a known name or the path of a device file, where session.yaml is lost and the wire file
    does not hold it.
    """
    lost = lost_metadata(path)
    if lost is not None:
        refuse_recording(lost)
        metadata, unknown = metadata_anew(lost, device_name)
        session = Session(lost.parent, metadata)
    else:
        unknown, session = [], open_session(path)
        if device_name is not None:
            raise bad_config(f"--device, and {path} knows its device", "leave it out")
    if session.metadata.source == "import":
        hint = "it follows from its table: imumon import makes it anew"
        raise bad_data(f"{path} is an imported session, which has no bytes", hint)
    refuse_recording(session.wire_path)
    source = source_of(session)
    assert isinstance(source.items, WireReader)
    for _ in source.items.batches():
        pass
    result = Recovered(session.path, source.items.summary)
    sound = is_sound(result.before) and not bytes_missing(session, result.before)
    if sound and lost is None and session.state == "closed":
        result.warnings = source.warnings()
        return result
    if not sound:
        missing, ended_ns = bytes_missing(session, result.before), session.metadata.ended_ns or 0
        result.originals.append(rewrite(session.wire_path, missing, ended_ns))
        result.done.append(f"{session.wire_path.name}: {result.before.reads:,} reads written anew, finished")
        source = source_of(session)
    metadata, warnings = _run_again(session, source)
    if lost is not None or metadata != session.metadata:
        if (session.path / METADATA_NAME).exists():
            result.originals.append(keep_original(session.path / METADATA_NAME))
        session.save(metadata)
        made = f", made anew from what {WIRE_NAME} says" if lost is not None else ""
        result.done.append(f"{METADATA_NAME}: closed, with the counters of what there is{made}")
    result.warnings = [*unknown, *source.warnings(), *warnings]
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
    return closed, [advised(text, session.path) for text in pipeline.warnings()]
