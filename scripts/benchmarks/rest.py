"""Rest detector: time of a slot of six axes, at rest, in motion, and while a turn is on trial."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.measure import Bar, Table, measure
from imumon.blocks import SampleBlock
from imumon.estimation.gyro_bias.stage import RestDetector

RATES_HZ = (25, 100, 1000)
SAMPLES = 50_000
BLOCK_S = 10
SLOT_S = 0.25
BAR_US = 88.0
"""0.35 ms of the 2.5 ms that a second of data may take in a replay at 400 times real time."""


def record(rate: int, state: str) -> SampleBlock:
    """Return readings of a unit at rest, carried about, or turned steadily after a rest."""
    rng = np.random.default_rng(0)
    values = rng.normal(0.0, 0.01, (6, SAMPLES))
    values[5] -= 9.8
    if state == "turning":
        values[2, SAMPLES // 4 :] += 0.02
    if state == "in motion":
        values += np.sin(np.arange(SAMPLES) / rate * np.arange(1, 7)[:, np.newaxis])
    names = [f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"]
    return SampleBlock(
        {
            "device_time_ns": np.arange(SAMPLES) * (1_000_000_000 // rate),
            "segment": np.zeros(SAMPLES, np.int64),
            **dict(zip(names, values, strict=True)),
        }
    )


def run() -> tuple[list[Table], list[Bar]]:
    """Measure the stage in blocks of 10 s."""
    table = Table("Rest detector, us per slot", ["unit", *(f"{rate} Hz" for rate in RATES_HZ)])
    rows: dict[str, list[str]] = {"at rest": [], "in motion": [], "turning": []}
    bars = []
    for rate in RATES_HZ:
        size, slots = BLOCK_S * rate, SAMPLES / rate / SLOT_S
        times = measure({name: partial(_process, record(rate, name), size) for name in rows})
        for name, cells in rows.items():
            cells.append(f"{times[name].best / slots / 1000:.0f}")
        cost = max(times[name].best for name in rows) / slots / 1000
        bars.append(Bar(f"rest detector at {rate} Hz, us per slot", BAR_US, cost, at_most=True))
    table.rows += [[name, *cells] for name, cells in rows.items()]
    table.notes.append("blocks of 10 s; there are 4 slots a second")
    return [table], bars


def _process(samples: SampleBlock, size: int) -> None:
    stage = RestDetector()
    for start in range(0, len(samples), size):
        stage.process(samples.rows(start, start + size))
