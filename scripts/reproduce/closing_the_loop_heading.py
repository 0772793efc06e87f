"""Heading: a warm-up found in recorded alignments feeds the next one; error before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from alignment_runs import ACCEL_BIAS_UG

from imumon.blocks import SampleBlock
from imumon.estimation.alignment.parameters import AlignmentParameters, KnownWarmUp, known_warm_up
from imumon.estimation.alignment.stage import Alignment
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.runs import Run, collect
from imumon.simulation.unit import SimulatedUnit
from imumon.simulation.unit.scenario import Scenario

LATITUDE_DEG, HEADING_DEG = 45.0, 30.0
AMPLITUDE_UG, TAU_S = (84.0, -60.0, 0.0), 150.0
TRAINING_S, ALIGNMENT_S = 1800.0, 300.0
ARW_DEG_PER_SQRT_H = 2.4e-4
SEEDS = 8
ESTIMATORS = ("gyro_mean", "hann_mean", "joint", "joint, known warm-up")
AT_S = (60, 120, 180, 300)


def _scenario(seconds: float) -> Scenario:
    said: dict[str, Any] = {
        "format": "imumon-scenario/1",
        "unit": {
            "gyro_noise": {"arw_deg_per_sqrt_h": ARW_DEG_PER_SQRT_H},
            "accel_noise": {"vrw_m_per_s_per_sqrt_s": 1.0e-5},
            "accel_warm_up": {"amplitude_ug": list(AMPLITUDE_UG), "tau_s": TAU_S},
        },
        "rate_hz": 50,
        "duration_s": seconds,
        "axes": "FRD",
        "latitude_deg": LATITUDE_DEG,
        "attitude": {"roll_deg": 0.0, "pitch_deg": 0.0, "heading_deg": HEADING_DEG},
        "chamber": {"start_degc": 25.0},
    }
    return Scenario.model_validate(said)


def _sent(seconds: float, seed: int) -> SampleBlock:
    plan = _scenario(seconds)
    return SimulatedUnit(plan, seed).run(plan.samples)[0]


def _run(seed: int) -> Run:
    return collect([_sent(TRAINING_S, seed)], f"recorded alignment {seed}")[0]


def heading() -> int:
    """Print what was found, and the heading error at some times, without and with it."""
    diagnosis = diagnose([_run(101), _run(102)], [_run(103)], sensors=("accel",))
    for verdict in diagnosis.verdicts:
        print(f"{verdict.name}: {verdict.summary}")
    known = known_warm_up(extended_model(diagnosis))
    print(f"\nput in: {AMPLITUDE_UG} ug, {TAU_S} s; in the model file: {known}\n")
    total = np.array([_errors(seed, known) for seed in range(SEEDS)])
    rms = np.sqrt(np.mean(total**2, axis=0))
    print("rms heading error in deg, by estimator\n")
    print("| s after power-on | " + " | ".join(ESTIMATORS) + " |")
    print("|---" * (len(ESTIMATORS) + 1) + "|")
    for at, second in enumerate(AT_S):
        print(f"| {second} | " + " | ".join(f"{value:.4f}" for value in rms[:, at]) + " |")
    return 0


def _errors(seed: int, known: KnownWarmUp | None) -> list[list[float]]:
    """Return the heading error in degrees of each estimator at some times of one alignment."""
    block = _sent(ALIGNMENT_S, seed)
    free = Alignment(AlignmentParameters(accel_bias_sd_ug=ACCEL_BIAS_UG), LATITUDE_DEG, "FRD").process(block)
    told = AlignmentParameters(known_warm_up=known, accel_bias_sd_ug=ACCEL_BIAS_UG)
    found = Alignment(told, LATITUDE_DEG, "FRD").process(block)
    columns = (free["heading_gyro_mean"], free["heading_hann_mean"], free["heading"], found["heading"])
    rows = [min(round(second * 50), len(block)) - 1 for second in AT_S]
    values = np.array([np.degrees(np.asarray(column)[rows]) for column in columns])
    wrapped: list[list[float]] = ((values - HEADING_DEG + 180.0) % 360.0 - 180.0).tolist()
    return wrapped
