"""Temperature rate: time of a sample and channel, without an event most of the time."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from functools import partial

import numpy as np

from benchmarks.measure import Bar, Table, measure
from imumon.blocks import FloatArray, IntArray
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.filters.rates import RateMethod
from imumon.papers.fir import FirRate, Params

QUIET = "multiple models, level unchanged"
RATES_HZ = (10, 100, 1000)
SECONDS = 300
BLOCK_S = 10
BAR_US = 1200.0
"""Per second of data and channel, as a stage may cost that thinks eight times a second for 150 us."""
WARM_S, QUIET_S = 1200, 60
"""Before a level is measured that does not change, the method gets to know the sensor for so long."""


def over(method: RateMethod, time_ns: IntArray, segment: IntArray, reading: FloatArray, size: int) -> None:
    """Run a method over a record in blocks."""
    for start in range(0, len(reading), size):
        part = slice(start, start + size)
        method.process(time_ns[part], segment[part], reading[part])


def run() -> tuple[list[Table], list[Bar]]:
    """Measure both methods on a sensor that warms up by 6 degC/h, with noise, read in steps of 0.05 degC."""
    table = Table(
        "Temperature rate, us per sample and channel", ["method", *(f"{rate} Hz" for rate in RATES_HZ)]
    )
    rows: dict[str, list[str]] = {"multiple models": [], QUIET: [], "FIR 300/180": []}
    bars = []
    for rate in RATES_HZ:
        n = SECONDS * rate
        time_ns = np.arange(n) * (1_000_000_000 // rate)
        noise = np.random.default_rng(0).normal(0.0, 0.005, n)
        reading = np.round((25 + time_ns * 1e-9 / 600 + noise) / 0.05) * 0.05
        record = time_ns, np.zeros(n, np.int64), reading, BLOCK_S * rate
        times = measure(
            {
                "multiple models": partial(_multiple_models, *record),
                QUIET: _quiet(rate),
                "FIR 300/180": partial(_fir, *record),
            }
        )
        samples = {name: QUIET_S * rate if name == QUIET else n for name in rows}
        for name, cells in rows.items():
            cells.append(f"{times[name].best / samples[name] / 1000:.3f}")
        for name in ("multiple models", QUIET):
            cost = times[name].best / samples[name] / 1000 * rate
            bars.append(
                Bar(f"temperature rate at {rate} Hz, {name}, us per second", BAR_US, cost, at_most=True)
            )
    table.rows += [[name, *cells] for name, cells in rows.items()]
    table.notes.append(
        "blocks of 10 s; the bank works once a second whatever the rate: at a higher one a sample costs less"
    )
    return [table], bars


def _quiet(rate: int) -> Callable[[], None]:
    """Return what runs a method that knows its sensor over a level that does not change."""
    n, tail = WARM_S * rate, QUIET_S * rate
    time_ns = np.arange(n + tail) * (1_000_000_000 // rate)
    noise = np.random.default_rng(0).normal(0.0, 0.005, n)
    reading = np.round((25 + time_ns[:n] * 1e-9 / 3600 + noise) / 0.05) * 0.05
    reading = np.append(reading, np.full(tail, reading[-1]))
    segment = np.zeros(n + tail, np.int64)
    method = MultipleModelRate()
    method.process(time_ns[:n], segment[:n], reading[:n])

    def run_quiet() -> None:
        over(deepcopy(method), time_ns[n:], segment[n:], reading[n:], BLOCK_S * rate)

    return run_quiet


def _multiple_models(time_ns: IntArray, segment: IntArray, reading: FloatArray, size: int) -> None:
    over(MultipleModelRate(), time_ns, segment, reading, size)


def _fir(time_ns: IntArray, segment: IntArray, reading: FloatArray, size: int) -> None:
    over(FirRate(Params(0.05, 300.0, 180.0, 1000)), time_ns, segment, reading, size)
