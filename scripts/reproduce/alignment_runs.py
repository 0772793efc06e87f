"""Seeded runs of a navigation-grade unit at rest, through the stage of the pipeline."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.report import Status
from imumon.estimation.alignment.stage import Alignment
from imumon.papers.self_alignment import Params, SelfAlignment
from imumon.simulation.unit import SimulatedUnit
from imumon.simulation.unit.scenario import Scenario

ESTIMATORS = ("gyro_mean", "hann_mean", "total_average", "curve_fit")
"""Beside the joint fit: the means of the gyros, and the published methods, which have no sigma."""
LATITUDE_DEG, AMPLITUDE_UG, RATE_HZ, SECONDS = 36.0, 83.7, 200.0, 300.0
ARW = 2.43e-4
"""deg/√h: 1e-6 rad/s per sample at 200 Hz."""
VRW = 5e-5
"""m/s/√s of the accelerometers: 5 µg/√Hz."""
ACCEL_BIAS_UG = 30.0
"""Of accelerometers of navigation grade, as they are declared."""
GYRO_BIAS = 0.002
"""deg/h, standard deviation of the gyros' bias from run to run."""
INPUTS = ("device_time_ns", "segment", *(f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"))


@dataclass(frozen=True)
class Case:
    """Errors of the unit besides the warm-up."""

    name: str
    arw: float = ARW
    vrw: float = 0.0
    gyro_bias: float = 0.0
    declared: bool = False

    @property
    def parameters(self) -> AlignmentParameters:
        """What the stage is told."""
        declared = self.gyro_bias if self.declared else None
        return AlignmentParameters(gyro_bias_sd_deg_per_h=declared, accel_bias_sd_ug=ACCEL_BIAS_UG)


CASES = (
    Case("gyro noise alone, declared without bias", declared=True),
    Case("accelerometer noise and gyro bias, too", vrw=VRW, gyro_bias=GYRO_BIAS),
    Case("the same, the gyro bias declared", vrw=VRW, gyro_bias=GYRO_BIAS, declared=True),
)


@dataclass(frozen=True)
class Run:
    """One run: errors and sigmas of each estimator and of the one shown, deg, once a second."""

    tau_s: float
    heading_deg: float
    error: Mapping[str, FloatArray]
    sd: Mapping[str, FloatArray]
    status: Status
    notices: Sequence[str]
    columns: Mapping[str, FloatArray]


def plan(
    case: Case, tau_s: float, heading_deg: float, seconds: float, motion: Sequence[Mapping[str, Any]] = ()
) -> Scenario:
    """Return the scenario of a run."""
    unit = {
        "gyro_noise": {"arw_deg_per_sqrt_h": case.arw},
        "gyro_turn_on": {"sd_deg_per_h": case.gyro_bias},
        "accel_noise": {"vrw_m_per_s_per_sqrt_s": case.vrw},
        "accel_warm_up": {"amplitude_ug": [AMPLITUDE_UG, AMPLITUDE_UG, 0.0], "tau_s": tau_s},
    }
    return Scenario.model_validate(
        {
            "format": "imumon-scenario/1",
            "unit": unit,
            "rate_hz": RATE_HZ,
            "duration_s": seconds,
            "latitude_deg": LATITUDE_DEG,
            "attitude": {"heading_deg": heading_deg},
            "chamber": {"start_degc": 25.0},
            "motion": list(motion),
        }
    )


def align(scenario: Scenario, seed: int, parameters: AlignmentParameters) -> Run:
    """Run a scenario through the stage."""
    sent, _ = SimulatedUnit(scenario, seed).run(scenario.samples)
    stage = Alignment(parameters, LATITUDE_DEG, "FRD")
    block = SampleBlock({name: sent[name] for name in INPUTS})
    out = {**stage.process(block), **SelfAlignment(Params(math.radians(LATITUDE_DEG))).process(block)}
    step = round(scenario.rate_hz)
    rows = slice(step - 1, None, step)
    truth = scenario.attitude.heading_deg
    error, sd = {}, {}
    for name in ("", *ESTIMATORS):
        column = next(c for c in ("heading" + f"_{name}" * bool(name), f"{name}_heading") if c in out)
        error[name or "shown"] = (np.degrees(out[column][rows]) - truth + 180.0) % 360.0 - 180.0
        sigma = out.get(f"{column}_sd", np.full(len(block), np.nan))
        sd[name or "shown"] = np.degrees(sigma[rows])
    warm_up = scenario.unit.accel_warm_up
    tau = warm_up.tau_s if warm_up is not None else math.nan
    kept = {name: values[rows].copy() for name, values in out.items()}
    return Run(tau, truth, error, sd, stage.status, stage.notices(), kept)


def runs(case: Case, count: int) -> Iterator[Run]:
    """Yield seeded runs: time constant even over 80 to 300 s, heading over the circle."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        tau, heading = rng.uniform(80.0, 300.0), rng.uniform(0.0, 360.0)
        yield align(plan(case, tau, heading, SECONDS), seed, case.parameters)


def within_from(error: FloatArray, limit: float = 0.05) -> float:
    """Return the second from which the error stays within the limit; infinite for never."""
    bad = np.flatnonzero(~(np.abs(error) <= limit))
    if not len(bad):
        return 1.0
    return float(bad[-1] + 2) if bad[-1] + 1 < len(error) else math.inf


EVENTS: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "nothing": (),
    "door slam at 100 s": (
        {
            "kind": "bump", "at_s": 100.0, "frequency_hz": 15.0, "decay_s": 0.3,
            "acceleration_m_per_s2": [0.05, 0.05, 0.1], "tilt_deg": [0.005, 0.005, 0.0],
        },
    ),
    "knock in the coarse alignment, at 20 s": (
        {
            "kind": "bump", "at_s": 20.0, "frequency_hz": 25.0, "decay_s": 0.3,
            "acceleration_m_per_s2": [0.3, 0.2, 0.1],
        },
    ),
    "a person leans on the table from 100 to 130 s": (
        {"kind": "turn", "at_s": 100.0, "duration_s": 0.8, "roll_deg": 0.03, "pitch_deg": 0.02},
        {"kind": "turn", "at_s": 130.0, "duration_s": 0.8, "roll_deg": -0.03, "pitch_deg": -0.02},
    ),
    "turned by 90 deg at 100 s": ({"kind": "turn", "at_s": 100.0, "duration_s": 3.0, "heading_deg": 90.0},),
    "tripod begins to sink at 100 s, 0.07 deg/h": (
        {"kind": "rotation", "at_s": 100.0, "duration_s": 500.0, "pitch_deg_per_s": 2e-5},
    ),
    "tripod sinks from the start, 0.07 deg/h": (
        {"kind": "rotation", "at_s": 0.5, "duration_s": 600.0, "pitch_deg_per_s": 2e-5},
    ),
}  # fmt: skip
"""Disturbances, as events of a scenario."""
TURNED = {"turned by 90 deg at 100 s": 90.0}
