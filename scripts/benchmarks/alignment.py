"""Alignment: time of a sample in the stage, coarse and fine, and of a block of the live view."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.measure import Bar, Table, measure
from imumon.blocks import SampleBlock
from imumon.estimation.alignment.stage import Alignment
from imumon.geodesy import EARTH_RATE

SECONDS, LATITUDE_DEG = 120, 36.0
RATES_HZ = (100, 1000)
BLOCKS_S = (10.0, 0.05)
BAR_US = 1.0


def run() -> tuple[list[Table], list[Bar]]:
    """Measure a navigation-grade unit at rest, in long blocks and in those of a live run."""
    headings = ["blocks", *(f"{rate} Hz" for rate in RATES_HZ)]
    table = Table("Alignment, us per sample", headings)
    rows: dict[str, list[str]] = {f"{length:g} s": [] for length in BLOCKS_S}
    bars = []
    for rate in RATES_HZ:
        record = _record(rate)
        cases = {f"{length:g} s": partial(_stage, _cut(record, round(length * rate))) for length in BLOCKS_S}
        times = measure(cases)
        costs = {name: times[name].best / len(record) / 1000 for name in cases}
        for name, cost in costs.items():
            rows[name].append(f"{cost:.3f}")
        longest = next(iter(costs.values()))
        bars.append(Bar(f"alignment at {rate} Hz, us per sample", BAR_US, longest, at_most=True))
    table.rows += [[name, *cells] for name, cells in rows.items()]
    table.notes.append(f"{SECONDS} s from the start on; all estimators, renewed once a second")
    return [table], bars


def _record(rate: int) -> SampleBlock:
    n, rng = SECONDS * rate, np.random.default_rng(0)
    north, down = (f(np.radians(LATITUDE_DEG)) * EARTH_RATE for f in (np.cos, np.sin))
    gyro = rng.standard_normal((n, 3)) * 7e-8 * np.sqrt(rate) + [north, 0.0, -down]
    accel = rng.standard_normal((n, 3)) * 5e-5 * np.sqrt(rate) + [0.0, 0.0, -9.8]
    return SampleBlock(
        {
            "device_time_ns": np.arange(n) * (1_000_000_000 // rate),
            "segment": np.zeros(n, np.int64),
            **{f"gyro_{axis}": gyro[:, j].copy() for j, axis in enumerate("xyz")},
            **{f"accel_{axis}": accel[:, j].copy() for j, axis in enumerate("xyz")},
        }
    )


def _cut(record: SampleBlock, size: int) -> list[SampleBlock]:
    return [record.rows(start, start + size) for start in range(0, len(record), size)]


def _stage(blocks: list[SampleBlock]) -> None:
    stage = Alignment(None, LATITUDE_DEG, "FRD")
    for block in blocks:
        stage.process(block)
