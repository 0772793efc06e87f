"""How far long work has come, with the time left: on a terminal, and never beside ``--json``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from imumon.cli.common import console
from imumon.harmless import for_log

Tell = Callable[[str], None]
"""Takes what is being done now."""


@contextmanager
def reading_bar(paths: Sequence[Path], *, quiet: bool) -> Iterator[Tell]:
    """Show how much of recordings has been gone through; then what follows, by what the tell is told.

    Parameters
    ----------
    paths : sequence of Path
        Sessions, captures or tables, as they are read one after the other.
    quiet : bool
        Show nothing, as where standard error is no terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from imumon.recordings.source import reading, recorded_bytes

    sizes = [recorded_bytes(path) for path in paths]
    known = [size for size in sizes if size is not None]
    total = sum(known) if len(known) == len(sizes) else None
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console(error=True), transient=True) as bar:
        task = bar.add_task(for_log(f"reading {', '.join(path.name for path in paths)}"), total=total)

        def tell(text: str) -> None:
            bar.update(task, description=for_log(text), total=None)

        token = reading.set(lambda count: bar.advance(task, count))
        try:
            yield tell
        finally:
            reading.reset(token)
