"""Live samples to other programs, as the measuring process sees it: publish and go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from imumon.publishing.messages import is_published
from imumon.publishing.target import Target
from imumon.view.fed import FedProcess
from imumon.view.items import ViewItem, ViewSetup


@dataclass(frozen=True, slots=True)
class Delivery:
    """How it goes, and how many samples and events left this computer's program, and how many did not.

    What the publishing process says has what it took and what the system did not take of it.
    """

    text: str
    """One phrase."""
    ready: bool = True
    """Whether the receiver can be reached, as far as is known."""
    sent: int = 0
    dropped: int = 0
    """Also those that the queue was full for, or that the process which sends did not take."""


class Publisher(FedProcess):
    """Feeds a process that publishes what is measured; nothing that happens there delays the caller.

    Parameters
    ----------
    target : Target
        To whom.
    setup : ViewSetup
        Title, units and frame.
    """

    def __init__(self, target: Target, setup: ViewSetup) -> None:
        super().__init__("imumon.publishing.child")
        self.target = target
        self._setup = setup
        self._published = self._handed_rows = self._lost = 0
        self._closed = False
        self._before, self._now = Delivery(""), Delivery("begins", ready=False)
        """What processes that ended have said together, and what the present one says."""

    def start(self) -> Publisher:
        """Start the process and return at once."""
        self._supervisor.start()
        return self

    def publish(self, item: ViewItem) -> None:
        """Queue an item, when it is for other programs; takes microseconds.  Called from one thread."""
        if is_published(item):
            self._published += item.rows
            super().publish(item)

    def close(self, timeout_s: float = 1.5) -> None:
        """Send what is left and end the process, within `timeout_s`; what has not left by then is dropped."""
        super().close(timeout_s)
        self._closed = True

    @property
    def state(self) -> Delivery:
        """How it goes now."""
        before, now = self._before, self._now
        sent = before.sent + now.sent
        failed = before.dropped + now.dropped
        dropped = self._published - sent if self._closed else self._queue.dropped + self._lost + failed
        return replace(now, sent=sent, dropped=dropped)

    def _first(self) -> tuple[Target, ViewSetup]:
        if self._restarts:  # what waited for the process is not news any more
            self._handed(self._queue.take(0.0, 0.0))
        self._count_lost()
        return self.target, self._setup

    def _handed(self, items: Sequence[ViewItem]) -> None:
        self._handed_rows += sum(item.rows for item in items)

    def _received(self, message: Delivery) -> None:
        self._now = message

    def _gone(self) -> None:
        before, now = self._before, self._now
        self._before = Delivery("", sent=before.sent + now.sent, dropped=before.dropped + now.dropped)
        text = "ended" if self._queue.closed.is_set() else "begins again" if now.ready else now.text
        self._now = Delivery(text, ready=False)
        self._count_lost()

    def _count_lost(self) -> None:
        """What no process took until now is lost."""
        self._lost = self._handed_rows - self._before.sent - self._before.dropped
