"""Live samples for other programs: as messages of named values, and the process that sends them.

Names and units of the values are those of `imumon.columns`; a value that is not there has no name in the
message.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT
from imumon.protocols.base import MAIN
from imumon.view.fed import FedProcess
from imumon.view.items import Log, Samples, State, ViewItem, ViewSetup

from .target import Target

CLOCKS = ("host_time_ns", "arrival_time_ns")
"""The first that a row has is the time of its message, Unix time in ns."""
STATE, LOG = "state", "log"
Value = float | int | str


Message = tuple[str, int | None, Mapping[str, Value]]
"""Of one moment: topic (the stream, `STATE` or `LOG`), Unix time, and values by name."""
Published = Samples | State | Log
"""Those items of the view that are for other programs, too."""


def messages(items: Sequence[Published], states: dict[str, Value]) -> Iterator[Message]:
    """Yield the messages of items in their order.

    `states` are kept up to date, by lane: every message of a state has all, for who came later.
    """
    for item in items:
        if isinstance(item, Samples):
            yield from _rows(item)
        elif isinstance(item, State):
            states[item.lane] = item.state
            yield STATE, item.at.host_ns, dict(states)
        else:
            yield LOG, item.at.host_ns, {"level": item.level, "text": item.text}


def _rows(item: Samples) -> Iterator[Message]:
    columns: dict[str, list[Value | None]] = {}
    if item.times.sample is not None:
        columns["sample"] = item.times.sample.tolist()
    for name, values in item.block.columns.items():
        known = np.isfinite(values) if values.dtype == np.float64 else values != NO_INT
        columns[name] = np.where(known, values.astype(object), np.array(None)).tolist()
    for row in zip(*columns.values(), strict=True):
        there = {name: value for name, value in zip(columns, row, strict=True) if value is not None}
        times = (int(there[clock]) for clock in CLOCKS if clock in there)
        yield item.stream or MAIN, next(times, None), there


class Delivery(NamedTuple):
    """How it goes, and how many samples and events were sent, and how many were not.

    In reports of the publishing process the latter are those that the system did not take.
    """

    text: str  # one phrase
    ready: bool = True  # whether the receiver can be reached, as far as is known
    sent: int = 0
    dropped: int = 0  # also those that the queue was full for, or that the process which sends did not take


class Publisher(FedProcess):
    """Feeds a process that publishes what is measured; nothing that happens there delays the caller."""

    def __init__(self, target: Target, setup: ViewSetup) -> None:
        super().__init__("imumon.publishing.child")
        self.target = target
        self._setup = setup
        self._published = self._handed_rows = 0
        self._sent = self._lost = 0  # what processes that ended have sent, and what was lost with them
        self._now = Delivery("begins", ready=False)  # what the present process reports

    def publish(self, item: ViewItem) -> None:
        """Queue an item, when it is for other programs; takes microseconds.  Called from one thread."""
        if isinstance(item, Published):
            self._published += item.rows
            super().publish(item)

    @property
    def state(self) -> Delivery:
        """How it goes now; after `close` all that has not left is dropped."""
        now, sent = self._now, self._sent + self._now.sent
        closed = self._queue.closed.is_set() and not self._supervisor.is_alive()
        dropped = self._published - sent if closed else self.dropped + self._lost + now.dropped
        return now._replace(sent=sent, dropped=dropped)

    def _first(self) -> tuple[Target, ViewSetup]:
        if self.restarts:  # what waited for the process is not news any more
            self._handed(self._queue.take(0.0, 0.0))
        self._lost = self._handed_rows - self._sent
        return self.target, self._setup

    def _handed(self, items: Sequence[ViewItem]) -> None:
        self._handed_rows += sum(item.rows for item in items)

    def _received(self, message: Delivery) -> None:
        self._now = message

    def _gone(self) -> None:
        now = self._now
        text = "ended" if self._queue.closed.is_set() else "begins again" if now.ready else now.text
        self._sent += now.sent
        self._now = Delivery(text, ready=False)


class Publishers:
    """Everything that --publish starts, while a command runs."""

    def __init__(self, publishers: Sequence[Publisher]) -> None:
        self._publishers = publishers
        self._reported: dict[Target, str] = {}

    @property
    def _states(self) -> list[tuple[Target, Delivery]]:
        return [(one.target, one.state) for one in self._publishers]

    @property
    def publish(self) -> list[Callable[[ViewItem], None]]:
        """Where view items go."""
        return [one.publish for one in self._publishers]

    @property
    def text(self) -> str:
        """The part of a status line: where it goes, and how much of it was dropped."""
        return "".join(
            f"  {to.kind}: " + (f"{of.sent:,} sent, {of.dropped:,} dropped" if of.ready else of.text)
            for to, of in self._states
        )

    @property
    def as_data(self) -> dict[str, object]:
        """What the command reports with --json."""
        return {
            "published": [{"to": str(to), "sent": of.sent, "dropped": of.dropped} for to, of in self._states]
        }

    @property
    def rows(self) -> dict[str, str]:
        """The row of the summary."""
        texts = [f"{to}: {of.sent:,} sent, {of.dropped:,} dropped" for to, of in self._states]
        return {"published": "; ".join(texts)} if texts else {}

    def announce(self, report: Callable[[str, str], None]) -> None:
        """Report how it goes, when that changes, and when the first is dropped."""
        for target, state in self._states:
            text = f"{target}: {state.text}" + (", some are dropped" if state.dropped else "")
            if text != self._reported.get(target, ""):
                self._reported[target] = text
                report("INFO" if state.ready and not state.dropped else "WARN", f"published to {text}")

    def close(self) -> None:
        """Send what is left, and end."""
        for one in self._publishers:
            one.close()
