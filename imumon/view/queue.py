"""A bounded queue that never makes the producer wait: when it is full the oldest goes, and is counted."""

from __future__ import annotations

import threading
import time
from collections import deque

from imumon.view.items import ViewItem


class DropOldestQueue:
    """View items in order, at the most `max_bytes` of them.

    States and the status card outlive their place in the queue: the latest of each that had to be dropped is
    handed out with the next batch, so that a lane never stays wrong.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._items: deque[ViewItem] = deque()
        self._lasting: dict[str, ViewItem] = {}
        self._bytes = 0
        self.closed = threading.Event()
        """Set once `close` was called."""
        self._taken_s = time.monotonic()
        self._filled = threading.Condition()
        self.dropped = 0
        """Samples and events dropped so far."""

    def put(self, item: ViewItem) -> None:
        """Append an item; drop the oldest ones when that is too much."""
        with self._filled:
            was_empty = not self._items
            self._items.append(item)
            self._bytes += item.nbytes
            while self._bytes > self._max_bytes:
                oldest = self._items.popleft()
                self._bytes -= oldest.nbytes
                if oldest.lasting is not None:
                    self._lasting[oldest.lasting] = oldest
                else:
                    self.dropped += oldest.rows
            if was_empty:
                self._filled.notify()

    def take(self, apart_s: float, wait_s: float) -> list[ViewItem]:
        """Return all items, `apart_s` after the last ones or later; an empty list after `wait_s` without any.

        When the queue is closed, what is left is returned at once.
        """
        with self._filled:
            self._filled.wait_for(lambda: self._items or self.closed.is_set(), wait_s)
            if not self._items:
                return []
        self.closed.wait(self._taken_s + apart_s - time.monotonic())
        with self._filled:
            self._taken_s = time.monotonic()
            items = [*self._lasting.values(), *self._items]
            self._lasting.clear()
            self._items.clear()
            self._bytes = 0
            return items

    def close(self) -> None:
        """End all waiting."""
        self.closed.set()
        with self._filled:
            self._filled.notify_all()
