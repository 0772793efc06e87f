"""The view process: takes items from the measuring process and keeps a viewer supplied with them.

It may hang, be killed or die without the measuring process noticing more than a word in the status line.
Run as ``python -m imumon.view.child`` by `imumon.view.publisher`.
"""

from __future__ import annotations

import gc
import os
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any

from imumon.view.fed import serve
from imumon.view.frames import Batch, ReplayRequest, Report, Start
from imumon.view.items import WEB_TAB

POLL_S = 0.5
GOODBYE_S = 0.6
BEHIND = 10
"""Where there are many units, their processes come before the view (and a viewer that draws by software)."""
REPEAT_S = 2.0
"""So often a browser is told the states and the log again: it takes the newest first, and a slow one would
have what was said once after all samples since then; until then its panes are empty."""


class Child:
    """Feeds one recording stream; see `run`.

    Parameters
    ----------
    start : Start
        What to show and where.
    out : Connection
        Where reports and requests go.
    """

    def __init__(self, start: Start, out: Connection) -> None:
        # Start the viewer first: it comes up while the library loads.
        from imumon.view.links import NativeLink, WebLink

        self._out = out
        self._reported: Report | None = None
        self._link = (NativeLink if start.mode == "native" else WebLink)(start, self._report)

        import rerun as rr

        from imumon.view.in_place import InPlace
        from imumon.view.logger import StreamLogger
        from imumon.view.rrd import LIVE_APPLICATION
        from imumon.view.units import UnitsLogger

        setup = replace(start.setup, tab_height=WEB_TAB) if start.mode == "web" else start.setup
        self._rec = rr.RecordingStream(LIVE_APPLICATION, recording_id=setup.recording_id)
        self._arrangement = InPlace(self._rec)
        show = self._arrangement.send
        self._logger: Any = (
            UnitsLogger(self._rec, setup, show)
            if setup.several
            else StreamLogger(self._rec, setup, live=True, show=show)
        )
        self._repeats = start.mode == "web"
        self._repeated_s = time.monotonic()
        self._delivered = -1
        self._request = 0
        self._answered = True

    def poll(self) -> None:
        """Look after the viewer; ask for what it has not seen."""
        if self._repeats and time.monotonic() - self._repeated_s > REPEAT_S:
            self._repeated_s = time.monotonic()
            self._logger.repeat()
        change = self._link.poll(self._rec)
        if change is None:
            return
        if change.name == "NEW":
            self._delivered = -1
            self._arrangement.forget()
            self._logger.begin()
        self._request += 1
        self._answered = False
        self._out.send(ReplayRequest(self._request, self._delivered))

    def take(self, batch: Batch) -> None:
        """Log a batch, unless nobody would see it or it is asked for again anyway."""
        self._answered = self._answered or batch.answers == self._request
        if self._answered and self._link.connected:
            self._logger.log(batch.items)
            self._delivered = batch.number

    def close(self) -> None:
        """Hand over what is left, within `GOODBYE_S`."""
        if self._link.connected:
            self._logger.finish()
            self._rec.flush(timeout_sec=GOODBYE_S)

    def _report(self, report: Report) -> None:
        if report != self._reported:
            self._reported = report
            self._out.send(report)


def run(stream: Connection, out: Connection) -> None:
    """Take batches until the stream ends."""
    start = stream.recv()
    if start.setup.several:
        os.nice(BEHIND)
    child = Child(start, out)
    gc.freeze()  # or the circles of pictures wait until they are a quarter of all that was loaded
    next_poll = 0.0
    while True:
        if time.monotonic() >= next_poll:
            child.poll()
            next_poll = time.monotonic() + POLL_S
        if stream.poll(POLL_S / 2):
            try:
                batch = stream.recv()
            except EOFError:
                child.close()
                return
            child.take(batch)


if __name__ == "__main__":
    serve(run, lambda error: Report(error.seen, False, 0, 0, ""))
