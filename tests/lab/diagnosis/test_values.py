"""Faults of single samples are named as what they are, and sound samples are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.prepare import faults, without_standstill
from imumon.lab.diagnosis.runs import KEPT, Run, Samples, Watcher
from tests.lab.diagnosis.units import DPH, ramps, run

SECONDS, RATE = 600, 50
N = SECONDS * RATE


def watched(change: Callable[[FloatArray, FloatArray], FloatArray], sd: float = 1.0) -> Run:
    """Return a run of a channel that wanders by 30 with the temperature, and what was seen of its samples."""
    random = np.random.default_rng(3)
    warmth = np.linspace(10.0, 40.0, N)
    values = change(0.2 * warmth + sd * random.standard_normal(N), warmth)
    watcher = Watcher(["gyro_x"])
    blocks = [SampleBlock({"gyro_x": values[i : i + 777]}) for i in range(0, N, 777)]
    assert sum(map(len, watcher.through(blocks))) == N
    seconds = values.reshape(SECONDS, RATE)
    return Run(
        "a run",
        np.arange(SECONDS, dtype=np.float64) + 0.5,
        {"gyro_x": np.full(SECONDS, float(RATE))},
        {"gyro_x": seconds.mean(axis=1), "temperature": warmth.reshape(SECONDS, RATE).mean(axis=1)},
        {"gyro_x": seconds.var(axis=1, ddof=1)},
        np.ones(SECONDS),
        samples=watcher.samples(),
    )


def drop(values: FloatArray, _: FloatArray) -> FloatArray:
    return np.where(np.random.default_rng(1).random(N) < 0.02, -50.0, values)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda v, _: np.round(v / 4.0) * 4.0, "quantized: steps of 4"),
        (lambda v, _: np.where(np.abs(v - 5.0) < 0.8, 5.0, v), "frequent value"),
        (lambda v, _: np.minimum(v, 7.0), "frequent value"),
        (drop, "frequent value, as of a dead-band, saturation or dropouts: 1.9% of the samples are -50"),
    ],
)
def test_a_fault_is_named_as_what_it_is(
    change: Callable[[FloatArray, FloatArray], FloatArray], said: str
) -> None:
    found = [*faults([watched(change)], "gyro_x", 0.02)]
    assert len(found) == 1
    assert found[0].startswith(said)


@pytest.mark.parametrize("value", [5.0, 1e3])
def test_what_stood_still_is_not_counted_again_as_a_value_that_comes_too_often(value: float) -> None:
    def frozen(values: FloatArray, _: FloatArray) -> FloatArray:
        return np.where(np.abs(np.arange(N) - 21_000) <= 1000, value, values)

    remarks: list[str] = []
    left = without_standstill(watched(frozen), ["gyro_x"], remarks)
    assert remarks == ["a run: gyro_x is stuck or saturated for 40 s; they are left out"]
    assert faults([left], "gyro_x", 0.02) == {}


def test_a_sensor_that_is_stuck_for_most_of_a_run_is_not_taken_for_one_of_too_few_digits() -> None:
    """Its values were kept, as those of one whose digits are coarser than its noise."""

    def frozen(values: FloatArray, _: FloatArray) -> FloatArray:
        return np.where(np.arange(N) >= 12_000, 5.0, values)

    remarks: list[str] = []
    left = without_standstill(watched(frozen), ["gyro_x"], remarks)
    assert remarks == ["a run: gyro_x is stuck or saturated for 360 s; they are left out"]
    assert np.isfinite(left.mean["gyro_x"]).sum() == 240
    rare = without_standstill(watched(lambda v, _: np.round(v / 9.0), sd=0.3), ["gyro_x"], remarks)
    assert remarks[1].endswith("too few digits")
    assert np.isfinite(rare.mean["gyro_x"]).all()


@pytest.mark.parametrize("step", [0.0, 0.01, 0.5, 1.0])
@pytest.mark.parametrize("scale", [1.0, 1e-5, 3e4])
def test_sound_samples_have_no_fault_however_they_are_rounded(step: float, scale: float) -> None:
    def rounded(values: FloatArray, _: FloatArray) -> FloatArray:
        return scale * (np.round(values / step) * step if step else values)

    assert faults([watched(rounded)], "gyro_x", 0.02 * scale) == {}


def test_what_is_kept_of_a_long_recording_is_spread_over_it() -> None:
    watcher, n = Watcher(["gyro_x"]), 5 * KEPT
    for start in range(0, n, 5000):
        values = np.arange(start, start + 5000, dtype=np.float64)
        list(watcher.through([SampleBlock({"gyro_x": values})]))
    kept = np.concatenate(watcher._kept["gyro_x"])[:, 0]
    assert KEPT / 4 < len(kept) < 2 * KEPT
    assert kept[0] < 10
    assert kept[-1] > n - 100


def test_a_channel_that_comes_late_is_watched_as_well() -> None:
    watcher, values = Watcher(["gyro_x", "gyro_y"]), np.random.default_rng(1).standard_normal(KEPT)
    blocks = [SampleBlock({"gyro_x": values})] * 2 + [SampleBlock({"gyro_x": values, "gyro_y": values})]
    assert len(list(watcher.through(blocks))) == 3
    assert set(watcher.samples()) == {"gyro_x", "gyro_y"}


def test_a_faulty_axis_decides_nothing_of_the_others() -> None:
    """A drift of its fault was named on axes that warm up."""
    axes, runs = ("gyro_x", "gyro_y", "gyro_z"), []
    for seed, up, rate in ((1, True, 1.5), (2, False, 1.5), (3, True, 1.0)):
        one = run(seed, *ramps(2400, up, rate), lambda time, _: 6.0 * np.exp(-time / 600.0), axes)
        one.mean["gyro_x"] = one.mean["gyro_x"] + 60.0 * DPH * one.time_s / 2400.0
        runs.append(replace(one, samples={"gyro_x": Samples(0.0, 1.0, atom=0.0, atom_share=0.3)}))
    faulty, *sound = diagnose(runs[:2], runs[2:]).verdicts
    assert faulty.row.state == "faulty"
    assert [one.claims[0].finding.name for one in sound] == ["warm_up", "warm_up"]
