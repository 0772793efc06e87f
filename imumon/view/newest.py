"""The newest state of every lane and the newest log lines, as a text that waits for no picture.

A browser that draws by software takes in less than comes, and its picture falls behind by minutes: what
matters most goes to the page beside it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

from imumon.view.items import Log, OfUnit, Shown, State
from imumon.view.lanes import NAMES
from imumon.view.log_text import dated

LOG_LINES = 2
OF_UNITS = ("port", "unit")
"""Lanes that are told of each of several units: all of them would be a page."""


class Newest:
    """Gathers states and log lines from view items."""

    def __init__(self) -> None:
        self._states: dict[str, str] = {}
        self._log: deque[str] = deque(maxlen=LOG_LINES)

    @property
    def lines(self) -> list[str]:
        """The states in one line, then the log lines, the newest first."""
        return [text for text in (states_text(self._states), *self._log) if text]

    def add(self, items: Iterable[Shown]) -> None:
        """Take items, in their order."""
        for shown in items:
            if isinstance(shown, OfUnit):
                if not isinstance(shown.item, State) or shown.item.lane in OF_UNITS:
                    self._take(f"{shown.setup.title} ", shown.item)
            else:
                self._take("", shown)

    def _take(self, unit: str, item: Shown) -> None:
        if isinstance(item, State):
            self._states[f"{unit}{item.lane}"] = item.state
        elif isinstance(item, Log):
            self._log.appendleft(f"{unit}{dated(item)}")


def states_text(states: Mapping[str, str]) -> str:
    """Return the state of every lane, in the order and under the names that a person knows."""
    order = {name: at for at, name in enumerate(NAMES)}
    lanes = sorted(states.items(), key=lambda item: order.get(item[0], len(order)))
    return "  ".join(f"{NAMES.get(lane, lane)} {state}" for lane, state in lanes)
