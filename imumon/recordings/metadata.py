"""session.yaml: what was recorded, with what, when, and how it ended."""

from __future__ import annotations

import math
import platform
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, NonNegativeInt

from imumon.config import StrictModel, dump_yaml, parse_yaml
from imumon.errors import ImumonError, Reason, bad_data
from imumon.files import read_text, readable
from imumon.transport.statistics import StreamCounters
from imumon.version import __version__

FORMAT: Final = "imumon-session/1"
SourceKind = Literal["live", "simulation", "import"]
SPAN: Final = "span_ns"
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
    axes: Literal["FLU", "FRD"] | None = None
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
    def begun(
        cls, source: Literal["live", "simulation", "import"], at_ns: int, **more: Any
    ) -> SessionMetadata:
        """Return the metadata of a session that begins at this Unix time (ns), made by this version."""
        return cls(
            source=source, created=iso_utc(at_ns), created_ns=at_ns, versions=versions_in_use(), **more
        )

    def for_wire(self) -> dict[str, str]:
        """Return what a wire file says, so that session.yaml can be made anew from it (`begun_of`)."""
        return {"device": self.device, "source": self.source, "session": dump_yaml(self.model_dump())}

    @property
    def duration_s(self) -> float:
        """How long it was recorded; NaN when it was not closed, or is a table that does not say how long."""
        if self.table is not None:
            return self.counters.get(SPAN, math.nan) * 1e-9
        return math.nan if self.ended_ns is None else (self.ended_ns - self.created_ns) * 1e-9

    def closed(self, ended_ns: int, **changes: Any) -> SessionMetadata:
        """Return the metadata of the session after its end in order at this Unix time (ns)."""
        ended = {"state": "closed", "ended_ns": ended_ns, "ended": iso_utc(ended_ns)}
        return self.model_copy(update={**ended, **changes})


def iso_utc(time_ns: int) -> str:
    """Return a Unix time in ns as ISO 8601 in UTC, to the nanosecond."""
    seconds, fraction = divmod(time_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{fraction:09d}Z"


def versions_in_use() -> dict[str, str]:
    """Return the versions of imumon, Python, the platform and the packages that make the numbers."""
    own = {"imumon": __version__, "python": platform.python_version(), "platform": platform.platform()}
    return own | {name: version(name) for name in _PACKAGES}


def begun_of(metadata: Mapping[str, str]) -> SessionMetadata | None:
    """Return the metadata as they were at the start from what a wire file says; None where it does not."""
    try:
        return parse_yaml(metadata["session"], SessionMetadata, "the metadata of the wire file")
    except (KeyError, ImumonError):
        return None


def is_of_another_version(path: Path) -> bool:
    """Return whether a session.yaml that this version cannot read says that another one wrote it."""
    with readable(path):
        line = re.search(rb"^format: imumon-session/(\S+)", path.read_bytes(), re.MULTILINE)
    return line is not None and line[1] != FORMAT.rpartition("/")[2].encode()


def read_metadata(path: Path) -> SessionMetadata:
    """Read session.yaml.

    Raises BAD_DATA, naming file and line, when it cannot be read or is not in the format of this version.
    """
    text = read_text(path, Reason.BAD_DATA)
    try:
        return parse_yaml(text, SessionMetadata, str(path))
    except ImumonError as error:
        raise bad_data(error.seen, f"this version of imumon reads sessions of format {FORMAT}") from error
