"""The newest log lines as a text that wraps, each with the time of the wall clock."""

from __future__ import annotations

from collections import deque
from datetime import datetime

from imumon.harmless import for_markdown
from imumon.view.items import Log

LOG_TEXT = "/log_text"
"""Entity of the text; all lines are in the log of the session."""
LINES = 30
QUIET = ("INFO", "DEBUG", "TRACE")
"""Levels that are not shown."""


class LogText:
    """Keeps the last lines, the newest first."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=LINES)

    @property
    def text(self) -> str:
        """The lines as Markdown."""
        return "\n\n".join(self._lines)

    def add(self, line: Log) -> str:
        """Take a line; return the text with it."""
        mark = "" if line.level in QUIET else f"**{line.level}** "
        self._lines.appendleft(f"`{clock(line.at.host_ns)}` {mark}{for_markdown(line.text)}")
        return self.text


def dated(line: Log) -> str:
    """Return a line as a terminal shows it: with the time of day, and its level where that matters."""
    when = "" if line.at.host_ns is None else f"{clock(line.at.host_ns)} "
    return f"{when}{line.level + ' ' if line.level not in QUIET else ''}{line.text}"


def clock(host_ns: int | None) -> str:
    """Return the time of day where this program runs; dashes where it is not known or damaged."""
    if host_ns is None:
        return "--:--:--"
    try:
        return datetime.fromtimestamp(host_ns * 1e-9).astimezone().strftime("%H:%M:%S")
    except (OverflowError, OSError, ValueError):  # a damaged time
        return "--:--:--"
