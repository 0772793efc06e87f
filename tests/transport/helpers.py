"""What the tests of the transport share."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator

from imumon.transport.port import Port
from imumon.transport.reader import Bytes, Event, EventKind, Item
from tests.waiting import LIMIT_S, wait_until


def read_exactly(port: Port, n_bytes: int) -> bytes:
    """Read until so many bytes have come (or time is up)."""
    end, data = time.monotonic() + LIMIT_S, b""
    while len(data) < n_bytes and time.monotonic() < end:
        data += port.read(0.1)
    return data


class Collector:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.items: list[Item] = []

    def __call__(self, item: Item) -> None:
        self.items.append(item)

    @property
    def data(self) -> bytes:
        return b"".join(item.data for item in list(self.items) if isinstance(item, Bytes))

    @property
    def events(self) -> list[Event]:
        return [item for item in list(self.items) if isinstance(item, Event)]

    @property
    def kinds(self) -> list[EventKind]:
        return [event.kind for event in self.events]

    def saw(self, kind: EventKind, times: int = 1) -> bool:
        return wait_until(lambda: self.kinds.count(kind) >= times)

    def got(self, data: bytes) -> bool:
        return wait_until(lambda: self.data.endswith(data))


@contextlib.contextmanager
def tcp_server(serve: Callable[[socket.socket], None]) -> Iterator[int]:
    """Serve one client at a time on the loopback; yield the port number."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.05)
        stopping = threading.Event()

        def run() -> None:
            while not stopping.is_set():
                try:
                    client, _ = server.accept()
                except TimeoutError:
                    continue
                with client:
                    client.settimeout(LIMIT_S)
                    serve(client)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            stopping.set()
            thread.join()
