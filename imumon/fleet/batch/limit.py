"""A limit to the time of a session: what hangs ends its worker, once, and is known to whoever does it next.

Code that hangs cannot be stopped from outside it, least of all a compiled loop or a file that never answers.
So the process is ended by `faulthandler`, which needs nothing of Python to do that, and leaves a note.  Dask
starts the worker again and gives the session to another, which finds the note.
"""

from __future__ import annotations

import faulthandler
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from imumon.errors import ImumonError, Reason

_ALONE = threading.Lock()
"""A process has one such clock: sessions with a limit run one after the other in it."""


@contextmanager
def limited(note: Path, limit_s: float) -> Iterator[None]:
    """End this process where what follows takes longer.

    Raises TIMEOUT when there is such a note already.

    Parameters
    ----------
    note : Path
        Where it is said that it did; taken away again by who finds it, or when it ends in time.
    """
    with suppress(FileNotFoundError):
        late = note.stat().st_size > 0  # an empty one is of a worker that died before the time was over
        note.unlink()
        if late:
            raise ImumonError(Reason.TIMEOUT, "was not done after its --timeout")
    with _ALONE, note.open("w") as file:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=file)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
            note.unlink(missing_ok=True)
