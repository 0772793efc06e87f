"""Slot means: a plain sum over each ten seconds, whatever the division of the stream; quiet slots rest."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from imumon.blocks import ColumnArray, IntArray, SampleBlock
from imumon.recordings.reduced import ACCEL, GYRO, Reduced, reduce

NAMES = ("gyro_x", "temperature", "accel_x")
SLOT_NS = 10_000_000_000


def stream(n: int = 5000, seed: int = 0) -> SampleBlock:
    """Return samples at 17 Hz with gaps, restarts, missing values and an accelerometer that never comes."""
    random = np.random.default_rng(seed)
    segment = np.sort(random.integers(0, 3, n))
    step = np.where(random.random(n) < 0.002, 25_000_000_000, 58_823_529)
    gyro = 1e3 + random.standard_normal(n)
    gyro[random.random(n) < 0.3] = np.nan
    return SampleBlock(
        {
            "device_time_ns": np.cumsum(step) - segment * 7_000_000_000_000,
            "segment": segment,
            "gyro_x": gyro,
            "temperature": random.standard_normal(n),
            "at_rest": (random.random(n) < 0.999).astype(np.int64),
        }
    )


def reduced(block: SampleBlock, size: int) -> Reduced:
    pieces = (block.rows(at, min(at + size, len(block))) for at in range(0, len(block), size))
    return reduce(pieces, NAMES, 10.0)


def groups(block: SampleBlock) -> tuple[list[IntArray], IntArray]:
    """Return the rows of each slot, and the time at which it begins."""
    time, segment = block["device_time_ns"], block["segment"]
    origin = np.array([time[segment == s][0] for s in segment])
    number = (time - origin) // SLOT_NS
    begins = np.flatnonzero(np.diff(segment, prepend=-1) | np.diff(number, prepend=0))
    return np.split(np.arange(len(time)), begins[1:]), (origin + number * SLOT_NS)[begins]


def test_a_slot_has_what_a_plain_sum_over_its_rows_gives() -> None:
    block = stream()
    got, (rows, start_ns) = reduced(block, 5000), groups(block)
    assert len(got) > 30
    np.testing.assert_array_equal(got.start_ns, start_ns)
    np.testing.assert_array_equal(got.segment, [block["segment"][g[0]] for g in rows])
    np.testing.assert_array_equal(got.run, got.segment)
    time = block["device_time_ns"]
    np.testing.assert_allclose(got.span_s, [(time[g[-1]] - time[g[0]]) * 1e-9 for g in rows])
    np.testing.assert_allclose(got.rest_share, [block["at_rest"][g].mean() for g in rows], rtol=1e-12)
    for name in ("gyro_x", "temperature"):
        values = [block[name][g][np.isfinite(block[name][g])] for g in rows]
        at = NAMES.index(name)
        np.testing.assert_array_equal(got.count[:, at], [len(v) for v in values])
        np.testing.assert_allclose(got.of(name), [v.mean() for v in values], rtol=1e-12)
        spread = [v.var(ddof=1) if len(v) > 1 else np.nan for v in values]
        np.testing.assert_allclose(got.variance[:, at], spread, rtol=1e-9)
    assert not got.has("accel_x")


@pytest.mark.parametrize("size", [1, 13, 4999])
def test_the_division_of_the_stream_does_not_matter(size: int) -> None:
    got, expected = reduced(stream(), size), reduced(stream(), 5000)
    for field in fields(Reduced):
        np.testing.assert_array_equal(getattr(got, field.name), getattr(expected, field.name))


def test_nothing_gives_no_slot() -> None:
    assert len(reduce([], NAMES, 10.0)) == 0


def resting(n: int = 6000) -> dict[str, ColumnArray]:
    """Return 600 s at 10 Hz of a unit at rest that nobody judged."""
    random = np.random.default_rng(1)
    columns: dict[str, ColumnArray] = {name: 1e-3 * random.standard_normal(n) for name in GYRO}
    columns |= {
        name: level + 2e-3 * random.standard_normal(n) for name, level in zip(ACCEL, (0, 0, 9.8), strict=True)
    }
    return {"device_time_ns": np.arange(n) * 100_000_000, "segment": np.zeros(n, np.int64), **columns}


def test_without_a_verdict_a_slot_that_scatters_or_tilts_does_not_rest() -> None:
    columns = resting()
    columns["gyro_y"][2000:2100] *= 10.0
    columns["accel_x"][4000:4100] += 1.0
    rest = reduce([SampleBlock(columns)], (*GYRO, *ACCEL), 10.0).at_rest()
    assert not rest[[20, 40]].any()
    assert rest[:20].all()
    assert rest[43:].all()


def test_the_verdict_of_the_detector_counts_where_there_is_one() -> None:
    judged = np.ones(6000, np.int64)
    judged[3005] = 0
    columns = resting() | {"at_rest": judged}
    columns["gyro_x"] = columns["gyro_x"].copy()
    columns["gyro_x"][3005] += 1.0
    rest = reduce([SampleBlock(columns)], (*GYRO, *ACCEL), 10.0).at_rest()
    np.testing.assert_array_equal(np.flatnonzero(~rest), [30])
