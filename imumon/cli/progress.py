"""How far long work has come, never beside ``--json``: a bar on a terminal, else a line from time to time."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from imumon.cli.common import console, say
from imumon.harmless import for_log

FIRST_LINE_S, LINE_S = 30.0, 60.0
"""Until the first line without a terminal, and between two."""
WORTH_SAYING_S = 5.0
"""Work that takes longer is announced with an estimate of its time."""


def announce(what: str, samples: int, span_s: float, expected_s: float, *, quiet: bool) -> None:
    """Write how long work on so many samples takes, in a line, where that is more than `WORTH_SAYING_S`."""
    if expected_s > WORTH_SAYING_S and not quiet:
        say("INFO", f"{what} {samples:,} samples of {span_s:,.0f} s: about {rounded_time(expected_s)}")


def rounded_time(seconds: float) -> str:
    """Return a time as it is estimated: 20 s, 3 min, 2 h."""
    unit, name = (3600.0, "h") if seconds >= 5400.0 else (60.0, "min") if seconds >= 90.0 else (1.0, "s")
    return f"{float(f'{seconds / unit:.1g}'):g} {name}"


def size_of(paths: Sequence[Path]) -> tuple[int, float]:
    """Return number of samples and length, s, of sessions by their metadata; 0 for those that lack it."""
    from imumon.recordings.folder import is_session, open_session

    known = [open_session(path).metadata for path in paths if is_session(path)]
    spans = [one.duration_s for one in known]
    return sum(one.counters.get("samples", 0) for one in known), sum(s for s in spans if s == s)


@contextmanager
def progress_lines(state: Callable[[], str], *, quiet: bool) -> Iterator[None]:
    """Log from time to time what is being done, where standard error is no terminal.

    `state` returns what is being done now; it is called by another thread.
    """
    if quiet or sys.stderr.isatty():
        yield
        return
    began, ended = time.monotonic(), threading.Event()

    def lines() -> None:
        wait_s = FIRST_LINE_S
        while not ended.wait(wait_s):
            wait_s = LINE_S
            say("INFO", f"{state()}, {time.monotonic() - began:.0f} s so far")

    thread = threading.Thread(target=lines, name="progress", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@dataclass(frozen=True, slots=True)
class ReadingProgress:
    """How far work on recordings has come; called with what is being done now, it shows that."""

    count: Callable[[int], object]
    """Takes how many more bytes were read."""
    tell: Callable[[str], object]

    def __call__(self, text: str) -> None:
        """Show what is being done now."""
        self.tell(text)


Shown = Iterator[ReadingProgress]


@contextmanager
def bar(what: str, total: int | None, *, quiet: bool) -> Shown:
    """Show how much of a total was done: a bar on a terminal, else lines; nothing when quiet."""
    if not sys.stderr.isatty() or quiet:
        with _lines(what, total, quiet=quiet) as shown:
            yield shown
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    label, left = TextColumn("{task.description}", markup=False), TextColumn("left:")
    columns = (label, BarColumn(), TimeElapsedColumn(), left, TimeRemainingColumn())
    with Progress(*columns, console=console(error=True), transient=True) as drawn:
        task = drawn.add_task(for_log(what), total=total)
        yield ReadingProgress(
            lambda more: drawn.advance(task, more),
            lambda text: drawn.update(task, description=for_log(text), total=None),
        )


@contextmanager
def _lines(what: str, total: int | None, *, quiet: bool) -> Shown:
    done, now = 0, ""

    def count(more: int) -> None:
        nonlocal done
        done += more

    def tell(text: str) -> None:
        nonlocal now
        now = text

    with progress_lines(lambda: now or (f"{what}: {done / total:.0%}" if total else what), quiet=quiet):
        yield ReadingProgress(count, tell)


@contextmanager
def reading_bar(paths: Sequence[Path], *, quiet: bool) -> Shown:
    """Show how much of recordings has been read; then what follows, as the progress is called with it.

    `paths` are sessions, captures or tables, as they are read one after the other.
    """
    from imumon.recordings.source import recorded_bytes

    sizes = [] if quiet else [recorded_bytes(path) for path in paths]
    total = sum(size or 0 for size in sizes) if None not in sizes else None
    with bar(f"reading {', '.join(path.name for path in paths)}", total, quiet=quiet) as progress:
        yield progress
