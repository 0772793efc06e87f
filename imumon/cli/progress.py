"""How far long work has come, never beside ``--json``: a bar on a terminal, else a line once a minute."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from imumon.harmless import for_log

from .common import console, log

LINE_S = 60.0
"""Between two lines without a terminal."""


WORTH_LOGGING_S = 5.0
"""Work that takes longer is announced with an estimate of its time."""


def announce(what: str, samples: int, span_s: float, expected_s: float, *, quiet: bool) -> None:
    """Write how long work on so many samples takes, where that is known and more than `WORTH_LOGGING_S`."""
    if samples and expected_s > WORTH_LOGGING_S and not quiet:
        log("INFO", f"{what} {samples:,} samples of {span_s:,.0f} s: about {rounded_time(expected_s)}")


def size_of(paths: Sequence[Path]) -> tuple[int, float]:
    """Return number of samples and length, s, of sessions by their metadata; 0 for those that lack it."""
    from imumon.recordings.folder import is_session, open_session

    known = [open_session(path).metadata for path in paths if is_session(path)]
    spans = [one.duration_s for one in known]
    return sum(one.counters.get("samples", 0) for one in known), sum(s for s in spans if s == s)


def rounded_time(seconds: float) -> str:
    """Return a time as it is estimated: 20 s, 3 min, 2 h."""
    unit, name = (3600.0, "h") if seconds >= 5400.0 else (60.0, "min") if seconds >= 90.0 else (1.0, "s")
    return f"{float(f'{seconds / unit:.1g}'):g} {name}"


class ReadingProgress:
    """How far work on a total has come; called with what is being done now, it shows that."""

    def __init__(self, what: str, total: int | None) -> None:
        self.what, self.total, self.done = for_log(what), total, 0
        self.show: Callable[[], object] = self._log  # draws the present state
        self._next_s = time.monotonic() + LINE_S

    def count(self, more: int) -> None:
        """Add what was done since the last time."""
        self.done += more
        self.show()

    def __call__(self, text: str) -> None:
        """Show what is being done now, without an estimate of how long it takes."""
        self.what, self.total = for_log(text), None
        self.show()

    def _log(self) -> None:
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + LINE_S
            log("INFO", f"{self.what}: {self.done / self.total:.0%}" if self.total else self.what)


@contextmanager
def bar(what: str, total: int | None, *, quiet: bool) -> Iterator[ReadingProgress]:
    """Show how much of a total was done: a bar on a terminal, else lines; nothing when quiet."""
    now = ReadingProgress(what, total)
    if quiet or not sys.stderr.isatty():
        if quiet:
            now.show = lambda: None
        yield now
        return
    from rich import progress as rich

    label, usual = rich.TextColumn("{task.description}", markup=False), rich.Progress.get_default_columns()
    with rich.Progress(label, *usual[1:], console=console(error=True), transient=True) as drawn:
        task = drawn.add_task(now.what, total=total)
        now.show = lambda: drawn.update(task, description=now.what, completed=now.done)
        yield now


@contextmanager
def reading_bar(paths: Sequence[Path], *, quiet: bool) -> Iterator[ReadingProgress]:
    """Show how much of recordings has been read; then what follows, as the progress is called with it.

    `paths` are sessions, captures or tables, as they are read one after the other.
    """
    from imumon.recordings.source import recorded_bytes

    sizes = [recorded_bytes(path) for path in paths]
    total = None if None in sizes else sum(filter(None, sizes))
    with bar(f"reading {', '.join(path.name for path in paths)}", total, quiet=quiet) as progress:
        yield progress
