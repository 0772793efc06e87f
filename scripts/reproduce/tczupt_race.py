"""The race: a warm-up from 25 to 45 degC with rests of 10 s every 2 min; a unit without thermal effect."""

from __future__ import annotations

from collections.abc import Callable

import imufusion
import numpy as np
from tczupt_records import DPH, true_model
from vqf import VQF

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.rest.stage import RestDetector
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.estimation.zupt.stage import Mode, ZeroVelocity
from imumon.simulation.frames import earth_rate
from imumon.simulation.unit.scenario import load_scenario
from imumon.simulation.unit.unit import SimulatedUnit

RESTS = 3
WITH_MODEL = "TCZUPT (thermal, model)"
BLOCK = 1000
VERTICAL_EARTH = np.array([0.0, 0.0, earth_rate(40.93)[2]]) / DPH
"""What those who know no latitude count as bias of a level unit, deg/h."""


def prepared(scenario: str, seed: int) -> tuple[SampleBlock, FloatArray, FloatArray]:
    """Return samples with rest and temperature found by imumon itself, the true bias, and when it moved."""
    played = load_scenario(scenario)
    sent, truth = SimulatedUnit(played, seed).run(round(played.duration_s * played.rate_hz))
    block = sent
    for stage in (TemperatureRate(), RestDetector()):
        block = block.with_columns(stage.process(block))
    bias = truth.vector("gyro_bias")
    assert bias is not None
    return block, bias, truth["at_rest"]


def zero_velocity(mode: Mode, with_model: bool) -> Callable[[SampleBlock], FloatArray]:
    """Return a contestant: the stage."""

    def estimate(block: SampleBlock) -> FloatArray:
        model = true_model() if with_model else None
        stage = ZeroVelocity(None, model, mode, 40.93, 30.0)
        parts = [stage.process(block.rows(i, i + BLOCK)) for i in range(0, len(block), BLOCK)]
        return np.column_stack(
            [np.concatenate([part[f"gyro_bias_{axis}"] for part in parts]) for axis in "xyz"]
        )

    return estimate


def averaging(block: SampleBlock) -> FloatArray:
    """Return the mean rate of the last rest."""
    gyro, rest = block.gyro, block["at_rest"] == 1
    assert gyro is not None
    bias, total, count = np.full_like(gyro, np.nan), np.zeros(3), 0
    for i in range(len(gyro)):
        if rest[i]:
            total, count = total + gyro[i], count + 1
        elif count:
            total, count = np.zeros(3), 0
        bias[i] = total / count if count >= 100 else bias[i - 1]
    return bias


def fused(block: SampleBlock) -> FloatArray:
    """Return the bias of imufusion at 100 Hz, rad/s."""
    gyro = block.gyro
    assert gyro is not None
    bias, estimator = np.empty_like(gyro), imufusion.Bias()
    settings = imufusion.BiasSettings()
    settings.sample_rate = 100.0
    estimator.set_settings(settings)
    for i, degrees in enumerate(np.degrees(gyro)):
        estimator.update(degrees)
        bias[i] = estimator.get_offset()
    return np.radians(bias)


def vqf(block: SampleBlock) -> FloatArray:
    """Return the bias of VQF, rad/s."""
    gyro, accel = block.gyro, block.accel
    assert gyro is not None
    assert accel is not None
    up = np.array([1.0, -1.0, -1.0])  # it wants z up
    result = VQF(0.01).updateBatch(np.ascontiguousarray(gyro * up), np.ascontiguousarray(accel * up))
    return np.asarray(result["bias"] * up)


CONTESTANTS: dict[str, Callable[[SampleBlock], FloatArray]] = {
    "mean of the last rest": averaging,
    "imufusion": fused,
    "VQF": vqf,
    "ZUPT (standard)": zero_velocity("standard", False),
    "ZUPT (learned)": zero_velocity("learned", False),
    WITH_MODEL: zero_velocity("thermal", True),
}


def race() -> None:
    """Print the error of every contestant after three rests, deg/h, rms over axes and time."""
    print("\nRace: rms error after three rests, deg/h, over axes and time, in motion and at rest\n")
    names = ("warm-up", "warm-up-athermal")
    print("| contestant | " + " | ".join(names) + " |\n|---|" + "---|" * len(names))
    cells: dict[str, list[str]] = {name: [] for name in CONTESTANTS}
    for scenario in names:
        block, bias, rest = prepared(scenario, 0)
        ends = np.flatnonzero(np.diff(rest) < 0)
        first = int(ends[RESTS - 1]) + 1
        for name, estimate in CONTESTANTS.items():
            if name == WITH_MODEL and scenario != "warm-up":
                cells[name].append("-")  # the model is of the other unit
                continue
            off = (estimate(block) - bias)[first:] / DPH
            if "ZUPT" not in name:
                off -= VERTICAL_EARTH
            cells[name].append(f"{np.sqrt(np.nanmean(off**2)):.1f}")
    for name, row in cells.items():
        print(f"| {name} | " + " | ".join(row) + " |")
