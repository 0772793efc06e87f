"""Log lines on their way from one thread to another, and into the log of a session; light, as every command
needs them."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

LOG_NAME = "log.jsonl"
Line = tuple[int, str, str]
"""Unix time (ns), level and text of a line."""


class Lines:
    """Log lines on their way to another thread or process; `put` may be called from any thread.

    `report`: where each line goes besides: its level and its text.
    """

    def __init__(self, report: Callable[[str, str], object] = lambda *_: None) -> None:
        self._waiting: SimpleQueue[Line] = SimpleQueue()
        self._report = report

    def put(self, level: str, text: str) -> None:
        """Take a line; returns at once."""
        self._waiting.put((time.time_ns(), level, text))
        self._report(level, text)

    def take(self) -> list[Line]:
        """Return the lines since the last time."""
        return [self._waiting.get_nowait() for _ in range(self._waiting.qsize())]


class SessionLog(Lines):
    """The log of a session, as lines of JSON appended to the file at `path`."""

    def __init__(self, path: Path, report: Callable[[str, str], object]) -> None:
        super().__init__(report)
        self._path = path

    def write(self) -> None:
        """Write the lines that wait; raises OSError when that fails, and they are lost."""
        from .folder import iso_utc  # here, as it loads pydantic

        lines = [
            {"time": iso_utc(now_ns), "time_ns": now_ns, "level": level, "text": text}
            for now_ns, level, text in self.take()
        ]
        if lines:
            with self._path.open("a", encoding="utf-8", errors="replace") as file:
                file.write("".join(f"{json.dumps(line, ensure_ascii=False)}\n" for line in lines))
