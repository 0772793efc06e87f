"""The log of a session: what was said, as lines of JSON, for who looks for the reason the next morning."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

from imumon.recordings.lines import waiting
from imumon.recordings.metadata import iso_utc

LOG_NAME = "log.jsonl"


class SessionLog:
    """Takes lines from any thread at once, and writes them when it is told to.

    Parameters
    ----------
    path : Path
        File to append to; made with the first line.
    say : callable
        Where each line goes besides: its level and its text.
    """

    def __init__(self, path: Path, say: Callable[[str, str], None]) -> None:
        self._path = path
        self._say = say
        self._lines: SimpleQueue[str] = SimpleQueue()

    def put(self, level: str, text: str) -> None:
        """Take a line; returns at once."""
        now_ns = time.time_ns()
        line = {"time": iso_utc(now_ns), "time_ns": now_ns, "level": level, "text": text}
        self._lines.put(json.dumps(line, ensure_ascii=False))
        self._say(level, text)

    def write(self) -> None:
        """Write the lines that wait; raises OSError when that fails, and they are lost."""
        lines = list(waiting(self._lines))
        if lines:
            with self._path.open("a", encoding="utf-8", errors="replace") as file:
                file.write("".join(f"{line}\n" for line in lines))
