"""The publishing process: takes items from the measuring process and sends them out.

Run as ``python -m imumon.publishing.child`` by `imumon.publishing.publisher`.
"""

from __future__ import annotations

import time
from multiprocessing.connection import Connection

from imumon.publishing.frames import Delivery
from imumon.publishing.outlets import make_outlet
from imumon.view.fed import serve

REPEAT_S = 1.0
"""How often states are said again."""
REPORT_S = 0.25
"""How often the measuring process is told how it goes: as often as its status line is drawn."""


def run(stream: Connection, out: Connection) -> None:
    """Send what comes until the stream ends."""
    begin = stream.recv()
    outlet = make_outlet(begin.target, begin.setup)
    sent, now = None, Delivery(outlet.text)
    repeated = reported = time.monotonic()
    while True:
        if stream.poll(REPORT_S):
            try:
                items = stream.recv()
            except EOFError:
                outlet.close()
                out.send(now)
                return
            failed = now.failed + outlet.send(items)
            now = Delivery(outlet.text, now.taken + sum(item.rows for item in items), failed)
        if time.monotonic() - repeated >= REPEAT_S:
            repeated = time.monotonic()
            outlet.repeat(time.time_ns())
        if now != sent and time.monotonic() - reported >= REPORT_S:
            sent, reported = now, time.monotonic()
            out.send(now)


if __name__ == "__main__":
    serve(run, lambda error: Delivery(error.seen, ready=False))
