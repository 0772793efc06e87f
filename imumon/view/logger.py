"""Turns view items into Rerun calls; the same code writes the live stream and the recording."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import groupby

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import NO_INT, FloatArray
from imumon.charts import Chart
from imumon.harmless import for_markdown
from imumon.view.attitude import DEVICE
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
from imumon.view.layout import INTEGERS, Rows, at_once, log_markdown
from imumon.view.log_text import LOG_TEXT, LogText
from imumon.view.others import Others
from imumon.view.panel_log import PanelLog
from imumon.view.pictures import Painter, log_picture
from imumon.view.window import slow_window

APPLICATION_ID = "imumon"

Show = Callable[[rrb.Blueprint], None]

ELSEWHERE = {"device_time_ns", "host_time_ns", "arrival_time_ns", "device_ticks"}
"""Integer columns that are a timeline, or of the transport: the wire recording has them."""

RECORDED_STEP_NS = 500_000_000
"""Of so much time a recording of the view keeps the extremes."""
PICTURE_SHARE = 0.03
"""Live, drawing charts takes so much of the time at the most."""
RECORDED_PICTURE_S = 600.0
"""In a recording a chart is drawn so often (it takes 60 kB), and as it is at the end."""
RECORDED_STATUS_S = 10.0
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
        self._panels = PanelLog(rec, setup, live=live)
        self._others = Others(rec, setup, live=live)
        self._lanes: dict[str, list[str]] = {}
        self._lasting: dict[str, Event] = {}
        self._charts: dict[str, Chart] = {}
        self._waiting: dict[str, Drawing] = {}
        self._painter = Painter(PICTURE_SHARE)
        self._drawn_s: dict[str, float] = {}
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
        # A later file of a recording needs the status card anew; pictures stand in the files before.
        self._drawn_s = {} if arrange else {key: s for key, s in self._drawn_s.items() if key != "status"}
        for event in self._lasting.values():
            self._log_event(event)
        if arrange:
            self._arranged = None
        self._arrange()

    def log(self, items: Iterable[ViewItem]) -> None:
        """Log items, samples in batches as they come; join them with `items.merge` first."""
        numbers: list[Numbers] = []
        for item in items:
            if isinstance(item, Samples):
                self._log_samples(item)
            elif isinstance(item, Numbers) and item.at.sample is not None:
                numbers.append(item)
            else:
                self._log_event(item)
                if item.at.sample is None and len(self._early) < EARLY_EVENTS:
                    self._early.append(item)
        self._log_series(numbers)
        if self._newest is not None:
            self._panels.log_cards(self._newest)
        self._draw_charts()
        self._arrange()

    def _log_samples(self, item: Samples) -> None:
        count = None if item.first is None else np.arange(item.first, item.first + item.rows, dtype=np.int64)
        step_ns = 0 if self._live else RECORDED_STEP_NS
        before_ns = self._last_ns.get(item.stream)
        rows = Rows(item.block.columns, count, item.device_ns, item.host_ns, step_ns, before_ns)
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
        for event in self._early:
            device = None if first.device_ns is None else int(first.device_ns[0])
            if device is not None and first.host_ns is not None and event.at.host_ns is not None:
                device -= max(0, int(first.host_ns[0]) - event.at.host_ns)
            self._log_event(event, at_once(Instant(first.first, device, None)))
        self._early.clear()

    def _log_event(self, event: Event, rows: Rows | None = None) -> None:
        times = rows or at_once(event.at)
        indexes = times.indexes
        key = lasting_key(event)
        if key is not None:
            self._lasting[key] = event
        if isinstance(event, Log) and rows is None:
            self._log_text.add(event)
        if not indexes:
            return
        if isinstance(event, Numbers):
            self._log_numbers({name: np.array([value]) for name, value in event.values.items()}, times)
        elif isinstance(event, State):
            self._know_state(event)
            change = rr.StateChange.columns(state=[event.state])
            self._rec.send_columns(lane_path(event.lane), indexes=indexes, columns=change)
        elif isinstance(event, Log):
            self._has_log = True
            line = rr.TextLog.columns(text=[event.text], level=[event.level])
            self._rec.send_columns("/log", indexes=indexes, columns=line)
            log_markdown(self._rec, LOG_TEXT, self._log_text.text, times)
        elif isinstance(event, Drawing):
            self._waiting[event.chart.key] = event
        elif self._live or self._is_due("status", RECORDED_STATUS_S):
            log_markdown(self._rec, "/status", status_card(event), times)

    def _log_series(self, numbers: Iterable[Numbers]) -> None:
        """Log numbers that follow each other together: a chunk costs 1.4 kB, whatever is in it."""
        for _, group in groupby(numbers, _kind_of):
            found = list(group)
            values = {name: np.array([one.values[name] for one in found]) for name in found[0].values}
            times = [(one.at.sample, one.at.device_ns, one.at.host_ns) for one in found]
            sample, device_ns, host_ns = (
                None if column[0] is None else np.array(column, np.int64)
                for column in zip(*times, strict=True)
            )
            self._log_numbers(values, Rows({}, sample, device_ns, host_ns))

    def _log_numbers(self, columns: Mapping[str, FloatArray], times: Rows) -> None:
        step_ns = 0 if self._live else RECORDED_STEP_NS
        rows = Rows(columns, times.sample, times.device_ns, times.host_ns, step_ns)
        claimed = self._panels.log(rows)
        for name in columns.keys() - claimed:
            self._others.log(name, columns[name], rows)

    def _draw_charts(self) -> None:
        """Draw what is waiting and due: live the one that was drawn longest ago."""
        if not self._live:
            for key in self._waiting:
                self._drawn_s.setdefault(key, time.monotonic())  # it begins with nothing worth 60 kB
            for key in [key for key in self._waiting if self._is_due(key, RECORDED_PICTURE_S)]:
                self._picture(self._waiting.pop(key))()
        elif self._waiting and self._painter.is_free:
            key = min(self._waiting, key=lambda key: self._drawn_s.get(key, -math.inf))
            self._drawn_s[key] = time.monotonic()
            self._painter.begin(self._picture(self._waiting.pop(key)))

    def _picture(self, event: Drawing) -> Callable[[], None]:
        """Return what draws a chart and logs the picture."""
        chart = event.chart
        self._charts[chart.key] = chart
        places = [other.chart.place for other in self._lasting.values() if isinstance(other, Drawing)]
        beside = any(panel.place == chart.place for panel in self._panels.shown)
        stacked = beside and places.count(chart.place) > 1
        return partial(
            log_picture, self._rec, chart, at_once(event.at).indexes, stacked=stacked, kept=not self._live
        )

    def _is_due(self, key: str, step_s: float) -> bool:
        """Tell, and remember, whether so much time has passed since this was last logged."""
        now = time.monotonic()
        due = now - self._drawn_s.get(key, -math.inf) >= step_s
        if due:
            self._drawn_s[key] = now
        return due

    def finish(self) -> None:
        """Log the charts and the status card as they are at the end."""
        self._painter.wait()
        self._drawn_s.clear()
        self._waiting.clear()
        for event in self._lasting.values():
            if isinstance(event, Drawing):
                self._picture(event)()
            elif isinstance(event, Status):
                self._log_event(event)
        self._arrange()

    def _know_state(self, event: State) -> None:
        known = self._lanes.setdefault(event.lane, [])
        if event.state not in known and len(known) < COLORED_STATES:
            known.append(event.state)
            declare_lane(self._rec, event.lane, known)

    def _grown_s(self) -> float:
        """Return how much the slow tabs show, s; while they grow the next power of two."""
        age_s = max(1.0, 1e-9 * self._age_ns)
        return min(2.0 ** math.ceil(math.log2(age_s)), slow_window(self._setup.window_s))

    def _arrange(self) -> None:
        """Send the blueprint when what there is to see has changed."""
        # A recording is arranged once: an arrangement takes 340 kB there, and charts are drawn at its end.
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


def status_card(event: Status) -> str:
    """Return the status card as a compact Markdown table."""
    rows = [f"| **{for_markdown(name)}** | {for_markdown(value)} |" for name, value in event.fields.items()]
    return "\n".join(["| | |", "|:--|:--|", *rows])


def _kind_of(numbers: Numbers) -> tuple[object, ...]:
    """Return what numbers must have in common to be logged together."""
    at = numbers.at
    return tuple(numbers.values), at.device_ns is None, at.host_ns is None
