"""The gyro bias of simulated sessions, forward and smoothed: errors, errors over sigma, disagreement."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import GyroBias
from imumon.estimation.rest.stage import RestDetector
from imumon.estimation.smoothing.backward import backward
from imumon.estimation.smoothing.record import Record, Recorder
from imumon.estimation.smoothing.stage import SmoothedEstimates
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.pipeline import Estimator
from imumon.simulation.unit import load_scenario
from imumon.simulation.unit.unit import SimulatedUnit

CASES = (
    ("self-heating", 300),
    ("self-heating", 1200),
    ("self-heating", 7200),
    ("athermal-ramp", 600),
    ("crs05-ramp", 900),
    ("crs05-ramp-hysteresis", 1800),
    ("warm-up", 900),
)
"""Scenario and seconds."""
RATE_HZ = 100
FIRST_SEED = 100
PIECE_S = 60


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="one seed of the shortest session")
    given = parser.parse_args()
    print("| scenario | forward [°/h] | smoothed [°/h] | error over sigma, rms | largest | disagreement |")
    print("|---|---|---|---|---|---|")
    for name, seconds in CASES[:1] if given.quick else CASES:
        seeds = range(FIRST_SEED, FIRST_SEED + (1 if given.quick else given.seeds))
        found = np.array([measured(name, seconds, seed) for seed in seeds])
        forward, smoothed, z = (_three(found[:, :, k].mean(0)) for k in (0, 1, 2))
        apart = f"{found[:, :, 4].min():.2f} to {found[:, :, 4].max():.2f}"
        label = f"{name}, {seconds / 60:g} min"
        print(
            f"| {label} | {forward} | {smoothed} | {z} | {found[:, :, 3].max():.1f} | {apart} |", flush=True
        )


def measured(name: str, seconds: int, seed: int) -> FloatArray:
    """Return for each gyro: rms error forward and smoothed, °/h, rms and largest z, disagreement, (3, 5)."""
    recorder, truths = Recorder(), []
    for block, truth in played(name, seconds, seed):
        recorder.add(block)
        truths.append(truth)
    record = recorder.finish()
    against_time = backward(record, TemperatureRate(), GyroBias(mode="learned"))
    stage = SmoothedEstimates(record, against_time)
    rows = np.minimum(record.stop - 1, seconds * RATE_HZ - 1)
    slots = SampleBlock({"row": np.arange(seconds * RATE_HZ)})
    smoothed = {key: values[rows] for key, values in stage.process(slots).items()}
    result = np.empty((3, 5))
    for j, axis in enumerate("xyz"):
        true = np.concatenate([truth[:, j] for truth in truths])[rows]
        result[j] = _judged(record, smoothed, axis, true, stage.disagreement[f"gyro_bias_{axis}"])
    return result


def played(name: str, seconds: int, seed: int) -> Iterator[tuple[SampleBlock, FloatArray]]:
    """Yield samples behind the stages, and the bias with the earth rate of the latest rest, (n, 3)."""
    unit = SimulatedUnit(load_scenario(name).played(RATE_HZ, "FRD"), seed)
    stages: list[Estimator] = [TemperatureRate(), RestDetector(), GyroBias(mode="learned")]
    kept = np.zeros(3)
    for begun in range(0, seconds, PIECE_S):
        block, truth = unit.run(min(PIECE_S, seconds - begun) * RATE_HZ)
        for stage in stages:
            block = block.with_columns(stage.process(block))
        rate, bias = truth.vector("rate"), truth.vector("gyro_bias")
        assert rate is not None
        assert bias is not None
        rates = np.vstack([kept, rate])
        latest = np.maximum.accumulate(np.where(truth["at_rest"] == 1, np.arange(1, len(rate) + 1), 0))
        kept = rates[latest[-1]]
        yield block, bias + rates[latest]


def _judged(
    record: Record, smoothed: dict[str, FloatArray], axis: str, true: FloatArray, apart: float
) -> list[float]:
    error = smoothed[f"gyro_bias_smoothed_{axis}"] - true
    before = record.columns[f"gyro_bias_{axis}"] - true
    z = error / smoothed[f"gyro_bias_smoothed_sd_{axis}"]
    rms = [float(np.sqrt(np.nanmean(part**2))) / DEG_PER_H for part in (before, error)]
    return [*rms, float(np.sqrt(np.nanmean(z**2))), float(np.nanmax(np.abs(z))), apart]


def _three(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" if value >= 10 else f"{value:.2f}" for value in values)


if __name__ == "__main__":
    main()
