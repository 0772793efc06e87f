"""The publishing process: takes items from the measuring process and sends them out.

Run as ``python -m imumon.publishing.child`` by `imumon.publishing.publisher`.  Each kind of receiver has an
outlet of its own; that for UDP is here.
"""

import json
import socket
import time
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing.connection import Connection
from pkgutil import resolve_name
from typing import Any

from imumon.view.fed import batches, serve
from imumon.view.items import Instant, State

from .publisher import Delivery, Published, Value, messages
from .target import Target

REPEAT_S = 1.0
"""How often states are sent again, for who came later: every message of a state has all of them."""
REPORT_S = 0.25
"""How often the measuring process is informed how it goes: as often as its status line is drawn."""
BURST_BYTES = 1 << 16
"""Datagrams that are sent at once: a receiver's buffer is 208 KiB by default (net.core.rmem_default), where a
datagram takes up to twice its size; what comes while it is full is lost."""
PAUSE_S = 0.01
"""Behind a burst, for the receiver to read it: so 6.5 MB/s leave at the most, 5000 rows of 1.3 kB."""


class UdpJson:
    """A datagram for each message, as PlotJuggler reads: ``{"timestamp": s, "imu": {"gyro_x": ...}}``."""

    def __init__(self, target: Target) -> None:
        family = socket.AF_INET6 if ":" in target.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._to, self._states = (target.host, target.port), dict[str, Value]()
        self.text = "sends"

    def send(self, items: Sequence[Published]) -> int:
        """Send items; return how many datagrams the system did not take."""
        failed = burst = 0
        for topic, time_ns, values in messages(items, self._states):
            when = {} if time_ns is None else {"timestamp": time_ns * 1e-9}
            content = {**when, topic: values}
            datagram = json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode()
            try:
                self._socket.sendto(datagram, self._to)
                self.text = "sends"
            except OSError as error:  # its buffer is full, or there is no way to the network at this moment
                self.text = f"cannot send: {error.strerror}"
                failed += 1
            burst += len(datagram)
            if burst > BURST_BYTES:
                time.sleep(PAUSE_S)
                burst = 0
        return failed

    def close(self) -> None:
        """Close the socket; the system sends what it has taken."""
        self._socket.close()


OUTLETS = {"foxglove": "imumon.publishing.foxglove:Foxglove", "ros2": "imumon.publishing.ros2:Ros2"}
"""Of the kinds that need a package, what has `text`, `send` and `close` as `UdpJson`."""


def run(stream: Connection, out: Connection) -> None:
    """Send what comes until the stream ends; raises BUSY or BAD_CONFIG when the outlet cannot be opened."""
    target, setup = stream.recv()
    place = OUTLETS.get(target.kind)
    outlet: Any = UdpJson(target) if place is None else resolve_name(place)(target, setup)
    taken = failed = 0
    state: State | None = None
    repeated_s = reported_s = time.monotonic()
    for items in batches(stream, REPORT_S):
        failed += outlet.send(items)
        taken += sum(item.rows for item in items)
        state = next((item for item in reversed(items) if isinstance(item, State)), state)
        if state is not None and time.monotonic() - repeated_s >= REPEAT_S:
            repeated_s = time.monotonic()
            outlet.send([replace(state, at=Instant(None, None, time.time_ns()))])
        if time.monotonic() - reported_s >= REPORT_S:
            reported_s = time.monotonic()
            out.send(Delivery(outlet.text, sent=taken - failed, dropped=failed))
    outlet.close()
    out.send(Delivery(outlet.text, sent=taken - failed, dropped=failed))


if __name__ == "__main__":
    serve(run, lambda error: Delivery(error.seen, ready=False))
