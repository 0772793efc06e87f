"""Hours and days of recording: memory after warm-up, and what the files take."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from imumon.pipeline import Pipeline
from imumon.protocols.device import device_text, load_device
from imumon.recordings.recorder import Recorder
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import WireReader
from imumon.run.narration import Narrator
from imumon.run.replay import replay
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from imumon.simulation.recording import START_NS
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.unit import MICROSECOND
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.reader import Bytes, Event, EventKind, Item
from imumon.view.items import ViewSetup
from imumon.view.recorder import QUEUE_BYTES, ViewRecorder
from tests.faults.rows import Row

MEGABYTE = 1e6
WARM_UP = 1.0 / 3.0
"""Part of the device time that is left out of the slope: caches, the first windows."""
WARM_UP_MINUTES = 13.0
"""Of real time: at 1 kHz the view has what it keeps after five, and after ten charts are recorded."""
MOST_SLOPE = 1.0
"""MB/h; a night of twelve hours may then cost 12 MB, of the 300 that a monitor takes."""
MOST_SLOPE_LIVE = 30.0
"""MB/h of a run of minutes, of which the slope is no better known than this."""
SECONDS_A_READ = 0.05
SHORTEST_H, SHORTEST_MINUTES = 1.0, WARM_UP_MINUTES + 15.0
"""Of less the slope is that of the warm-up: it is given, and not judged."""
PARTS = 12
"""The slope is that of the means of so many parts: what comes and goes within a minute cancels."""


@dataclass(frozen=True, slots=True)
class Slope:
    """MB/h after the warm-up, and its standard deviation; NaN of a run that is too short."""

    value: float
    sd: float

    def within(self, most: float) -> bool:
        """Return whether it is at most this, as far as it is known, or nothing is known of it."""
        return not self.value - 2.0 * self.sd > most

    def __str__(self) -> str:
        """Return both as a person writes them."""
        return "no slope yet" if np.isnan(self.value) else f"{self.value:+.1f} ± {self.sd:.1f} MB/h"


def _slope(times_h: list[float], memory: list[float], warm_up_h: float) -> Slope:
    times, megabytes = np.array(times_h), np.array(memory)
    late = times >= warm_up_h
    if late.sum() < PARTS:
        return Slope(np.nan, np.nan)
    at, mean = (
        np.array([part.mean() for part in np.array_split(values[late], PARTS)])
        for values in (times, megabytes)
    )
    found, covariance = np.polyfit(at, mean, 1, cov=True)
    return Slope(float(found[0]), float(np.sqrt(covariance[0, 0])))


def _items(rate_hz: float, hours: float) -> Iterator[Item]:
    """Yield what a port would give, as fast as it is asked for."""
    device = load_device("ax1")
    unit = SimulatedUnit(
        load_scenario("bench").played(rate_hz, device.axes), 0, device.decoder().timing.tick_ns or MICROSECOND
    )
    encoder, each = device.encoder(), round(rate_hz * SECONDS_A_READ)
    yield Event(EventKind.OPENED, START_NS, "accelerated")
    sent = 0
    while sent < hours * 3600.0 * rate_hz:
        samples = unit.samples(100 * each)
        counter = samples["packet_counter"] % (1 << 16)
        ticks = samples["device_ticks"] % (1 << 32)
        packets = encoder.encode(samples.with_columns({"packet_counter": counter, "device_ticks": ticks}))
        for first in range(0, len(packets), each):
            sent += each
            yield Bytes(b"".join(packets[first : first + each]), START_NS + round(sent / rate_hz * 1e9))


def accelerated(folder: Path, rate_hz: float, hours: float) -> Row:
    """Record, decode, estimate and draw so many hours of device time at once, and replay the recording."""
    began, device = time.monotonic(), load_device("ax1")
    recorder = Recorder(WireWriter(folder / "wire.mcap", {}), lambda _: None, lambda: None)
    recorder.start()
    pipeline = Pipeline(device, estimators(device, Setup()))
    view = ViewRecorder(folder / "view.rrd", ViewSetup("soak", "soak", pipeline.units))
    narrator = Narrator(pipeline, None, [view.publish], lambda *_: None, {})
    process, times, memory = psutil.Process(), [], []

    def recorded() -> Iterator[Item]:
        noted = 0.0
        for item in _items(rate_hz, hours):
            at_h = (item.time_ns - START_NS) / 3.6e12
            if at_h - noted >= hours / 100.0:
                noted = at_h
                times.append(at_h)
                memory.append(process.memory_info().rss / MEGABYTE)
                while view._queue._bytes > QUEUE_BYTES // 2:  # who can wait, loses nothing
                    time.sleep(0.01)
            recorder.put(item)
            yield item

    for _ in replay(recorded(), pipeline, narrator):
        pass
    recorder.stop()
    view.close(60.0)
    slope, wire = _slope(times, memory, WARM_UP * hours), (folder / "wire.mcap").stat().st_size
    drawn = sum(path.stat().st_size for path in folder.glob("view*.rrd"))
    took, counters = time.monotonic() - began, pipeline.counters
    again = Pipeline(device, estimators(device, Setup()))
    replayed_from = process.memory_info().rss
    for _ in replay(WireReader(folder / "wire.mcap"), again):
        pass
    grown = (process.memory_info().rss - replayed_from) / MEGABYTE
    return Row(
        f"{hours:g} h of device time at {rate_hz:g} Hz, accelerated",
        1,
        f"{counters.samples:,} samples in {took:.0f} s; memory {memory[0]:.0f} to {max(memory):.0f} MB,"
        f" {slope} after a third of it; wire.mcap {wire / hours / MEGABYTE:.1f} MB/h,"
        f" view.rrd {drawn / hours / MEGABYTE:.1f} MB/h; a replay took {grown:+.0f} MB more",
        held=(hours < SHORTEST_H or slope.within(MOST_SLOPE)) and again.counters == counters,
    )


def real_time(folder: Path, rate_hz: float, minutes: float) -> Row:
    """Let a monitor with the web view run, and watch the memory of its processes."""
    device = folder / "fast.yaml"
    device.write_text(
        device_text("ax1")[0]
        .replace("baudrates: [115200", "baudrates: [921600")
        .replace("name: ax1", "name: fast")
    )
    times: list[float] = []
    parent: list[float] = []
    children: list[float] = []
    with VirtualDevice(load_device(str(device)), folder / "ahrs", rate_hz) as ahrs:
        arguments = ["monitor", ahrs.port.path, "--device", str(device), "--view", "web", "--json"]
        program = [sys.executable, "-c", "from imumon.cli import main; main()", *arguments]
        with subprocess.Popen(
            [*program, "--out", str(folder / "session")],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        ) as child:
            try:
                process, began = psutil.Process(child.pid), time.monotonic()
                while time.monotonic() - began < 60.0 * minutes:
                    time.sleep(min(2.0, minutes))
                    times.append((time.monotonic() - began) / 3600.0)
                    parent.append(process.memory_info().rss / MEGABYTE)
                    rest = [each.memory_info().rss for each in process.children(recursive=True)]
                    children.append(sum(rest) / MEGABYTE)
                child.send_signal(signal.SIGINT)
                ended = time.monotonic()
                out = child.communicate(timeout=60)[0]
                left = time.monotonic() - ended
            finally:
                child.kill()
    told = json.loads(out)
    slopes = [_slope(times, memory, WARM_UP_MINUTES / 60.0) for memory in (parent, children)]
    hours = told["elapsed_s"] / 3600.0
    wire = (folder / "session" / "wire.mcap").stat().st_size
    drawn = sum(path.stat().st_size for path in (folder / "session").glob("view*.rrd"))
    return Row(
        f"{minutes:g} min in real time at {rate_hz:g} Hz with the web view",
        1,
        f"{told['samples']:,} samples, {told['packets_missing']} packets missing; monitor {parent[0]:.0f} to"
        f" {max(parent):.0f} MB, {slopes[0]} after {WARM_UP_MINUTES:g} min; view"
        f" {max(children):.0f} MB at most, {slopes[1]}; wire.mcap {wire / hours / MEGABYTE:.0f} MB/h,"
        f" view.rrd {drawn / hours / MEGABYTE:.1f} MB/h; exit after {left:.1f} s",
        held=(minutes < SHORTEST_MINUTES or all(slope.within(MOST_SLOPE_LIVE) for slope in slopes))
        and not told["bytes_unrecorded"]
        and told["packets_missing"] == 0,
    )
