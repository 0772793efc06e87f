"""Turns view items into Rerun calls; the same code writes the live stream and the recording."""

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

from .blueprint import Contents, blueprint
from .items import Drawing, Event, Log, Numbers, Samples, State, Status, ViewItem, ViewSetup
from .lanes import COLORED_STATES, LINES, LOG_TEXT, declare_lane, lane_path, lane_place, markdown
from .layout import DEVICE
from .panels import PanelLog
from .pictures import Painter
from .rows import Rows, at_instants, log_markdown
from .window import slow_window

RECORDED_STEP_NS = 500_000_000
"""Of so much time a recording of the view keeps the extremes."""
ARRANGE_S = 5.0
"""Live, the arrangement is sent so often at the most: it leads whoever looks on back to the first tab."""


class StreamLogger:
    """Logs view items to one recording stream.

    Call `begin` at the start and in each new file, then `log`.  Entities, styles and arrangement follow from
    the columns that come.

    The sinks of `rec` are the caller's business.  With `live` the blueprint follows the last seconds, else it
    shows all of a recording.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool) -> None:
        self._rec, self._setup, self._live = rec, setup, live
        self._panels = PanelLog(rec, setup, live=live)
        self.end_file = self._panels.end_file  # logs what a file of a recording has at its end
        self._painter = Painter(rec, live=live)
        self._lanes: dict[str, dict[str, Level]] = {}
        self._lasting: dict[str, Event] = {}
        self._lines: deque[str] = deque(maxlen=LINES)  # the newest log lines, the last one first
        self._timeline = "host_time"
        self._arranged: tuple[Contents, str] | None = None
        self._arranged_s = -math.inf
        self.arrangement: rrb.Blueprint | None = None  # the one that was shown last
        self._last_ns: dict[str, int] = {}
        self._began: Rows | None = None  # time of the first sample
        self._newest: Rows | None = None  # of the latest
        self._step_ns = setup.step_ns if live else RECORDED_STEP_NS

    def begin(self) -> None:
        """Log what does not change (name, styles), and the latest states."""
        self._rec.send_recording_name(self._setup.title)
        self.declare()

    def declare(self) -> None:
        """Log the styles, and the latest states."""
        axes = rr.ViewCoordinates
        up = axes.RIGHT_HAND_Z_DOWN if self._setup.z_down else axes.RIGHT_HAND_Z_UP
        self._rec.log(DEVICE, up, static=True)
        self._panels.declare()
        for lane, states in self._lanes.items():
            declare_lane(self._rec, lane, states)
        self._log_events([*self._lasting.values()])

    def log(self, items: Iterable[ViewItem]) -> None:
        """Log items, samples in batches as they come; join them with `items.merge` first."""
        events: list[Event] = []
        for item in items:
            if isinstance(item, Samples):
                self._log_samples(item)
            elif isinstance(item, Drawing):
                self._painter.add(item)
            elif isinstance(item, Event):
                events.append(self._placed(item))
        self._log_events(events)
        if self._newest is not None:
            self._panels.log_cards(self._newest)
        self._painter.draw_next()
        if not self._live or time.monotonic() - self._arranged_s > ARRANGE_S:
            self._arrange()

    def _log_samples(self, item: Samples) -> None:
        rows = Rows(
            item.block.columns, item.times, self._step_ns, self._last_ns.get(item.stream), item.stream
        )
        if rows.clock is not None:
            self._last_ns[item.stream] = int(rows.clock[-1])
        if item.times.device_ns is not None:
            self._timeline = "device_time"
        elif item.times.host_ns is None and self._timeline == "host_time":
            self._timeline = "sample"
        if not item.stream:
            if self._began is None:
                self._began = self._newest = rows.kept(np.array([0]))
                self._lasting = {name: self._placed(event) for name, event in self._lasting.items()}
                self.repeat()
            self._newest = rows.kept(np.array([item.rows - 1]))
        self._panels.log(rows)

    def _placed(self, event: Event) -> Event:
        """Return an event of before the first sample as it is on the timelines that begin with that."""
        if self._began is None or event.at.sample is not None:
            return event
        began, host_ns = self._began.times.at(0), event.at.host_ns
        device_ns = began.device_ns
        if device_ns is not None and began.host_ns is not None and host_ns is not None:
            device_ns -= max(0, began.host_ns - host_ns)
        return replace(event, at=began._replace(device_ns=device_ns, host_ns=host_ns))

    def _log_events(self, events: Sequence[Event]) -> None:
        """Log events, those of a kind together: a chunk costs 2 kB, whatever is in it."""
        kinds: dict[tuple[object, ...], list[Any]] = {}
        for event in events:
            alike = type(event), event.lasting, *(time is None for time in event.at)
            kinds.setdefault(alike, []).append(event)
            if event.lasting is not None:
                self._lasting[event.lasting] = event
        for found in kinds.values():
            times = at_instants(*(event.at for event in found))
            if isinstance(found[0], Log):
                texts = []
                for line in found:
                    self._lines.appendleft(markdown(line))
                    texts.append("\n\n".join(self._lines))
                if times.indexes:
                    log_markdown(self._rec, LOG_TEXT, texts, times)
            elif times.indexes:
                self._log_kind(found, times)

    def _log_kind(self, events: list[Any], times: Rows) -> None:
        """Log numbers, the states of a lane, or the status card."""
        first = events[0]
        if isinstance(first, Numbers):
            values = {name: np.array([event.values[name] for event in events]) for name in first.values}
            self._panels.log(replace(times, columns=values, step_ns=self._step_ns))
        elif isinstance(first, State):
            known = self._lanes.setdefault(first.lane, {})
            new = {event.state: event.level for event in events if event.state not in known}
            if new and len(known) < COLORED_STATES:
                known |= new
                declare_lane(self._rec, first.lane, known)
            change = rr.StateChange.columns(state=[event.state for event in events])
            self._rec.send_columns(lane_path(first.lane), indexes=times.indexes, columns=change)
        elif isinstance(first, Status):
            log_markdown(self._rec, "/status", [status_card(events[-1])], at_instants(events[-1].at))

    def finish(self) -> None:
        """Log the charts as they are at the end."""
        self.end_file()
        self._painter.finish()
        self._arrange()

    def repeat(self) -> None:
        """Log the latest states, status card and log lines once more, for who takes the newest first."""
        if self._newest is None:
            return
        self._log_events([*self._lasting.values()])
        if self._lines:
            log_markdown(self._rec, LOG_TEXT, ["\n\n".join(self._lines)], self._newest)

    def _arrange(self) -> None:
        """Send the blueprint when what there is to see has changed."""
        first = None if self._began is None else self._began.clock
        age_ns = 0 if first is None else self._last_ns[""] - int(first[0])
        contents = Contents(
            panels=self._panels.shown,
            charts=tuple(self._painter.titles.values()),
            lanes=tuple(map(lane_path, sorted(self._lanes, key=lane_place))),
            log=bool(self._lines),
            status="status" in self._lasting,
            full=self._live and age_ns > 1e9 * slow_window(self._setup.window_s),
        )
        if any(contents) and (contents, self._timeline) != self._arranged:
            self._arranged, self._arranged_s = (contents, self._timeline), time.monotonic()
            self.arrangement = blueprint(self._setup, contents, self._timeline, live=self._live)
            self._rec.send_blueprint(self.arrangement)


def status_card(event: Status) -> str:
    """Return the status card as a compact Markdown table."""
    rows = [f"| **{for_markdown(name)}** | {for_markdown(value)} |" for name, value in event.fields.items()]
    return "\n".join(["| | |", "|:--|:--|", *rows])
