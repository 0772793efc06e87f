"""A session that was interrupted or damaged, made whole: its wire file, its counters, its view."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from imumon.errors import ImumonError, Reason
from imumon.recordings.folder import (
    METADATA_NAME,
    WIRE_NAME,
    Session,
    lost_metadata,
    open_session,
)
from imumon.recordings.metadata import SessionMetadata
from imumon.recordings.recovery import (
    is_sound,
    keep_original,
    metadata_anew,
    refuse_recording,
    rewrite,
)
from imumon.recordings.source import Source, bytes_missing, source_of
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.run.live import flat_counters, stream_summaries
from imumon.run.narration import Narrator, view_setup
from imumon.run.replay import replay
from imumon.run.setup import recorded_setup
from imumon.run.stages import pipeline_of
from imumon.view.recorder import ViewRecorder

WINDOW_S = 15.0
WAIT_S = 0.05
CLOSE_S = 600.0
"""How long the last items of the view may take."""


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

    Parameters
    ----------
    device_name : str, optional
        Known name or path of a device file, where session.yaml is lost and the wire file does not hold it.
    """
    lost = lost_metadata(path)
    if lost is not None:
        refuse_recording(lost)
        metadata, unknown = metadata_anew(lost, device_name)
        session = Session(lost.parent, metadata)
    else:
        unknown, session = [], open_session(path)
        if device_name is not None:
            raise ImumonError(Reason.BAD_CONFIG, f"--device, and {path} knows its device", "leave it out")
    if session.metadata.source == "import":
        hint = "it follows from its table: imumon import makes it anew"
        raise ImumonError(Reason.BAD_DATA, f"{path} is an imported session, which has no bytes", hint)
    refuse_recording(session.wire_path)
    source = source_of(session)
    result = Recovered(session.path, summary_of(source))
    sound = is_sound(result.before) and not bytes_missing(session, result.before)
    if (
        sound
        and lost is None
        and session.state == "closed"
        and all((session.path / n).exists() for n in session.metadata.views)
    ):
        result.warnings = source.warnings()
        return result
    if not sound:
        missing, ended_ns = bytes_missing(session, result.before), session.metadata.ended_ns or 0
        result.originals.append(rewrite(session.wire_path, missing, ended_ns))
        result.done.append(f"{session.wire_path.name}: {result.before.reads:,} reads written anew, finished")
        source = source_of(session)
    metadata, warnings = _run_again(session, source, result)
    if lost is not None or metadata != session.metadata:
        if (session.path / METADATA_NAME).exists():
            result.originals.append(keep_original(session.path / METADATA_NAME))
        session.save(metadata)
        made = f", made anew from what {WIRE_NAME} says" if lost is not None else ""
        result.done.append(f"{METADATA_NAME}: closed, with the counters of what there is{made}")
    result.warnings = [*unknown, *source.warnings(), *warnings]
    return result


def summary_of(source: Source) -> WireSummary:
    """Read a wire file to its end, and return what it holds."""
    assert isinstance(source.items, WireReader)
    for _ in source.items.batches():
        pass
    return source.items.summary


def _run_again(session: Session, source: Source, result: Recovered) -> tuple[SessionMetadata, list[str]]:
    """Run over the bytes as the live run did; write the view, and return the metadata of a closed session."""
    setup = recorded_setup(session)
    pipeline = pipeline_of(source, setup)
    partial = session.path / "recovering.rrd"
    for left in session.path.glob("recovering*.rrd"):
        left.unlink()
    recorder = ViewRecorder(partial, view_setup(session, pipeline.units, WINDOW_S))
    card = {"session": str(session.path), "recording": "recovered"}
    warnings: list[str] = []

    def say(level: str, text: str) -> None:
        if level == "WARN":
            warnings.append(text)

    narrator = Narrator(pipeline, None, [recorder.publish], say, card, session.path)
    for _ in replay(source.items, pipeline, narrator):
        while not recorder.has_room:
            time.sleep(WAIT_S)
    recorder.close(CLOSE_S)
    if recorder.error or recorder.dropped:
        raise ImumonError(
            Reason.BAD_DATA, recorder.error or "the view cannot be written", "is the disk full?"
        )
    views = _put_in_place(session, recorder.files, result)
    assert isinstance(source.items, WireReader)
    summary = source.items.summary
    ended_ns = session.metadata.ended_ns or max(summary.last_ns, session.metadata.created_ns)
    counters = flat_counters(pipeline.counters) | {"bytes_unrecorded": summary.bytes_unrecorded}
    closed = session.metadata.closed(
        ended_ns,
        counters=counters,
        events=summary.events,
        streams=stream_summaries(pipeline.counters),
        views=views,
    )
    return closed, warnings


def _put_in_place(session: Session, files: list[Path], result: Recovered) -> list[str]:
    """Let the new segments of the view take the names of the old ones, which are kept."""
    stem, suffix = session.view_path.stem, session.view_path.suffix
    for old in sorted(session.path.glob(f"{stem}*{suffix}")):
        result.originals.append(keep_original(old))
        old.unlink()
    names = []
    for new in files:
        name = new.name.replace("recovering", stem)
        new.replace(session.path / name)
        names.append(name)
    result.done.append(f"{', '.join(names)}: written anew")
    return names
