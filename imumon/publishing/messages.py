"""What is published, as messages of named values: rows of samples, states, log lines.

Names and units are those of `imumon.columns`; a value that is not there has no name in the message.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT
from imumon.protocols.base import MAIN
from imumon.view.items import Log, Samples, State

CLOCKS = ("host_time_ns", "arrival_time_ns")
"""The first that a row has is the time of its message, Unix time in ns."""
STATE, LOG = "state", "log"
Value = float | int | str


class Message(NamedTuple):
    """Values of one moment."""

    topic: str
    """The stream (`MAIN`, "gnss", ...), `STATE` or `LOG`."""
    time_ns: int | None
    """Unix time."""
    values: Mapping[str, Value]


Published = Samples | State | Log
"""Those items of the view that are for other programs, too."""


def topic_of(item: Samples) -> str:
    """Return the topic of samples."""
    return item.stream or MAIN


def messages(items: Sequence[Published], states: dict[str, Value]) -> Iterator[Message]:
    """Yield the messages of items in their order.

    `states` are kept up to date, by lane: every message of a state has all, for who came later.
    """
    for item in items:
        if isinstance(item, Samples):
            yield from _rows(item)
        elif isinstance(item, State):
            states[item.lane] = item.state
            yield Message(STATE, item.at.host_ns, dict(states))
        else:
            yield Message(LOG, item.at.host_ns, {"level": item.level, "text": item.text})


def _rows(item: Samples) -> Iterator[Message]:
    columns: dict[str, list[Value | None]] = {}
    if item.first is not None:
        columns["sample"] = [*range(item.first, item.first + item.rows)]
    for name, values in item.block.columns.items():
        known = np.isfinite(values) if values.dtype == np.float64 else values != NO_INT
        columns[name] = np.where(known, values.astype(object), np.array(None)).tolist()
    for row in zip(*columns.values(), strict=True):
        there = {name: value for name, value in zip(columns, row, strict=True) if value is not None}
        times = (int(there[clock]) for clock in CLOCKS if clock in there)
        yield Message(topic_of(item), next(times, None), there)
