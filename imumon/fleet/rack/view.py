"""The shared view of a rack: a page with all units, behind it each unit's live view as a tab.

Run as ``python -m imumon.fleet.rack.view``, as the view process that `imumon.view.publisher` feeds.
"""

import math
import os
import re
import time
from collections.abc import Iterable
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from imumon.view.blueprint import arranged
from imumon.view.child import run
from imumon.view.fed import serve
from imumon.view.items import ViewItem, ViewSetup, merge
from imumon.view.lanes import lane_path
from imumon.view.logger import StreamLogger
from imumon.view.publisher import Report
from imumon.view.rows import at_instants, log_markdown
from imumon.view.window import Window

from .feed import OfUnit, Overview

OVERVIEW = "/overview"
ARRANGE_S = 10.0
"""The arrangement is sent so often at the most: it leads whoever looks on back to the page."""
BEHIND = 10
"""The processes of the units come before the view (and a viewer that draws by software)."""


class UnitsLogger:
    """Logs the items of several units to one recording stream; used as a `StreamLogger`."""

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup) -> None:
        self._rec, self._setup = rec, setup
        self._units: dict[str, tuple[ViewSetup, StreamLogger]] = {}
        self._order: tuple[str, ...] = ()
        """Names of the units on the page."""
        self.arrangement: rrb.Blueprint | None = None
        """The one that was shown last."""
        self._sent: list[rrb.Blueprint] = []
        self._sent_s = -math.inf

    def begin(self) -> None:
        """Log what does not change."""
        self._rec.send_recording_name(self._setup.title)

    def log(self, items: Iterable[ViewItem]) -> None:
        """Log items, those of each unit in their order."""
        found: dict[str, list[ViewItem]] = {}
        for item in items:
            if isinstance(item, OfUnit):
                self._meet(item.setup)
                found.setdefault(item.setup.title, []).append(item.item)
            elif isinstance(item, Overview):
                self._order = item.units
                log_markdown(self._rec, OVERVIEW, [item.markdown], at_instants(item.at))
                for unit in self._units.keys() - set(item.units):
                    del self._units[unit]
        for unit, own in found.items():
            self._units[unit][1].log(merge(own))
        if time.monotonic() - self._sent_s > ARRANGE_S:
            self._arrange()

    def repeat(self) -> None:
        """Log the latest states of all units once more, for who takes the newest first."""
        for _, logger in self._units.values():
            logger.repeat()

    def finish(self) -> None:
        """Log how it was at the end."""
        for _, logger in self._units.values():
            logger.finish()
        self._arrange()

    def _meet(self, setup: ViewSetup) -> None:
        """Begin with a unit that is new, or that has begun anew with another device."""
        known = self._units.get(setup.title)
        if known is None or known[0] != setup:
            below: Any = Below(self._rec, f"/{setup.title}")
            here = setup._replace(window_s=self._setup.window_s, step_ns=self._setup.step_ns)
            logger = StreamLogger(below, here, live=True)
            logger.declare()
            self._units[setup.title] = setup, logger

    def _arrange(self) -> None:
        """Send the arrangement when that of a unit has changed, or which units there are."""
        loggers = [self._units[unit][1] for unit in self._order if unit in self._units]
        arrangements = [logger.arrangement for logger in loggers if logger.arrangement is not None]
        if arrangements == self._sent:
            return
        self._sent, self._sent_s = arrangements, time.monotonic()
        window = Window(self._setup.window_s)
        states = rrb.StateTimelineView(
            origin="/",
            contents=[f"/{unit}{lane_path(lane)}" for unit in self._units for lane in ("port", "unit")],
            name="Ports and processes",
            time_ranges=window.ranges,
            time_view=window.axis,
        )
        page = rrb.Vertical(rrb.TextDocumentView(origin=OVERVIEW, name="Units"), states, name="Rack")
        tabs = (arrangement.root_container for arrangement in arrangements)
        # The clocks of devices have nothing in common but that of the computer.
        self.arrangement = arranged(rrb.Tabs(page, *tabs), "host_time")
        self._rec.send_blueprint(self.arrangement)


class Below:
    """A recording stream as `StreamLogger` uses it, with all entities below one."""

    def __init__(self, rec: rr.RecordingStream, root: str) -> None:
        self._rec, self._root = rec, root

    def log(self, path: str, *what: Any, static: bool = False) -> None:
        """Log below the root."""
        self._rec.log(self._root + path, *what, static=static)

    def send_columns(self, path: str, *, indexes: Any, columns: Any) -> None:
        """Log columns below the root."""
        self._rec.send_columns(self._root + path, indexes=indexes, columns=columns)

    def send_blueprint(self, whole: rrb.Blueprint) -> None:
        """Let the arrangement show what is below the root, as a tab with the name of the unit."""
        whole.root_container.name = self._root.removeprefix("/")
        _move(whole.root_container, self._root)


def _move(part: Any, root: str) -> None:
    """Let the views of an arrangement show the entities below another root."""
    if isinstance(part, rrb.Container):
        for inner in part.contents:
            _move(inner, root)
        return
    part.origin = root if part.origin == "/" else f"{root}{part.origin}"
    if not isinstance(part.contents, str):
        part.contents = [re.sub("^/", f"{root}/", path) for path in part.contents]
    part.visualizer_overrides = {f"{root}{path}": look for path, look in part.visualizer_overrides.items()}


if __name__ == "__main__":
    os.nice(BEHIND)
    serve(lambda stream, out: run(stream, out, UnitsLogger), lambda error: Report(error.seen))
