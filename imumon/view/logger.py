"""Turns view items into Rerun calls; the same code writes the live stream and the recording."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.charts import Chart
from imumon.harmless import for_markdown
from imumon.lane import Level
from imumon.view.attitude import DEVICE
from imumon.view.axes import Axes
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
    lasting_key,
)
from imumon.view.lanes import COLORED_STATES, declare_lane, lane_path
from imumon.view.layout import INTEGERS, Rows, at_instants, log_markdown
from imumon.view.log_text import LOG_TEXT, LogText
from imumon.view.others import Others
from imumon.view.painter import Painter, log_picture
from imumon.view.panel_log import PanelLog
from imumon.view.pictures import picture, pictures_apart
from imumon.view.window import slow_window

Show = Callable[[rrb.Blueprint], None]

ELSEWHERE = {"device_time_ns", "host_time_ns", "arrival_time_ns", "device_ticks"}
"""Integer columns that are a timeline, or of the transport: the wire recording has them."""

RECORDED_STEP_NS, STEP_ROWS, LONGEST_STEP_NS = 500_000_000, 50, 2_500_000_000
"""Of so much time a recording of the view keeps the extremes; where fewer samples came in it, of so many, and
never of more time than the last."""
PICTURE_SHARE = 0.03
"""Live, drawing charts takes so much of the time at the most."""
FIRST_PICTURES_S, LATER, PICTURES_S = 30.0, 6.0, 600.0
"""In a recording charts (25 kB each) are drawn after the first time, then when it is so many times as long,
at the latest so long after those before, and as they are at the end; these replace those before."""
NICE = 15
"""While samples come, they come before the charts of a recording."""
EARLY_EVENTS = 1000
"""Events before the first sample that are shown again on the timelines that begin with it."""


class StreamLogger:
    """Logs view items to one recording stream.

    Call `begin` whenever the stream has a new reader (first of all, after a reconnect, in a new file), then
    `log`.  Entities, styles and blueprint follow from the columns that come.

    Parameters
    ----------
    rec : RecordingStream
        Where everything goes; its sinks are the caller's business.
    setup : ViewSetup
        Title, units, frame, window.
    live : bool
        Whether the blueprint follows the last seconds or shows all of a recording.
    show : callable, optional
        Takes the arrangement when it has changed; without, it is sent as a blueprint of its own.
    """

    def __init__(
        self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool, show: Show | None = None
    ) -> None:
        self._rec = rec
        self._show = show or rec.send_blueprint
        self._setup = setup
        self._live = live
        self._axes = Axes(rec, live=live)
        self._panels = PanelLog(rec, setup, self._axes, live=live)
        self._others = Others(rec, setup, self._axes, live=live)
        self._lanes: dict[str, dict[str, Level]] = {}
        self._lasting: dict[str, Event] = {}
        self._charts: dict[str, Chart] = {}
        self._waiting: dict[str, Drawing] = {}
        self._painter = Painter(PICTURE_SHARE)
        self._drawn_s: dict[str, float] = {}
        self._began_s = time.monotonic()
        self._pictures_s = FIRST_PICTURES_S
        self._early: list[Event] = []
        self._has_log = False
        self._timeline = "host_time"
        self._arranged: tuple[Contents, str] | None = None
        self.arrangement: rrb.Blueprint | None = None
        """The one that was shown last."""
        self._last_ns: dict[str, int] = {}
        self._newest: Rows | None = None
        self._began_ns: int | None = None
        self._age_ns = 0
        self._step_ns = 0 if live else RECORDED_STEP_NS
        self._log_text = LogText()

    def begin(self, *, arrange: bool = True) -> None:
        """Log what does not change (name, properties, styles, arrangement), and the latest states.

        Every blueprint costs two threads and 0.9 MB that Rerun 0.41 never gives back; without `arrange` it is
        sent again only when there is something new to arrange.
        """
        rec, setup = self._rec, self._setup
        rec.send_recording_name(setup.title)
        if setup.properties:
            rec.send_property("session", rr.AnyValues(True, **setup.properties))
        down = rr.ViewCoordinates.RIGHT_HAND_Z_DOWN
        rec.log(DEVICE.root, down if setup.z_down else rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._panels.declare()
        self._others.declare()
        for lane, states in self._lanes.items():
            declare_lane(rec, lane, states)
        self._log_events(list(self._lasting.values()), again=True)
        if arrange:
            self._arranged = None
        self._arrange()

    def log(self, items: Iterable[ViewItem]) -> None:
        """Log items, samples in batches as they come; join them with `items.merge` first."""
        events: list[Event] = []
        for item in items:
            if isinstance(item, Samples):
                self._log_samples(item)
            else:
                events.append(item)
        self._log_events(events)
        early = [event for event in events if event.at.sample is None]
        self._early += early[: EARLY_EVENTS - len(self._early)]
        if self._newest is not None:
            self._panels.log_cards(self._newest)
        self._draw_charts()
        self._arrange()

    def _log_samples(self, item: Samples) -> None:
        count = None if item.first is None else np.arange(item.first, item.first + item.rows, dtype=np.int64)
        before_ns = self._last_ns.get(item.stream)
        rows = Rows(item.block.columns, count, item.device_ns, item.host_ns, before_ns=before_ns)
        if not self._live:
            rows = replace(rows, step_ns=recorded_step(rows.clock))
            self._step_ns = self._step_ns if item.stream else rows.step_ns
        if rows.clock is not None and len(rows.clock):
            self._last_ns[item.stream] = int(rows.clock[-1])
        if item.device_ns is not None:
            self._timeline = "device_time"
        elif item.host_ns is None and self._timeline == "host_time":
            self._timeline = "sample"
        if self._early and item.first is not None:
            self._log_early_events(item)
        claimed = self._panels.log(rows)
        if not item.stream:
            self._note(rows)
        self._log_integers(rows, item.stream)
        for name, values in rows.columns.items():
            if values.dtype == np.float64 and name not in claimed:
                own = name.removeprefix(f"{item.stream}_")
                self._others.log(f"{item.stream}/{own}" if item.stream else name, values, rows)

    def _note(self, rows: Rows) -> None:
        """Note how far the data has come: for the cards, and for when the slow tabs are full."""
        if not len(next(iter(rows.columns.values()), ())):
            return
        clock = rows.clock
        last = len(next(iter(rows.columns.values()))) - 1
        self._newest = rows.kept(np.array([last]))
        if clock is not None:
            self._began_ns = int(clock[0]) if self._began_ns is None else self._began_ns
            self._age_ns = max(self._age_ns, int(clock[-1]) - self._began_ns)

    def _log_integers(self, rows: Rows, stream: str) -> None:
        integers = {
            name: values
            for name, values in rows.columns.items()
            if values.dtype == np.int64 and name not in ELSEWHERE and (values != NO_INT).any()
        }
        device = rows.columns.get("device_time_ns")
        if device is not None and not (rows.device_ns is not None and np.array_equal(device, rows.device_ns)):
            integers["device_time_ns"] = device
        if integers:
            if rows.step_ns:
                due = rows.thinned(rows.step_ns)
                if not due.any():
                    return
                integers, rows = {name: values[due] for name, values in integers.items()}, rows.kept(due)
            entity = f"{INTEGERS}/{stream}" if stream else INTEGERS
            # As arrays of Arrow, or Rerun tries what they are in six times the time.
            arrays = {name: pa.array(values) for name, values in integers.items()}
            columns = rr.AnyValues.columns(True, **arrays)
            self._rec.send_columns(entity, indexes=rows.indexes, columns=columns)

    def _log_early_events(self, first: Samples) -> None:
        """Show the events before the first sample on the timelines that begin with it."""
        moved: list[Event] = []
        for event in self._early:
            device = None if first.device_ns is None else int(first.device_ns[0])
            if device is not None and first.host_ns is not None and event.at.host_ns is not None:
                device -= max(0, int(first.host_ns[0]) - event.at.host_ns)
            moved.append(replace(event, at=Instant(first.first, device, None)))
            key = lasting_key(event)
            if key is not None and self._lasting[key] is event:
                self._lasting[key] = moved[-1]
        self._early.clear()
        self._log_events(moved, again=True)

    def _log_events(self, events: Sequence[Event], *, again: bool = False) -> None:
        """Log events, those of a kind together: a chunk costs 2 kB, whatever is in it.

        What is shown `again` has its place among the newest lines, and in time, already.
        """
        kinds: dict[tuple[object, ...], list[Event]] = {}
        for event in events:
            kinds.setdefault(_kind_of(event), []).append(event)
            key = lasting_key(event)
            if key is not None and not again:
                self._lasting[key] = event
        for found in kinds.values():
            self._log_kind(found, again=again)

    def _log_kind(self, events: list[Any], *, again: bool) -> None:
        """Log events of one kind."""
        first, times = events[0], at_instants(*(event.at for event in events))
        if isinstance(first, Drawing):
            self._waiting[first.chart.key] = events[-1]
        elif isinstance(first, Log):
            texts = [self._log_text.text if again else self._log_text.add(event) for event in events]
            if times.indexes:
                self._has_log = True
                lines = rr.TextLog.columns(
                    text=[event.text for event in events], level=[event.level for event in events]
                )
                self._rec.send_columns("/log", indexes=times.indexes, columns=lines)
                log_markdown(self._rec, LOG_TEXT, texts, times)
        elif not times.indexes:
            return
        elif isinstance(first, Numbers):
            values = {name: np.array([event.values[name] for event in events]) for name in first.values}
            self._log_numbers(values, times)
        elif isinstance(first, State):
            self._know_states(events)
            change = rr.StateChange.columns(state=[event.state for event in events])
            self._rec.send_columns(lane_path(first.lane), indexes=times.indexes, columns=change)
        else:
            log_markdown(self._rec, "/status", [status_card(events[-1])], at_instants(events[-1].at))

    def _log_numbers(self, columns: Mapping[str, FloatArray], times: Rows) -> None:
        rows = Rows(columns, times.sample, times.device_ns, times.host_ns, self._step_ns)
        claimed = self._panels.log(rows)
        for name in columns.keys() - claimed:
            self._others.log(name, columns[name], rows)

    def _draw_charts(self) -> None:
        """Draw what is waiting and due: live the one that was drawn longest ago."""
        age_s = time.monotonic() - self._began_s
        if not self._live:
            if age_s >= self._pictures_s:
                self._pictures_s = min(LATER * age_s, age_s + PICTURES_S)
                self._draw_apart(list(self._waiting.values()), niceness=NICE)
        elif self._waiting and self._painter.is_free:
            key = min(self._waiting, key=lambda key: self._drawn_s.get(key, -math.inf))
            self._drawn_s[key] = age_s
            self._painter.begin(self._draw(self._waiting.pop(key)))

    def _draw(self, event: Drawing) -> Callable[[], None]:
        """Return what draws a chart and logs the picture."""
        chart, times = event.chart, at_instants(event.at)
        self._charts[chart.key] = chart
        return lambda: log_picture(self._rec, chart.key, picture(chart), times.indexes)

    def _draw_apart(self, events: Sequence[Drawing], niceness: int = 0) -> None:
        """Draw charts for a recording, which has the last of each alone, whatever moment is looked at."""
        self._waiting.clear()
        self._charts |= {event.chart.key: event.chart for event in events}
        charts = [event.chart for event in events]
        for event, blob in zip(events, pictures_apart(charts, niceness=niceness), strict=False):
            log_picture(self._rec, event.chart.key, blob, [])

    def end_file(self) -> None:
        """Log what a file of a recording has at its end."""
        self._axes.finish()

    def finish(self) -> None:
        """Log the charts and the status card as they are at the end."""
        self.end_file()
        self._painter.wait()
        self._waiting.clear()
        lasting = self._lasting.values()
        drawings = [event for event in lasting if isinstance(event, Drawing)]
        if self._live:
            for event in drawings:
                self._draw(event)()
        else:
            self._draw_apart(drawings)
        self._log_events([event for event in lasting if isinstance(event, Status)])
        self._arrange()

    def repeat(self) -> None:
        """Log the latest states, status card and log lines once more, for who takes the newest first."""
        if self._newest is None:
            return
        self._log_events([one for one in self._lasting.values() if not isinstance(one, Drawing)], again=True)
        if self._has_log:
            log_markdown(self._rec, LOG_TEXT, [self._log_text.text], self._newest)

    def _know_states(self, events: Sequence[State]) -> None:
        """Declare the colours of a lane anew where it has states that it had not."""
        lane = events[0].lane
        known = self._lanes.setdefault(lane, {})
        before = len(known)
        for event in events:
            if len(known) < COLORED_STATES:
                known.setdefault(event.state, event.level)
        if len(known) > before:
            declare_lane(self._rec, lane, known)

    def _grown_s(self) -> float:
        """Return how much the slow tabs show, s; while they grow the next power of two."""
        age_s = max(1.0, 1e-9 * self._age_ns)
        return min(2.0 ** math.ceil(math.log2(age_s)), slow_window(self._setup.window_s))

    def _arrange(self) -> None:
        """Send the blueprint when what there is to see has changed."""
        # A recording is not arranged anew for charts, which are drawn later: an arrangement takes 370 kB.
        coming = {} if self._live else {key: drawing.chart for key, drawing in self._waiting.items()}
        charts = (self._charts | coming).values()
        contents = Contents(
            panels=self._panels.shown,
            charts=tuple((chart.place, chart.key, chart.title) for chart in charts),
            lanes=tuple(sorted(map(lane_path, self._lanes))),
            log=self._has_log,
            status="status" in self._lasting,
            others=self._others.views,
            cards=tuple(self._panels.readings()),
            filled=self._live and self._age_ns > 1e9 * self._setup.window_s,
            full=self._live and self._age_ns > 1e9 * slow_window(self._setup.window_s),
            grown_s=self._grown_s() if self._live else 0.0,
        )
        if contents and (contents, self._timeline) != self._arranged:
            self._arranged = contents, self._timeline
            self.arrangement = blueprint(self._setup, contents, self._timeline, live=self._live)
            self._show(self.arrangement)


def recorded_step(clock: IntArray | None) -> int:
    """Return of how much time a recording keeps the extremes, ns, by the times of some samples."""
    if clock is None or len(clock) < 2:
        return RECORDED_STEP_NS
    rows_ns = STEP_ROWS * int(np.median(np.diff(clock)))
    return min(max(RECORDED_STEP_NS, rows_ns), LONGEST_STEP_NS)


def status_card(event: Status) -> str:
    """Return the status card as a compact Markdown table."""
    rows = [f"| **{for_markdown(name)}** | {for_markdown(value)} |" for name, value in event.fields.items()]
    return "\n".join(["| | |", "|:--|:--|", *rows])


def _kind_of(event: Event) -> tuple[object, ...]:
    """Return what events must have in common to be logged together."""
    at, what = event.at, lasting_key(event)
    if isinstance(event, Numbers):
        what = ",".join(event.values)
    return type(event), what, at.sample is None, at.device_ns is None, at.host_ns is None
