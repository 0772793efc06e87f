"""What is published, as messages of named values: rows of samples, states, log lines.

Names and units are those of `imumon.columns`; a value that is not there has no name in the message.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray
from imumon.protocols.base import MAIN
from imumon.view.items import Log, Samples, State, ViewItem

CLOCKS = ("host_time_ns", "arrival_time_ns")
"""The first that a row has is the time of its message, Unix time in ns."""
STATE, LOG = "state", "log"
Value = float | int | str


@dataclass(frozen=True, slots=True)
class Message:
    """Values of one moment."""

    topic: str
    """The stream (`MAIN`, "gnss", ...), `STATE` or `LOG`."""
    time_ns: int | None
    """Unix time."""
    values: Mapping[str, Value]


Published = Samples | State | Log


def is_published(item: ViewItem) -> bool:
    """Return whether an item of the view is for other programs, too."""
    return isinstance(item, Samples | State | Log)


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
    topic, columns = topic_of(item), dict[str, list[Value | None]]()
    if item.first is not None:
        columns["sample"] = [*range(item.first, item.first + item.rows)]
    for name, values in item.block.columns.items():
        if (known := _known(values)).any():
            listed: list[Value | None] = values.tolist()
            for absent in np.flatnonzero(~known).tolist():
                listed[absent] = None
            columns[name] = listed
    names = list(columns)
    for row in zip(*columns.values(), strict=True):
        known_of = {name: value for name, value in zip(names, row, strict=True) if value is not None}
        yield Message(topic, _time_ns(known_of), known_of)


def _known(values: ColumnArray) -> BoolArray:
    return np.asarray(np.isfinite(values) if values.dtype == np.float64 else values != NO_INT)


def _time_ns(values: Mapping[str, Value]) -> int | None:
    found = next((values[clock] for clock in CLOCKS if clock in values), None)
    return None if found is None else int(found)
