"""The view in a terminal: present values, states and the log."""

from collections import deque
from collections.abc import Sequence
from textwrap import wrap

import numpy as np

from imumon.harmless import for_log

from .cards import AXES, cell, rows_of
from .items import DropOldestQueue, Log, Numbers, Samples, State, Times, ViewSetup, merge
from .lanes import dated, states_text
from .panels import ShownPanels
from .rows import Rows

NO_TIMES = Times(None, None, None)
NAME, CELL = 18, 15
"""Columns of text that the parts of a row take."""


class TerminalView:
    """Gathers view items, and makes the lines of a screen of some size from them.

    `publish` may be called from any thread and returns at once; `lines` from one thread.
    """

    def __init__(self, setup: ViewSetup) -> None:
        self._setup = setup
        self._queue = DropOldestQueue(4 << 20)
        self.publish = self._queue.put
        self._panels = ShownPanels(setup)
        self._lanes: dict[str, str] = {}
        self._log: deque[str] = deque(maxlen=100)

    def lines(self, columns: int, rows: int, status: str) -> list[str]:
        """Return the text of a screen of so many columns, at most so many rows."""
        for item in merge(self._queue.take(0.0, 0.0)):
            if isinstance(item, Samples):
                self._panels.take(Rows(item.block.columns, NO_TIMES))
            elif isinstance(item, Numbers):
                numbers = {name: np.array([value]) for name, value in item.values.items()}
                self._panels.take(Rows(numbers, NO_TIMES))
            elif isinstance(item, State):
                self._lanes[item.lane] = item.state
            elif isinstance(item, Log):
                self._log.append(dated(item))
        now = self._panels.cards.take()
        readings = [one for found in self._panels.readings.values() for one in found]
        values = [
            f"{label:{NAME}}{''.join(f'{cell(one, now):>{CELL}}' for one in found)} {found[0].unit}"
            for label, found in rows_of(readings, beside=columns >= NAME + len(AXES) * CELL)
        ]
        head = f"{self._setup.title}  {status}"
        states = [*wrap(states_text(self._lanes), columns), ""]
        spare = rows - 1 - len(values)  # in a small window numbers come before all else
        found = [head if len(head) <= columns else status, *states[: max(0, spare)], *values]
        room = rows - len(found) - 1
        if room > 0:
            log = [part for line in self._log for part in wrap(line, columns, subsequent_indent="  ")]
            found += ["", *log[-room:]]
        return found[:rows]


OWN_SCREEN, GIVEN_BACK = "\x1b[?1049h\x1b[?25l", "\x1b[?25h\x1b[?1049l"
"""Begin and end a screen of its own, without a cursor; the terminal is then as it was."""


def drawn(lines: Sequence[str], columns: int, rows: int) -> str:
    """Return what fills a terminal of this size with these lines, whatever it showed before."""
    shown = [for_log(line).replace("\t", " ")[:columns] for line in lines[:rows]]
    return "\x1b[H" + "\r\n".join(f"\x1b[K{line}" for line in [*shown, *[""] * (rows - len(shown))])
