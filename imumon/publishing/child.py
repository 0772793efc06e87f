"""The publishing process: takes items from the measuring process and sends them out.

Run as ``python -m imumon.publishing.child`` by `imumon.publishing.publisher`.
"""

from __future__ import annotations

import time
from multiprocessing.connection import Connection

from imumon.publishing.outlets import make_outlet
from imumon.publishing.publisher import Delivery
from imumon.view.fed import serve

REPEAT_S = 1.0
"""How often states are said again."""
REPORT_S = 0.25
"""How often the measuring process is told how it goes: as often as its status line is drawn."""


def run(stream: Connection, out: Connection) -> None:
    """Send what comes until the stream ends."""
    outlet = make_outlet(*stream.recv())
    reported = None
    taken = failed = 0
    repeated_s = reported_s = time.monotonic()
    while True:
        if stream.poll(REPORT_S):
            try:
                items = stream.recv()
            except EOFError:
                outlet.close()
                out.send(Delivery(outlet.text, sent=taken - failed, dropped=failed))
                return
            failed += outlet.send(items)
            taken += sum(item.rows for item in items)
        if time.monotonic() - repeated_s >= REPEAT_S:
            repeated_s = time.monotonic()
            outlet.repeat(time.time_ns())
        now = Delivery(outlet.text, sent=taken - failed, dropped=failed)
        if now != reported and time.monotonic() - reported_s >= REPORT_S:
            reported, reported_s = now, time.monotonic()
            out.send(now)


if __name__ == "__main__":
    serve(run, lambda error: Delivery(error.seen, ready=False))
