"""What the tests of the transport share."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator

from imumon.transport.port import Port
from imumon.transport.reader import Bytes, Event, EventKind, Item


def wait_until(condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
    """Wait until the condition holds; return whether it does."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


def read_exactly(port: Port, n_bytes: int, timeout_s: float = 5.0) -> bytes:
    """Read until so many bytes have come (or time is up)."""
    end, data = time.monotonic() + timeout_s, b""
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

    def saw(self, kind: EventKind, times: int = 1, timeout_s: float = 5.0) -> bool:
        return wait_until(lambda: self.kinds.count(kind) >= times, timeout_s)

    def got(self, data: bytes, timeout_s: float = 5.0) -> bool:
        return wait_until(lambda: self.data.endswith(data), timeout_s)


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
                    client.settimeout(5.0)
                    serve(client)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            stopping.set()
            thread.join()
