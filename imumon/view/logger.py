"""Turns view items into Rerun calls; the same code writes the live stream and the recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import rerun as rr

from imumon.blocks import NO_INT, ColumnArray
from imumon.charts import Chart
from imumon.harmless import for_markdown
from imumon.view.attitude import DEVICE
from imumon.view.blueprint import Contents, blueprint
from imumon.view.chart import declare_chart, log_chart
from imumon.view.items import (
    Drawing,
    Event,
    Log,
    Numbers,
    Samples,
    State,
    Status,
    ViewItem,
    ViewSetup,
    lasting_key,
)
from imumon.view.layout import INTEGERS, OTHER, SCENE, Panel, Rows
from imumon.view.panels import PANELS

APPLICATION_ID = "imumon"

GOOD, WAIT, BAD, PLAIN = 0x2E9E5BFF, 0xE0A020FF, 0xD64545FF, 0x6C7A92FF
STATE_COLORS = {
    **dict.fromkeys(
        ("open", "ok", "good", "synchronised", "connected", "running", "rest", "valid", "settled"), GOOD
    ),
    **dict.fromkeys(
        ("opening", "waiting", "silent", "starting", "reconnecting", "warning", "acquiring", "aligning"), WAIT
    ),
    **dict.fromkeys(
        ("lost", "closed", "error", "failed", "bad", "jumped", "invalid", "clipping", "suspect", "disturbed"),
        BAD,
    ),
    "not": PLAIN,
}
"""Colour of a state by the first of its words, in lower case, that is here; else it is grey-blue."""

ELSEWHERE = {"device_time_ns", "host_time_ns", "arrival_time_ns", "device_ticks"}
"""Integer columns that are a timeline, or of the transport: the wire recording has them."""

COLORED_STATES = 40
"""States of a lane that get a colour of ours; the viewer colours any others itself."""

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
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, *, live: bool) -> None:
        self._rec = rec
        self._setup = setup
        self._live = live
        self._panels: dict[str, Panel] = {}
        self._others: set[str] = set()
        self._lanes: dict[str, list[str]] = {}
        self._lasting: dict[str, Event] = {}
        self._charts: dict[str, Chart] = {}
        self._early: list[Event] = []
        self._has_log = False
        self._timeline = "host_time"
        self._arranged: tuple[Contents, str] | None = None

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
        for panel in self._panels.values():
            panel.declare(rec)
        for name in self._others:
            self._declare_other(name)
        for lane in self._lanes:
            self._declare_lane(lane)
        charts, self._charts = self._charts, {}
        for chart in charts.values():
            self._know_chart(chart)
        for event in self._lasting.values():
            self._log_event(event)
        if arrange:
            self._arranged = None
        self._arrange()

    def log(self, items: Iterable[ViewItem]) -> None:
        """Log items, samples in batches as they come; join them with `items.merge` first."""
        for item in items:
            if isinstance(item, Samples):
                self._log_samples(item)
            else:
                self._log_event(item)
                if item.at.sample is None and len(self._early) < EARLY_EVENTS:
                    self._early.append(item)
        self._arrange()

    def _log_samples(self, item: Samples) -> None:
        count = None if item.first is None else np.arange(item.first, item.first + item.rows, dtype=np.int64)
        rows = Rows(item.block.columns, count, item.device_ns, item.host_ns)
        if item.device_ns is not None:
            self._timeline = "device_time"
        elif item.host_ns is None and self._timeline == "host_time":
            self._timeline = "sample"
        if self._early and item.first is not None:
            self._log_early_events(item)
        claimed = self._log_panels(rows)
        self._log_integers(rows, item.stream)
        for name, values in rows.columns.items():
            if values.dtype == np.float64 and name not in claimed:
                own = name.removeprefix(f"{item.stream}_")
                self._log_other(f"{item.stream}/{own}" if item.stream else name, values, rows)

    def _log_panels(self, rows: Rows) -> set[str]:
        claimed: set[str] = set()
        for panel in PANELS:
            if not rows.columns.keys() >= set(panel.columns):
                continue
            claimed.update(panel.columns)
            if panel.key not in self._panels:
                if not all(np.isfinite(rows.columns[name]).any() for name in panel.columns):
                    continue
                if panel.place == SCENE and any(other.place == SCENE for other in self._panels.values()):
                    continue
                self._panels[panel.key] = panel
                panel.declare(self._rec)
            panel.log(self._rec, rows)
        return claimed

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
            entity = f"{INTEGERS}/{stream}" if stream else INTEGERS
            self._rec.send_columns(
                entity, indexes=rows.indexes, columns=rr.AnyValues.columns(True, **integers)
            )

    def _log_other(self, name: str, values: ColumnArray, rows: Rows) -> None:
        if name not in self._others:
            if not np.isfinite(values).any():
                return
            self._others.add(name)
            self._declare_other(name)
        self._rec.send_columns(
            f"{OTHER}/{name}", indexes=rows.indexes, columns=rr.Scalars.columns(scalars=values)
        )

    def _log_early_events(self, first: Samples) -> None:
        """Show the events before the first sample on the timelines that begin with it."""
        for event in self._early:
            device = None if first.device_ns is None else int(first.device_ns[0])
            if device is not None and first.host_ns is not None and event.at.host_ns is not None:
                device -= max(0, int(first.host_ns[0]) - event.at.host_ns)
            self._log_event(event, Rows({}, *map(_one, (first.first, device, None))))
        self._early.clear()

    def _log_event(self, event: Event, rows: Rows | None = None) -> None:
        at = event.at
        times = rows or Rows({}, _one(at.sample), _one(at.device_ns), _one(at.host_ns))
        indexes = times.indexes
        key = lasting_key(event)
        if key is not None:
            self._lasting[key] = event
        if not indexes:
            return
        if isinstance(event, Numbers):
            self._log_numbers(event.values, times)
        elif isinstance(event, State):
            self._know_state(event)
            change = rr.StateChange.columns(state=[event.state])
            self._rec.send_columns(_lane_path(event.lane), indexes=indexes, columns=change)
        elif isinstance(event, Log):
            self._has_log = True
            line = rr.TextLog.columns(text=[event.text], level=[event.level])
            self._rec.send_columns("/log", indexes=indexes, columns=line)
        elif isinstance(event, Drawing):
            self._know_chart(event.chart)
            log_chart(self._rec, event.chart, indexes)
        else:
            card = rr.TextDocument.columns(text=[status_card(event)], media_type=["text/markdown"])
            self._rec.send_columns("/status", indexes=indexes, columns=card)

    def _log_numbers(self, values: Mapping[str, float], times: Rows) -> None:
        columns = {name: np.array([value], np.float64) for name, value in values.items()}
        rows = Rows(columns, times.sample, times.device_ns, times.host_ns)
        claimed = self._log_panels(rows)
        for name in columns.keys() - claimed:
            self._log_other(name, columns[name], rows)

    def _know_chart(self, chart: Chart) -> None:
        known = self._charts.get(chart.key)
        if known is None or [curve.name for curve in known.curves] != [c.name for c in chart.curves]:
            declare_chart(self._rec, chart)
        self._charts[chart.key] = chart

    def _know_state(self, event: State) -> None:
        known = self._lanes.setdefault(event.lane, [])
        if event.state not in known and len(known) < COLORED_STATES:
            known.append(event.state)
            self._declare_lane(event.lane)

    def _declare_lane(self, lane: str) -> None:
        states = self._lanes[lane]
        colors = np.array([state_color(state) for state in states], dtype=np.uint32)
        self._rec.log(
            _lane_path(lane), rr.StateConfiguration(values=states, labels=states, colors=colors), static=True
        )

    def _declare_other(self, name: str) -> None:
        self._rec.log(f"{OTHER}/{name}", rr.SeriesLines(names=[name]), static=True)

    def _arrange(self) -> None:
        """Send the blueprint when what there is to see has changed."""
        contents = Contents(
            panels=tuple(panel for panel in PANELS if panel.key in self._panels),
            charts=tuple((chart.place, chart.key, chart.title) for chart in self._charts.values()),
            lanes=bool(self._lanes),
            log=self._has_log,
            status="status" in self._lasting,
            others=bool(self._others),
        )
        if contents and (contents, self._timeline) != self._arranged:
            self._arranged = contents, self._timeline
            self._rec.send_blueprint(blueprint(self._setup, contents, self._timeline, live=self._live))


def status_card(event: Status) -> str:
    """Return the status card as a compact Markdown table."""
    rows = [f"| **{for_markdown(name)}** | {for_markdown(value)} |" for name, value in event.fields.items()]
    return "\n".join(["| | |", "|:--|:--|", *rows])


def state_color(state: str) -> int:
    """Return the colour of a state as 0xRRGGBBAA: that of the first of its words that has one."""
    words = [word.rstrip(":,") for word in state.lower().split(":")[0].split()]
    return next((STATE_COLORS[word] for word in words if word in STATE_COLORS), PLAIN)


def _lane_path(lane: str) -> str:
    """Return the entity of a lane; a blank in it would have to be escaped, and be shown so."""
    return f"/state/{lane.replace(' ', '_')}"


def _one(value: int | None) -> np.ndarray[tuple[int], np.dtype[np.int64]] | None:
    return None if value is None else np.array([value], np.int64)
