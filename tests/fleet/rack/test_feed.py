from __future__ import annotations

import numpy as np
import pytest

from imumon.charts import Axis, Chart
from imumon.fleet.rack.feed import Feed, picture
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.run.narration import Progress
from imumon.view.items import Drawing, Instant, Log, Samples, State, Timebase
from tests.view.streams import block

PROGRESS = Progress(1.5, Pipeline(load_device("ax1")).counters, 100.0, 0.5, "open", {})


def test_the_picture_is_thin_and_by_the_clock_of_the_host() -> None:
    samples = Timebase().samples(block(0, 400))
    shown = picture(samples)
    assert isinstance(shown, Samples)
    assert samples.times.host_ns is not None
    assert shown.times.host_ns is not None
    assert shown.times.sample is None
    assert shown.times.device_ns is None
    span_s = float(samples.times.host_ns[-1] - samples.times.host_ns[0]) * 1e-9
    assert shown.rows <= 50 * span_s + 2 < samples.rows
    assert set(shown.times.host_ns) <= set(samples.times.host_ns)
    place = int(np.flatnonzero(samples.times.host_ns == shown.times.host_ns[3])[0])
    assert shown.block["gyro_x"][3] == samples.block["gyro_x"][place]
    assert all(values.dtype == np.float64 for values in shown.block.columns.values())


def test_what_a_shared_view_cannot_show_is_left_out() -> None:
    chart = Chart("a", "Allan", "A", Axis("x"), Axis("y"), ())
    assert picture(Log(Instant(1, 2, 3), "a")) == Log(Instant(None, None, 3), "a")
    assert picture(Log(Instant(1, 2, None), "a")) is None
    assert picture(Drawing(Instant(1, 2, 3), chart)) is None


def test_the_vital_signs_are_those_of_the_newest_samples() -> None:
    feed, timebase, at = Feed("sessions/x"), Timebase(), Instant(None, None, 5)
    own = block(0, 100)
    n = len(own)
    nowhere = np.full(n, np.nan)
    bias = {
        f"gyro_bias_{axis}": np.where(np.arange(n) < n - 1, place, np.nan) for place, axis in enumerate("xyz")
    }
    sd = {f"gyro_bias_sd_{axis}": np.full(n, 0.5) for axis in "xyz"}
    own = own.with_columns({**bias, **sd, "temperature": np.where(np.arange(n) < 50, 20.0, 30.0)})
    for item in (timebase.samples(own), State(at, "port", "silent"), State(at, "port", "open")):
        feed.publish(item)
    vitals, items = feed.take(PROGRESS)
    assert (vitals.session, vitals.lanes, vitals.packets_per_s) == ("sessions/x", {"port": "open"}, 100.0)
    assert vitals.temperature_deg == pytest.approx(25.0)
    assert vitals.bias == (0.0, 1.0, 2.0)  # the last row has none
    assert vitals.bias_sd == (0.5, 0.5, 0.5)
    assert vitals.memory_mb > 10.0
    assert items
    later = own.with_columns(dict.fromkeys((*bias, "temperature"), nowhere))
    feed.publish(timebase.samples(later))
    again, _ = feed.take(PROGRESS)
    assert (again.bias, again.temperature_deg) == (vitals.bias, vitals.temperature_deg)
    assert vitals.mean_cpu > 0.0
    assert again.mean_cpu > 0.0
