"""Clock kernels: time of a sample, from the device's ticks to host time."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import partial

import numpy as np

from benchmarks.measure import Bar, Table, measure
from imumon.blocks import IntArray
from imumon.clock import DeviceClock, HostClock
from imumon.protocols.base import Timing

SAMPLES = 60_000
BLOCKS = (5, 1000, SAMPLES)
TIMING = Timing(counter_bits=16, tick_ns=Fraction(1000), tick_bits=32, rate_hz=100.0)


def in_blocks(function: Callable[[slice], object], size: int) -> None:
    """Call the function for each block of samples in turn."""
    for start in range(0, SAMPLES, size):
        function(slice(start, start + size))


def device_times(counter: IntArray, ticks: IntArray, arrival: IntArray, size: int) -> None:
    """Run a new device clock over all samples."""
    clock = DeviceClock(TIMING)
    in_blocks(lambda s: clock.process(counter[s], ticks[s], arrival[s], len(arrival[s])), size)


def host_times(device_ns: IntArray, segment: IntArray, arrival: IntArray, size: int) -> None:
    """Run a new host clock over all samples."""
    clock = HostClock()
    in_blocks(lambda s: clock.process(device_ns[s], segment[s], arrival[s]), size)


def run() -> tuple[list[Table], list[Bar]]:
    """Measure both clocks on ten minutes at 100 Hz, 30 ppm off, polled every 16 ms."""
    number = np.arange(SAMPLES)
    sent = number * 10_000_000 + number * 300
    delay = np.random.default_rng(0).exponential(300_000, SAMPLES).astype(np.int64)
    arrival = (sent + delay) // 16_000_000 * 16_000_000 + 16_000_000
    counter, ticks = number & 0xFFFF, (number * 10_000) & 0xFFFFFFFF
    device_ns, segment = DeviceClock(TIMING).process(counter, ticks, arrival, SAMPLES)
    functions = {}
    for size in BLOCKS:
        functions[f"DeviceClock {size}"] = partial(device_times, counter, ticks, arrival, size)
        functions[f"HostClock {size}"] = partial(host_times, device_ns, segment, arrival, size)
    times = measure(functions)
    table = Table("Clocks, ns per sample by samples per block", ["clock", *map(str, BLOCKS)])
    for name in ("DeviceClock", "HostClock"):
        table.rows.append([name, *(f"{times[f'{name} {size}'].best / SAMPLES:.1f}" for size in BLOCKS)])
    table.notes.append("ten minutes at 100 Hz, clock 30 ppm off, bursts of 16 ms; memory is constant")
    return [table], []
