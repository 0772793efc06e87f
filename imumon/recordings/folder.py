"""The session folder, and its session.yaml: what was recorded, with what, when, and how it ended."""

import hashlib
import math
import os
import platform
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import chain, count
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, NonNegativeInt

from imumon.columns import BodyAxes
from imumon.config import StrictModel, dump_yaml, parse_yaml
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.files import naming, read_text, readable, results_folder, write_text
from imumon.transport.statistics import StreamCounters
from imumon.version import __version__

METADATA_NAME = "session.yaml"
WIRE_NAME = "wire.mcap"
SAMPLES_NAME = "samples.parquet"
VIEW_NAME = "view.rrd"
TRUTH_NAME = "truth.parquet"
DEFAULT_PARENT = Path("sessions")

FORMAT: Final = "imumon-session/1"
SourceKind = Literal["live", "simulation", "import"]
SPAN = "span_ns"
"""Counter of an imported session: what its rows span, without the gaps between segments."""
_PACKAGES = ("numpy", "numba", "scipy", "pyarrow", "mcap", "rerun-sdk")


class PortUsed(StrictModel):
    """The port of a live session, and how it was set."""

    url: str
    settings: dict[str, str | int | float | bool | None]


class TableUsed(StrictModel):
    """The table of an imported session, and what was made of it."""

    file: str
    size_bytes: NonNegativeInt
    sha256: str
    map_yaml: str
    rows_in: NonNegativeInt
    rows_out: NonNegativeInt
    rows_dropped: NonNegativeInt


class SessionMetadata(StrictModel):
    """Everything about a session but its data; times are UTC.

    `state` stays "open" when the program dies; who opens the session then calls it interrupted.
    """

    format: Literal["imumon-session/1"] = FORMAT
    source: SourceKind
    state: Literal["open", "closed"] = "open"
    created: str
    created_ns: int
    ended: str | None = None
    ended_ns: int | None = None
    device: str
    serial: str | None = None
    axes: BodyAxes | None = None
    device_yaml: str | None = None
    pipeline_yaml: str | None = None
    port: PortUsed | None = None
    table: TableUsed | None = None
    versions: dict[str, str]
    counters: dict[str, int] = Field(default_factory=dict)
    streams: dict[str, StreamCounters] = Field(default_factory=dict)
    events: NonNegativeInt = 0
    results_digest: str | None = None
    column_crc32: dict[str, NonNegativeInt] = Field(default_factory=dict)
    """As `imumon.pipeline.Digest.columns` has them, without those that a replay cannot reproduce."""
    views: list[str] = Field(default_factory=list)

    @classmethod
    def begun(cls, source: SourceKind, at_ns: int, **more: Any) -> "SessionMetadata":
        """Return the metadata of a session that begins at this Unix time (ns), made by this version."""
        versions = {
            "imumon": __version__,
            "python": platform.python_version(),
            "platform": platform.platform(),
            **{name: version(name) for name in _PACKAGES},
        }
        return cls(source=source, created=iso_utc(at_ns), created_ns=at_ns, versions=versions, **more)

    def for_wire(self) -> dict[str, str]:
        """Return what a wire file holds, so that session.yaml can be made anew from it (`begun_of`)."""
        return {"device": self.device, "source": self.source, "session": dump_yaml(self.model_dump())}

    @property
    def duration_s(self) -> float:
        """How long it was recorded; NaN when it was not closed, or is a table that does not state it."""
        if self.table is not None:
            return self.counters.get(SPAN, math.nan) * 1e-9
        return math.nan if self.ended_ns is None else (self.ended_ns - self.created_ns) * 1e-9

    def closed(self, ended_ns: int, **changes: Any) -> "SessionMetadata":
        """Return the metadata of the session after its end in order at this Unix time (ns)."""
        ended = {"state": "closed", "ended_ns": ended_ns, "ended": iso_utc(ended_ns)}
        return self.model_copy(update=ended | changes)


def iso_utc(time_ns: int) -> str:
    """Return a Unix time in ns as ISO 8601 in UTC, to the nanosecond."""
    seconds, fraction = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{fraction:09d}Z"


def begun_of(metadata: Mapping[str, str]) -> SessionMetadata | None:
    """Return the metadata as they were at the start from what a wire file holds; None where it has none."""
    try:
        return parse_yaml(metadata["session"], SessionMetadata, "the metadata of the wire file")
    except (KeyError, ImumonError):
        return None


def read_metadata(path: Path) -> SessionMetadata:
    """Read session.yaml.

    Raises BAD_DATA, naming file and line, when it cannot be read or is not in the format of this version.
    """
    text = read_text(path, Reason.BAD_DATA)
    try:
        return parse_yaml(text, SessionMetadata, str(path))
    except ImumonError as error:
        raise bad_data(error.seen, f"this version of imumon reads sessions of format {FORMAT}") from error


@dataclass(frozen=True)
class Session:
    """A session on disk, as its metadata was when it was opened."""

    path: Path
    metadata: SessionMetadata

    @property
    def wire_path(self) -> Path:
        """The bytes, the truth of a live or simulated session."""
        return self.path / WIRE_NAME

    @property
    def truth_path(self) -> Path:
        """The file that everything else follows from: of an imported session its samples."""
        return self.path / SAMPLES_NAME if self.metadata.source == "import" else self.wire_path

    @property
    def view_path(self) -> Path:
        """What the viewer shows; can be made again from the truth."""
        return self.path / VIEW_NAME

    @property
    def state(self) -> Literal["closed", "interrupted"]:
        """How the session ended; one that is being recorded looks like one that was killed."""
        return "closed" if self.metadata.state == "closed" else "interrupted"

    def save(self, metadata: SessionMetadata) -> None:
        """Replace the metadata on disk; raises OSError when that fails, and the old file stays."""
        write_text(self.path / METADATA_NAME, dump_yaml(metadata.model_dump()))


def default_path(name: str, now_ns: int, parent: Path = DEFAULT_PARENT) -> Path:
    """Return PARENT/<UTC stamp>-<name of device or unit>, with a number added when that is taken."""
    stamp = datetime.fromtimestamp(now_ns // 1_000_000_000, UTC)
    return unused(parent / f"{stamp:%Y%m%dT%H%M%SZ}-{name}")


def unused(path: Path) -> Path:
    """Return a path, with a number added when it is taken."""
    numbered = (path.with_name(f"{path.name}-{number}") for number in count(2))
    return next(one for one in chain([path], numbered) if not one.exists())


def create_session(path: Path, metadata: SessionMetadata) -> Session:
    """Make the folder, if need be with its parents, and write session.yaml into it.

    Raises EXISTS when the folder holds a session already or the path is a file; BAD_CONFIG when it cannot be
    made.
    """
    refuse_existing(path)
    session = Session(path, metadata)
    try:
        path.mkdir(parents=True, exist_ok=True)
        (path / METADATA_NAME).touch(exist_ok=False)  # of two that come at the same moment one is refused
        session.save(metadata)
    except FileExistsError:
        refuse_existing(path)
        raise
    except OSError as error:
        remove_empty(session)
        raise bad_config(
            f"the session {path} cannot be made: {error.strerror}", "give another folder"
        ) from error
    return session


@contextmanager
def whole_session(path: Path) -> Iterator[Path]:
    """Give a new folder to make a session in, which gets its name at the end, and is removed with an error.

    Raises EXISTS when there is anything but an empty folder at the path; OSError when it cannot be made,
    naming the path.
    """
    refuse_existing(path)
    if not path.name or (path.is_dir() and any(path.iterdir())):
        raise ImumonError(Reason.EXISTS, f"{path} is there already", "give the name of a new folder")
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with naming(path), results_folder(path.parent):
        try:
            partial.mkdir()
            yield partial
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def refuse_existing(path: Path) -> None:
    """Raise EXISTS when a session, or a part of one, is at this path, or something that is not a folder."""
    if path.exists() and not path.is_dir():
        raise ImumonError(Reason.EXISTS, f"{path} is a file, not a folder", "give another folder")
    parts = [name for name in (METADATA_NAME, WIRE_NAME, SAMPLES_NAME, VIEW_NAME) if (path / name).exists()]
    if parts:
        raise ImumonError(
            Reason.EXISTS,
            f"{path} holds a session already ({', '.join(parts)})",
            "nothing was overwritten; give another folder",
        )


def remove_empty(session: Session) -> None:
    """Take back a session that was made for a recording which could not begin."""
    for path in (session.wire_path, session.path / METADATA_NAME):
        with suppress(OSError):
            path.unlink()
    for folder in (session.path, DEFAULT_PARENT):
        with suppress(OSError):  # it is not empty, or not ours to remove
            folder.rmdir()


def is_session(path: Path) -> bool:
    """Return whether there is a session at this path: the folder, its session.yaml or its wire.mcap."""
    return (_folder(path) / METADATA_NAME).is_file()


def open_session(path: Path) -> Session:
    """Open a session for reading; `path` names the folder, its session.yaml or its wire.mcap.

    Raises BAD_DATA when there is no session, or when its metadata or its data is missing.
    """
    folder = _folder(path)
    if not folder.exists():
        raise bad_data(
            f"{path}: there is no such file or folder",
            f"sessions are folders with a {METADATA_NAME}, usually in ./{DEFAULT_PARENT}",
        )
    if not (folder / METADATA_NAME).is_file():
        there = f"the folder has no {METADATA_NAME}" if folder.is_dir() else "it is a file"
        raise bad_data(f"{path} is not a session: {there}", _advice(folder) or _HINT)
    try:
        session = Session(folder, read_metadata(folder / METADATA_NAME))
    except ImumonError as error:
        raise ImumonError(error.reason, error.seen, _advice(folder) or error.hint) from error
    if not session.truth_path.is_file():
        raise bad_data(
            f"{path}: the data of this session is missing: there is no file {session.truth_path.name}",
            "copy it here from where the session was recorded: nothing else holds the samples",
        )
    return session


def lost_metadata(path: Path) -> Path | None:
    """Return the wire file whose session.yaml is missing, or is damaged so that no version reads it."""
    wire, metadata = _folder(path) / WIRE_NAME, _folder(path) / METADATA_NAME
    if not wire.is_file():
        return None
    if metadata.is_file():
        with suppress(ImumonError):
            read_metadata(metadata)
            return None
        with readable(metadata):
            content = metadata.read_bytes()
        if re.search(rb"^format: imumon-session/(?!1\b)\S", content, re.MULTILINE):
            return None
    return wire


def name_unit(path: Path, serial: str | None) -> None:
    """Set which unit a session is of; None leaves it as it is.  Raises OSError when it cannot be written."""
    if serial is not None:
        session = open_session(path)
        session.save(session.metadata.model_copy(update={"serial": serial}))


def sessions_in(folder: Path, report: Callable[[str], object]) -> list[Session]:
    """Return the sessions whose folders are in this one, the oldest first.

    What is a session by its files and cannot be read is left out, and reported.
    """
    found = []
    for path in sorted(one for one in folder.iterdir() if one.is_dir()) if folder.is_dir() else ():
        try:
            found.append(open_session(path))
        except ImumonError as error:
            if any((path / name).is_file() for name in (METADATA_NAME, WIRE_NAME, SAMPLES_NAME)):
                report(f"{path.name} is left out: {error.line}")
    return sorted(found, key=lambda session: session.metadata.created_ns)


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


_HINT = f"a session is a folder with {METADATA_NAME}; for a raw capture use: imumon decode FILE --device NAME"


def _folder(path: Path) -> Path:
    return path.parent if path.name in (METADATA_NAME, WIRE_NAME) else path


def _advice(folder: Path) -> str:
    """Return what can be done with the data of a session without readable metadata; empty without data."""
    if lost_metadata(folder) is not None:
        return f"{WIRE_NAME} is there: imumon recover {folder} makes {METADATA_NAME} anew from it"
    if not (folder / METADATA_NAME).is_file() and (folder / SAMPLES_NAME).is_file():
        return f"its samples are there, and can be read as a table: {folder / SAMPLES_NAME}"
    return ""
