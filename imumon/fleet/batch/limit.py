"""A limit to the time of a session: what hangs ends its worker, once, and is known to whoever does it next.

Code that hangs cannot be stopped from outside it, least of all a compiled loop or a file that never answers.
So the process is ended by `faulthandler`, which needs nothing of Python to do that, and leaves a note where
the code was.  Dask starts the worker again and gives the session to another, which finds the note.
"""

from __future__ import annotations

import faulthandler
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from imumon.errors import ImumonError, Reason

_ALONE = threading.Lock()
"""A process has one such clock: sessions with a limit run one after the other in it."""
_FRAME = re.compile(
    rf'File "{re.escape(str(Path(__file__).parents[3]))}/(imumon/[^"]+)", line (\d+) in (\w+)'
)
"""A line of a traceback that is of this package, wherever others are."""
_THREAD = re.compile(r"\n\n")


@contextmanager
def limited(note: Path, limit_s: float) -> Iterator[None]:
    """End this process where what follows takes longer.

    Raises TIMEOUT when there is such a note already.

    Parameters
    ----------
    note : Path
        Where it is said that it did; taken away again by who finds it, or when it ends in time.
    """
    if (where := _taken(note)) is not None:
        raise ImumonError(Reason.TIMEOUT, f"was not done after its --timeout{where}")
    with _ALONE, note.open("w") as file:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=file)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
            note.unlink(missing_ok=True)


def _taken(note: Path) -> str | None:
    """Take a note away and return where the code was; None when there is none, or an empty one.

    An empty one is of a worker that died before the time was over.
    """
    try:
        text = note.read_text(errors="replace")
    except FileNotFoundError:
        return None
    note.unlink(missing_ok=True)
    if not text:
        return None
    for thread in _THREAD.split(text):
        frames = _FRAME.findall(thread)
        if any(name == "work" for *_, name in frames):
            file, line, name = frames[0]
            return f": it was in {name}, {file}:{line}"
    return ""
