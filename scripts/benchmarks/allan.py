"""Allan deviation: one hour of a recording, and the live curve of a sample and channel."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter

import numpy as np

from benchmarks.measure import Bar, Table, measure
from imumon.allan.analysis import analyse, octaves, variances
from imumon.allan.covariance import Kind
from imumon.allan.series import EvenSeries, even_channels
from imumon.allan.streaming import StreamingAllan
from imumon.blocks import FloatArray, IntArray

RATE_HZ, HOUR_S = 400, 3600
CHANNELS = 6
BAR_S = 1.0
BAR_NS = 200.0
LIVE_SAMPLES, BLOCK = 40_000, 40
ROUNDS = 5


def run() -> tuple[list[Table], list[Bar]]:
    """Measure six channels of white noise: deviations alone, with intervals and terms, and live."""
    n = RATE_HZ * HOUR_S
    rng = np.random.default_rng(0)
    time_ns, segment = np.arange(n) * (1_000_000_000 // RATE_HZ), np.zeros(n, np.int64)
    channels = {str(row): rng.normal(size=n) for row in range(CHANNELS)}
    series = even_channels(time_ns, segment, channels)
    seconds = {
        "grid": _best(partial(even_channels, time_ns, segment, channels)),
        "deviations": _best(partial(_deviations, list(series.values()))),
        "all": _best(partial(analyse, series)),
    }
    live = measure({"live": partial(_live, time_ns, segment, channels["0"])})["live"]
    table = Table("Allan deviation, one hour at 400 Hz, six channels, octaves", ["step", "s"])
    names = {
        "grid": "gaps found, even grid",
        "deviations": "overlapping Allan, modified, Hadamard, one thread",
        "all": "the same with intervals and terms",
    }
    table.rows += [[text, f"{seconds[name]:.3f}"] for name, text in names.items()]
    live_ns = live.best / LIVE_SAMPLES
    table.notes.append(
        f"live, in blocks of {BLOCK}: {live_ns:.0f} ns per sample and channel, 18 kB a channel"
    )
    whole = seconds["grid"] + seconds["all"]
    return [table], [
        Bar("Allan analysis of an hour at 400 Hz, six channels, s", BAR_S, whole, at_most=True),
        Bar("live Allan curve, ns per sample and channel", BAR_NS, live_ns, at_most=True),
    ]


def _best(function: Callable[[], object]) -> float:
    """Return the seconds of the best of a few calls; `measure` would make forty of a second each."""
    times = []
    for _ in range(ROUNDS):
        start = perf_counter()
        function()
        times.append(perf_counter() - start)
    return min(times)


def _deviations(channels: list[EvenSeries]) -> list[dict[Kind, FloatArray]]:
    return [variances(channel, octaves(channel)) for channel in channels]


def _live(time_ns: IntArray, segment: IntArray, values: FloatArray) -> None:
    channel = StreamingAllan()
    for start in range(0, LIVE_SAMPLES, BLOCK):
        part = slice(start, start + BLOCK)
        channel.process(time_ns[part], segment[part], values[part])
