"""Log lines on their way from one thread to another; light, as every command needs them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")
Line = tuple[str, str]
"""Level and text of a line."""


def waiting(queue: SimpleQueue[T]) -> Iterator[T]:
    """Take what waits in a queue, and wait for nothing."""
    with suppress(Empty):
        while True:
            yield queue.get_nowait()


class Lines:
    """Log lines on their way to another thread or process; `put` may be called from any thread."""

    def __init__(self) -> None:
        self._waiting: SimpleQueue[Line] = SimpleQueue()

    def put(self, level: str, text: str) -> None:
        """Take a line; returns at once."""
        self._waiting.put((level, text))

    def take(self) -> list[Line]:
        """Return the lines since the last time."""
        return list(waiting(self._waiting))
