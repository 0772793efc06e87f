"""Marks that a person puts into a recording while it goes on: requested in a file of the session's folder.

Whoever records looks into the file 12 times a second, puts what is new into the recording as an event, and
removes the file at the end: the recording is what counts.  A mark has the time at which it was requested.
"""

import json
import math
from contextlib import suppress
from pathlib import Path

from imumon.errors import bad_config
from imumon.harmless import for_log
from imumon.recordings.folder import open_session
from imumon.recordings.wire import is_recorded
from imumon.transport.reader import Event, EventKind, steady_ns

REQUESTS = "marks.jsonl"
OLDEST_NS = 60_000_000_000
"""A request that is older, or of the future, is of another start of the computer."""
KINDS = {kind.value: kind for kind in (EventKind.MARK, EventKind.START, EventKind.STOP)}


def ask_for_mark(session: Path, kind: EventKind, text: str) -> None:
    """Request a mark, or the start or stop of a part, from whoever records this session.

    Raises BAD_CONFIG when the text is empty, or the session is not being recorded; BAD_DATA when there is no
    session.
    """
    if not text.strip():
        raise bad_config("the text of the mark is empty", "name what is marked")
    opened = open_session(session)
    if not (opened.wire_path.exists() and is_recorded(opened.wire_path)):
        raise bad_config(
            f"{session} is not being recorded",
            "marks are made while imumon monitor runs; its summary names the session",
        )
    append_request(opened.path, kind, text)


def append_request(folder: Path, kind: EventKind, text: str) -> None:
    """Leave a request where whoever records looks for it; raises OSError where that cannot be written."""
    line = json.dumps({"kind": kind.value, "text": for_log(text), "steady_ns": steady_ns()}) + "\n"
    with (folder / REQUESTS).open("ab") as file:
        file.write(line.encode())


class Marks:
    """The requests, as they come."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / REQUESTS
        self._read = 0

    def take(self, now_ns: int) -> list[Event]:
        """Return what is new by `now_ns` (Unix time), whole lines only; what is no request is passed over."""
        lines = b""
        with suppress(OSError), self._path.open("rb") as file:
            file.seek(self._read)
            lines = file.read()
        end = lines.rfind(b"\n") + 1
        self._read += end
        requests = list[Event]()
        for line in lines[:end].splitlines():
            with suppress(ValueError, KeyError, TypeError, RecursionError):
                fields = json.loads(line)
                kind, age_ns = KINDS[fields["kind"]], steady_ns() - fields.get("steady_ns", math.nan)
                at_ns = now_ns - int(age_ns) if 0 <= age_ns < OLDEST_NS else now_ns
                requests.append(Event(kind, at_ns, for_log(str(fields["text"]))))
        return requests

    def close(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            self._path.unlink()
