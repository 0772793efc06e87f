"""What is shown of a run: samples, rates, losses, state lanes, log lines and the status card."""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT, SampleBlock
from imumon.harmless import for_log
from imumon.lane import LaneState, Level
from imumon.pipeline import Pipeline, PipelineCounters
from imumon.protocols.base import MAIN
from imumon.recordings.folder import Session
from imumon.transport.reader import Event, EventKind, Reads
from imumon.transport.settings import PortSettings
from imumon.view.cards import measured
from imumon.view.items import Drawing, Instant, Log, Numbers, State, Status, Timebase, ViewItem, ViewSetup

Publish = Callable[[ViewItem], None]
Report = Callable[[str, str], None]
"""Takes the level (INFO, WARN, ERROR) and a line."""

RATE_WINDOW_NS = 2_000_000_000
SETTLING_NS = 60_000_000_000
"""The clock fit is called synchronised after this much time in a segment."""
WARN_ABOVE, CALM_BELOW = 0.80, 0.70
"""Load at which the warning comes, as a packet that grows overruns the line soon, and at which it goes."""
GARBLED_BELOW, GARBLED_AFTER_BYTES = 0.5, 400
"""When less than half of the bytes of the last 2 s, at least so many, frame: wrong baud rate or protocol."""
RESTLESS = 3
"""A clock that starts anew so often in 2 s is not that of one device: none boots so fast."""
CHART_NS = 5_000_000_000
"""Charts are made anew this often, while samples come: samples wait for it, and the view draws no faster."""

OPENING, OPEN, LOST = LaneState("opening"), LaneState("open", Level.GOOD), LaneState("lost", Level.BAD)
PORT = {
    EventKind.OPENED: OPEN,
    EventKind.RESUMED: OPEN,
    EventKind.SILENT: LaneState("silent", Level.WAIT),
    EventKind.LOST: LOST,
    EventKind.UNAVAILABLE: LOST,
    EventKind.CLOSED: LaneState("closed", Level.BAD),
}
"""States of the lanes: of the port, then of the data, the link, the clock, and of motion."""
OK, GARBLED = LaneState("ok", Level.GOOD), LaneState("bad: does not frame", Level.BAD)
LOSSES, FULL = LaneState("warning: losses", Level.WAIT), LaneState("warning: full", Level.WAIT)
JUMPED, ACQUIRING = LaneState("jumped", Level.BAD), LaneState("acquiring", Level.WAIT)
SYNCHRONISED = LaneState("synchronised", Level.GOOD)
MOTION = {0: LaneState("moving"), 1: LaneState("rest", Level.GOOD)}
MARKS = {EventKind.MARK: "mark", EventKind.START: "start of part", EventKind.STOP: "end of part"}
LEVELS = {
    EventKind.LOST: "ERROR",
    EventKind.SILENT: "WARN",
    EventKind.UNAVAILABLE: "WARN",
    EventKind.SHARED: "WARN",
}


class Progress(NamedTuple):
    """The numbers of the moment, for the status line and the card."""

    elapsed_s: float
    counters: PipelineCounters
    packets_per_s: float
    link_load: float | None  # share of what the line can carry; None where there is no line
    port: str
    clock: Mapping[str, str]  # what a person reads of the clock, label and text


class Narrator:
    """Turns what the pipeline does into view items and log lines; used by one thread.

    `settings` is the port, for the link load.  View items go to `publish`, log lines also to `report`.  The
    status card begins with `card`.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        settings: PortSettings | None,
        publish: Sequence[Publish],
        report: Report,
        card: Mapping[str, str],
    ) -> None:
        self._pipeline = pipeline
        self.publish = publish
        self._report, self._card = report, card
        self._timebase = Timebase()
        self._capacity = settings.capacity_bytes_per_s if settings is not None else None
        # Of the last 2 s: when, the counters then, and the arrival of the last bytes before.
        self._history: deque[tuple[int, PipelineCounters, int]] = deque()
        self._lanes: dict[str, LaneState] = {}
        self._began_ns = self._last_ns = 0
        self._first_bytes = 0
        self._segment = 0
        self._segment_began_ns = 0
        self._restless = False
        self._shown: dict[str, str] = {}
        self._charts_ns = 0
        self._charts_samples = 0

    @property
    def state(self) -> str:
        """What port and data do: open, silent, lost, closed, or does not frame."""
        port = self._lanes.get("port", OPEN)
        return "does not frame" if port == OPEN and self._lanes.get("data") == GARBLED else port.text

    def item(self, item: Reads | Event) -> None:
        """Take what came from the port: count bytes, or show an event or a remark of the user."""
        if isinstance(item, Reads):
            if not self._began_ns:
                self._began_ns, self._first_bytes = int(item.arrivals_ns[0]), int(item.lengths[0])
            self._last_ns = int(item.arrivals_ns[-1])
        elif item.kind in MARKS:
            self.log("INFO", f"{MARKS[item.kind]}: {item.detail}", item.time_ns)
            lane = "mark" if item.kind is EventKind.MARK else "part"
            self._lanes.pop(lane, None)  # the same mark again is another
            text = "between parts" if item.kind is EventKind.STOP else for_log(item.detail)
            self._lane(lane, LaneState(text), item.time_ns)
        else:
            self.log(LEVELS.get(item.kind, "INFO"), f"port {item.kind.value}: {item.detail}", item.time_ns)
            if item.kind in PORT:
                self._lane("port", PORT[item.kind], item.time_ns)

    def samples(self, block: SampleBlock, side: Mapping[str, SampleBlock] = {}) -> None:
        """Show samples and those of side streams, and what changed with them."""
        for stream, rows in side.items():
            self._emit(self._timebase.side(stream, rows))
        if not len(block):
            return
        shown = self._timebase.samples(block)
        self._emit(shown)
        # Nobody received the rows of a table: its clock is that of the device.
        clock = "arrival_time_ns" if "arrival_time_ns" in block else "device_time_ns"
        segment, arrival = int(block["segment"][-1]), int(block[clock][-1])
        if segment != self._segment:
            if not self._restless:
                self.log("WARN", f"the device's clock or counter started anew: segment {segment}", arrival)
            self._lane("clock", JUMPED, arrival)
            self._segment, self._segment_began_ns = segment, arrival
        self._segment_began_ns = self._segment_began_ns or arrival
        status = block.columns.get("status")
        if status is not None and status[-1] != NO_INT:
            self._lane("status", LaneState(f"0x{int(status[-1]):04X}"), arrival)
        if (at_rest := block.columns.get("at_rest")) is not None:
            for row in [0, *(np.flatnonzero(np.diff(at_rest)) + 1).tolist()]:  # each change at its own time
                if (state := MOTION.get(int(at_rest[row]))) is not None:
                    self._lane("motion", state, shown.times.at(row))

    def log(self, level: str, text: str, time_ns: int | None = None) -> None:
        """Show a log line."""
        text = for_log(text)
        self._report(level, text)
        self._emit(Log(self._timebase.at(time_ns), text, level))

    def tick(self, now_ns: int) -> Progress:
        """Show rates, losses and lanes; to be called a few times a second."""
        progress = self.progress(now_ns)
        if (load := progress.link_load) is not None:
            was_full = self._lanes.get("link") == FULL
            is_full = load > (CALM_BELOW if was_full else WARN_ABOVE)
            is_full &= now_ns - self._history[0][0] >= RATE_WINDOW_NS
            if is_full and not was_full:
                self.log("WARN", f"the link is {load:.0%} full: beyond 100 % a device drops packets", now_ns)
            self._lane("link", FULL if is_full else OK, now_ns)
        self._watch_data(now_ns)
        if progress.counters.samples:
            self._watch_clock(now_ns)
        shown = {**self._card, **describe(progress)}
        if shown != self._shown:  # a port that is lost for days must not fill the recording
            self._shown = shown
            self._emit(Status(self._timebase.at(now_ns), shown))
            self._show_numbers(progress, now_ns)
        for notice in self._pipeline.notices():
            self.log("INFO", f"device: {notice}", now_ns)
        for warning in self._pipeline.warnings():
            self.log("WARN", warning, now_ns)
        for lane, state in self._pipeline.lanes().items():
            self._lane(lane, state, now_ns)
        samples = progress.counters.samples
        if samples != self._charts_samples and now_ns - self._charts_ns >= CHART_NS:
            self._charts_samples, self._charts_ns = samples, now_ns
            for chart in self._pipeline.charts():
                self._emit(Drawing(self._timebase.at(now_ns), chart))
        return progress

    def ended(self, last: Progress) -> Progress:
        """Return the last numbers with rates that are means, from the first byte that came to the last."""
        span_s = (self._last_ns - self._began_ns) * 1e-9
        if span_s <= 0.0:
            return last
        bytes_per_s = (last.counters.bytes_received - self._first_bytes) / span_s  # the first came before it
        return last._replace(
            packets_per_s=max(last.counters.packets - 1, 0) / span_s,  # as many intervals
            link_load=None if self._capacity is None else bytes_per_s / self._capacity,
        )

    def progress(self, now_ns: int) -> Progress:
        """Return the numbers of the moment."""
        counters, clock = self._pipeline.counters, self._pipeline.host_clock
        history, load = self._history, None if self._capacity is None else 0.0
        history.append((now_ns, counters, self._last_ns))
        begin_ns = now_ns - RATE_WINDOW_NS
        while len(history) > 2 and (history[1][0] <= begin_ns or not history[0][1].bytes_received):
            history.popleft()
        then_ns, then, arrived_ns = history[0]
        span_s, sent_s = (now_ns - then_ns) * 1e-9, (now_ns - arrived_ns) * 1e-9
        if self._capacity is not None and then.bytes_received and sent_s > 0.0:
            # What came first had queued up; a late read brings what was sent since the one before it.
            load = (counters.bytes_received - then.bytes_received) / sent_s / self._capacity
        drift = "drift not known yet"
        if math.isfinite(clock.drift_sd_ppm):
            drift = f"{measured(clock.drift_ppm, clock.drift_sd_ppm)} ppm"
        rows = {"clock": f"{drift}, {counters.clock_restarts} restarts"}
        if clock.delay_ns is not None:
            rows["latest delay"] = f"{clock.delay_ns * 1e-6:.1f} ms above the least"
        return Progress(
            elapsed_s=(now_ns - self._began_ns) * 1e-9 if self._began_ns else 0.0,
            counters=counters,
            packets_per_s=(counters.packets - then.packets) / span_s if span_s > 0 else 0.0,
            link_load=load,
            port=self._lanes.get("port", OPENING).text,
            clock=rows,
        )

    def _show_numbers(self, progress: Progress, now_ns: int) -> None:
        counters = progress.counters
        values = {
            "packet_rate": progress.packets_per_s,
            "packets_lost": float(counters.packets_missing),
            "packets_damaged": float(counters.checksum_errors + counters.length_errors),
        }
        if progress.link_load is not None:
            values["link_load"] = progress.link_load
        self._emit(Numbers(self._timebase.at(now_ns), values))

    def _watch_clock(self, now_ns: int) -> None:
        """The fit of the device clock needs some time in each segment; a jump stays shown until then."""
        restarts = self._history[-1][1].clock_restarts - self._history[0][1].clock_restarts
        if restarts >= RESTLESS and not self._restless:
            self.log(
                "ERROR",
                f"clock or counter started anew {restarts} times in 2 s: do two devices send on this line?",
                now_ns,
            )
        self._restless = restarts >= RESTLESS or (self._restless and restarts > 0)
        if now_ns - self._segment_began_ns > SETTLING_NS:
            self._lane("clock", SYNCHRONISED, now_ns)
        elif self._lanes.get("clock") != JUMPED:
            self._lane("clock", ACQUIRING, now_ns)

    def _watch_data(self, now_ns: int) -> None:
        """Classify the data of the last 2 s: framed, damaged, or hardly framed at all."""
        then, now = self._history[0][1], self._history[-1][1]
        framed = now.bytes_in_packets - then.bytes_in_packets
        received = now.bytes_received - then.bytes_received
        if received < GARBLED_AFTER_BYTES:
            return
        damaged = now.lost + now.bytes_skipped > then.lost + then.bytes_skipped
        state = GARBLED if framed < GARBLED_BELOW * received else LOSSES if damaged else OK
        if state == GARBLED and self._lanes.get("data") != GARBLED:
            self.log(
                "ERROR",
                f"only {framed / received:.0%} of the bytes are packets: wrong baud rate or device?",
                now_ns,
            )
        self._lane("data", state, now_ns)

    def _lane(self, lane: str, state: LaneState, at: Instant | int) -> None:
        if self._lanes.get(lane) != state:
            self._lanes[lane] = state
            instant = at if isinstance(at, Instant) else self._timebase.at(at)
            self._emit(State(instant, lane, *state))

    def _emit(self, item: ViewItem) -> None:
        for publish in self.publish:
            publish(item)


def view_setup(
    session: Session, units: Mapping[str, str], window_s: float = 30.0, replay: bool = False
) -> ViewSetup:
    """Return what the view must know of a session and its units before the first sample."""
    metadata, name = session.metadata, session.path.name
    title = f"replay of {name}" if replay else name
    return ViewSetup(
        title=title,
        recording_id=f"{title} {metadata.created_ns}".replace(" ", "-"),
        units=units,
        z_down=metadata.axes == "FRD",
        window_s=window_s,
        first_tab="Replay" if replay else "Live",
    )


def describe(progress: Progress) -> dict[str, str]:
    """Return the progress as a person reads it, label and text, for card and summary.

    Rates and load of the card are those of the last 2 s, those of the summary means (`Narrator.ended`).
    """
    counters = progress.counters
    load = {} if progress.link_load is None else {"link load": f"{progress.link_load:.0%}"}
    return {
        "packets": f"{counters.packets:,} ({progress.packets_per_s:.1f}/s)",
        "bytes": f"{counters.bytes_received:,} received, {counters.bytes_skipped:,} skipped",
        "losses": describe_losses(counters),
        **progress.clock,
        **load,
    }


def describe_streams(counters: PipelineCounters, tables: Mapping[str, Path]) -> dict[str, str]:
    """Return what came of each stream and which table has it, label and text."""
    rows = {}
    for name, stream in counters.streams.items():
        rate = "" if stream.rate_hz is None else f" at {stream.rate_hz:.4g} Hz"
        rate += f", dated by {stream.dated_by}" if rate and stream.dated_by not in ("", "clock") else ""
        holes = f", {stream.gaps:,} gaps" if stream.gaps else ""
        parts = f", {stream.incomplete:,} of them incomplete" if stream.incomplete else ""
        where = f" in {tables[name]}" if name in tables else ""
        rows[f"stream {name}"] = f"{stream.rows:,} rows{rate}{parts}{holes}{where}"
    return rows


def describe_losses(counters: PipelineCounters) -> str:
    """Return what was lost, in one phrase; without a packet counter that is not known."""
    packets = f"{counters.packets_missing:,} packets in {counters.counter_gaps:,} gaps"
    if not counters.packets_counted:
        main = counters.streams.get(MAIN)
        gaps = f", {main.gaps:,} gaps by its clock" if main and main.dated_by == "clock" else ""
        packets = f"not known, as no packet_counter came{gaps}"
    return (
        f"{packets}, {counters.checksum_errors:,} checksum errors, {counters.length_errors:,} length errors"
    )
