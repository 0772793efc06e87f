"""Rewrites a finished segment of the view recording into few large chunks, at low priority."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from imumon.view.viewer import start_quietly, viewer_binary

WORTH_BYTES = 4 << 20
"""Smaller segments stay as they are."""
PRIORITY = 15


class Compaction:
    """One run of ``rerun rrd optimize``; the segment is replaced when it has succeeded, and not before.

    Parameters
    ----------
    path : Path
        A segment that is finished.

    Raises
    ------
    ImumonError
        NOT_FOUND when this installation has no viewer program.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(f".{path.stem}.part{path.suffix}")
        self._process = start_quietly(
            [str(viewer_binary()), "rrd", "optimize", str(path), "-o", str(self._part)]
        )
        with contextlib.suppress(ProcessLookupError):  # done already
            os.setpriority(os.PRIO_PROCESS, self._process.pid, PRIORITY)

    def is_done(self) -> bool:
        """Tell whether it has ended, and if it has succeeded put the new file in the place of the old."""
        code = self._process.poll()
        if code is None:
            return False
        if code == 0 and self._part.exists():
            self._part.replace(self._path)
        self._part.unlink(missing_ok=True)
        return True

    def stop(self) -> None:
        """End it; the segment stays as it was."""
        self._process.kill()
        self._process.wait()
        self._part.unlink(missing_ok=True)
