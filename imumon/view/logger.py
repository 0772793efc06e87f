"""Turns view items into Rerun calls; the same code writes the live stream and the recording."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from imumon.harmless import for_markdown
from imumon.lane import Level
from imumon.view.blueprint import Contents, blueprint
from imumon.view.items import (
    Drawing,
    Event,
    Instant,
    Log,
    Numbers,
    Samples,
    State,
    Status,
    ViewItem,
    ViewSetup,
)
from imumon.view.lanes import COLORED_STATES, LINES, LOG_TEXT, declare_lane, lane_path, lane_place, markdown
from imumon.view.layout import DEVICE
from imumon.view.panel_log import Others, PanelLog
from imumon.view.pictures import Painter
from imumon.view.rows import Rows, at_instants, log_markdown
from imumon.view.window import slow_window

RECORDED_STEP_NS = 500_000_000
"""Of so much time a recording of the view keeps the extremes."""
ARRANGE_S = 5.0
"""Live, the arrangement is sent so often at the most: it leads whoever looks on back to the first tab."""
EARLY_EVENTS = 1000
"""Events before the first sample that are shown again on the timelines that begin with it."""


class StreamLogger:
    """Logs view items to one recording stream.

    Call `begin` at the start and in each new file, then `log`.  Entities, styles and arrangement follow from
    the columns that come.

    The sinks of `rec` are the caller's business.  With `live` the blueprint follows the last seconds, else it
    shows all of a recording.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool) -> None:
        self._rec, self._setup, self._live = rec, setup, live
        self._panels, self._others = PanelLog(rec, setup, live=live), Others(rec, setup)
        self._painter = Painter(rec, live=live)
        self._lanes: dict[str, dict[str, Level]] = {}
        self._lasting: dict[str, Event] = {}
        self._early: list[Event] = []
        self._has_log = False
        self._lines: deque[str] = deque(maxlen=LINES)
        """The newest log lines, the last one first."""
        self._timeline = "host_time"
        self._arranged: tuple[Contents, str] | None = None
        self._arranged_s = -math.inf
        self.arrangement: rrb.Blueprint | None = None
        """The one that was shown last."""
        self._last_ns: dict[str, int] = {}
        self._newest: Rows | None = None
        self._began_ns: int | None = None
        self._step_ns = 0 if live else RECORDED_STEP_NS

    def begin(self) -> None:
        """Log what does not change (name, properties, styles), and the latest states."""
        name_recording(self._rec, self._setup, "session")
        self.declare()

    def declare(self) -> None:
        """Log the styles, and the latest states."""
        axes = rr.ViewCoordinates
        up = axes.RIGHT_HAND_Z_DOWN if self._setup.z_down else axes.RIGHT_HAND_Z_UP
        self._rec.log(DEVICE, up, static=True)
        self._panels.declare()
        self._others.declare()
        for lane, states in self._lanes.items():
            declare_lane(self._rec, lane, states)
        self._log_events(list(self._lasting.values()), again=True)

    def log(self, items: Iterable[ViewItem]) -> None:
        """Log items, samples in batches as they come; join them with `items.merge` first."""
        events: list[Event] = []
        for item in items:
            if isinstance(item, Samples):
                self._log_samples(item)
            elif isinstance(item, Event):
                events.append(item)
        self._log_events(events)
        self._early += [event for event in events if event.at.sample is None]
        del self._early[EARLY_EVENTS:]
        if self._newest is not None:
            self._panels.log_cards(self._newest)
        self._painter.draw_next()
        if not self._live or time.monotonic() - self._arranged_s > ARRANGE_S:
            self._arrange()

    def _log_samples(self, item: Samples) -> None:
        count = None if item.first is None else np.arange(item.first, item.first + item.rows, dtype=np.int64)
        before_ns = self._last_ns.get(item.stream)
        rows = Rows(item.block.columns, count, item.device_ns, item.host_ns, self._step_ns, before_ns)
        if rows.clock is not None and len(rows.clock):
            self._last_ns[item.stream] = int(rows.clock[-1])
        if item.device_ns is not None:
            self._timeline = "device_time"
        elif item.host_ns is None and self._timeline == "host_time":
            self._timeline = "sample"
        if self._early and item.first is not None:
            self._log_early_events(item)
        if not item.stream and item.rows:
            self._newest = rows.kept(np.array([item.rows - 1]))
            if self._began_ns is None and rows.clock is not None:
                self._began_ns = int(rows.clock[0])
        self._log_floats(rows, item.stream)

    def _log_floats(self, rows: Rows, stream: str = "") -> None:
        claimed = self._panels.log(rows)
        for name, values in rows.columns.items():
            if values.dtype == np.float64 and name not in claimed:
                own = name.removeprefix(f"{stream}_")
                self._others.log(f"{stream}/{own}" if stream else name, values, rows)

    def _log_early_events(self, first: Samples) -> None:
        """Show the events before the first sample on the timelines that begin with it."""
        moved: list[Event] = []
        for event in self._early:
            device = None if first.device_ns is None else int(first.device_ns[0])
            if device is not None and first.host_ns is not None and event.at.host_ns is not None:
                device -= max(0, int(first.host_ns[0]) - event.at.host_ns)
            moved.append(replace(event, at=Instant(first.first, device, None)))
            if event.lasting is not None and self._lasting[event.lasting] is event:
                self._lasting[event.lasting] = moved[-1]
        self._early.clear()
        self._log_events(moved, again=True)

    def _log_events(self, events: Sequence[Event], *, again: bool = False) -> None:
        """Log events, those of a kind together: a chunk costs 2 kB, whatever is in it.

        What is shown `again` has its place among the newest lines, and in time, already.
        """
        kinds: dict[tuple[object, ...], list[Any]] = {}
        for event in events:
            kinds.setdefault(_kind_of(event), []).append(event)
            if event.lasting is not None and not again:
                self._lasting[event.lasting] = event
            if isinstance(event, Drawing) and not again:
                self._painter.add(event)
        for found in kinds.values():
            times = at_instants(*(event.at for event in found))
            if isinstance(found[0], Log):
                self._log_lines(found, times, again=again)
            elif times.indexes:
                self._log_kind(found, times)

    def _log_lines(self, lines: Sequence[Log], times: Rows, *, again: bool) -> None:
        texts = []
        for line in lines:
            if not again:
                self._lines.appendleft(markdown(line))
            texts.append("\n\n".join(self._lines))
        if times.indexes:
            self._has_log = True
            log_markdown(self._rec, LOG_TEXT, texts, times)

    def _log_kind(self, events: list[Any], times: Rows) -> None:
        """Log numbers, the states of a lane, or the status card."""
        first = events[0]
        if isinstance(first, Numbers):
            values = {name: np.array([event.values[name] for event in events]) for name in first.values}
            self._log_floats(Rows(values, times.sample, times.device_ns, times.host_ns, self._step_ns))
        elif isinstance(first, State):
            self._color_states(events)
            change = rr.StateChange.columns(state=[event.state for event in events])
            self._rec.send_columns(lane_path(first.lane), indexes=times.indexes, columns=change)
        elif isinstance(first, Status):
            log_markdown(self._rec, "/status", [status_card(events[-1])], at_instants(events[-1].at))

    def _color_states(self, events: Sequence[State]) -> None:
        """Declare the colours of a lane anew where it has states that it had not."""
        lane = events[0].lane
        known = self._lanes.get(lane, {})
        levels = known | {event.state: event.level for event in events if event.state not in known}
        if len(levels) > len(known) and len(known) < COLORED_STATES:
            self._lanes[lane] = levels
            declare_lane(self._rec, lane, levels)

    def end_file(self) -> None:
        """Log what a file of a recording has at its end."""
        self._panels.end_file()

    def finish(self) -> None:
        """Log the charts and the status card as they are at the end."""
        self._panels.end_file()
        self._painter.finish()
        self._log_events([event for event in self._lasting.values() if isinstance(event, Status)])
        self._arrange()

    def repeat(self) -> None:
        """Log the latest states, status card and log lines once more, for who takes the newest first."""
        if self._newest is None:
            return
        self._log_events(list(self._lasting.values()), again=True)
        if self._has_log:
            log_markdown(self._rec, LOG_TEXT, ["\n\n".join(self._lines)], self._newest)

    def _arrange(self) -> None:
        """Send the blueprint when what there is to see has changed."""
        age_ns = 0
        if self._live and self._newest is not None and self._newest.clock is not None:
            age_ns = int(self._newest.clock[0]) - (self._began_ns or 0)
        contents = Contents(
            panels=self._panels.shown,
            charts=tuple(self._painter.titles.values()),
            lanes=tuple(map(lane_path, sorted(self._lanes, key=lane_place))),
            log=self._has_log,
            status="status" in self._lasting,
            others=self._others.views,
            cards=tuple(self._panels.readings()),
            full=age_ns > 1e9 * slow_window(self._setup.window_s),
        )
        if contents and (contents, self._timeline) != self._arranged:
            self._arranged, self._arranged_s = (contents, self._timeline), time.monotonic()
            self.arrangement = blueprint(self._setup, contents, self._timeline, live=self._live)
            self._rec.send_blueprint(self.arrangement)


def name_recording(rec: rr.RecordingStream, setup: ViewSetup, what: str) -> None:
    """Log the name of a recording, and what describes the session, or whatever it is of."""
    rec.send_recording_name(setup.title)
    if setup.properties:
        rec.send_property(what, rr.AnyValues(True, **setup.properties))


def status_card(event: Status) -> str:
    """Return the status card as a compact Markdown table."""
    rows = [f"| **{for_markdown(name)}** | {for_markdown(value)} |" for name, value in event.fields.items()]
    return "\n".join(["| | |", "|:--|:--|", *rows])


def _kind_of(event: Event) -> tuple[object, ...]:
    """Return what events must have in common to be logged together."""
    at = event.at
    what = ",".join(event.values) if isinstance(event, Numbers) else event.lasting
    return type(event), what, at.sample is None, at.device_ns is None, at.host_ns is None
