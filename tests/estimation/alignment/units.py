"""Simulated units for the alignment, and running them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.simulation.unit import SimulatedUnit
from imumon.simulation.unit.scenario import Scenario

NAVIGATION_ARW = 2.43e-4
"""deg/√h: 1e-6 rad/s per sample at 200 Hz."""
MEMS_ARW = 0.28
LATITUDE = math.radians(36.0)
EARTH = EARTH_RATE * np.array([0.0, math.cos(LATITUDE), math.sin(LATITUDE)])
UP = np.array([0.0, 0.0, 1.0])
INPUTS = ("device_time_ns", "segment", *(f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"))


def scenario(
    seconds: float = 120.0,
    *,
    arw: float = NAVIGATION_ARW,
    rate_hz: float = 200.0,
    attitude: Sequence[float] = (0.0, 0.0, 30.0),
    warm_up: tuple[float, float] = (83.7, 150.0),
    latitude: float = 36.0,
    axes: str = "FRD",
    motion: Sequence[Mapping[str, Any]] = (),
    **unit: Any,
) -> Scenario:
    """Return a scenario of a unit at rest; `warm_up` is µg of both level accelerometers, and s."""
    roll, pitch, heading = attitude
    amplitude, tau = warm_up
    return Scenario.model_validate(
        {
            "format": "imumon-scenario/1",
            "unit": {
                "gyro_noise": {"arw_deg_per_sqrt_h": arw},
                "accel_warm_up": {"amplitude_ug": [amplitude, amplitude, 0.0], "tau_s": tau},
                **unit,
            },
            "rate_hz": rate_hz,
            "duration_s": seconds,
            "axes": axes,
            "latitude_deg": latitude,
            "attitude": {"roll_deg": roll, "pitch_deg": pitch, "heading_deg": heading},
            "chamber": {"start_degc": 25.0},
            "motion": list(motion),
        }
    )


def samples(plan: Scenario, seed: int = 0) -> SampleBlock:
    """Return what the unit sends, without what the alignment must not know."""
    block, _ = SimulatedUnit(plan, seed).run(plan.samples)
    return SampleBlock({name: block[name] for name in INPUTS})


def aligned(
    block: SampleBlock, parameters: Mapping[str, Any] | None = None, latitude: float = 36.0, **options: Any
) -> tuple[Alignment, Mapping[str, ColumnArray]]:
    """Run a new stage over a block; return it and what it added."""
    stage = Alignment(AlignmentParameters.model_validate(parameters or {}), latitude, **options)
    return stage, stage.process(block)


def in_pieces(stage: Alignment, block: SampleBlock, cuts: Sequence[int]) -> Mapping[str, ColumnArray]:
    """Run a stage over a block that is cut at these rows."""
    edges = [0, *cuts, len(block)]
    pieces = [block.rows(a, b) for a, b in itertools.pairwise(edges)]
    return join([SampleBlock(stage.process(piece)) for piece in pieces]).columns


def error_deg(heading: float, truth_deg: float) -> float:
    """Return the error of a heading in rad, in degrees, -180 to 180."""
    return float((np.rad2deg(heading) - truth_deg + 180.0) % 360.0 - 180.0)


def sent(
    turned: Rotation, hz: float, scale: float = 0.0, seed: int = 0, force_bias: float = 3e-4
) -> tuple[SampleBlock, float]:
    """Return what a fibre-optic unit sends that has these attitudes, east-north-up, and its last heading.

    `scale` and `force_bias`, m/s², are standard deviations.
    """
    rng = np.random.default_rng(seed)
    attitude = turned * Rotation.from_euler("ZYX", [0.7, -0.01, 0.02])
    rate = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * hz + attitude[1:].inv().apply(EARTH)
    rate = rate @ (np.eye(3) + scale * rng.normal(size=(3, 3))).T
    rate += math.radians(1e-3) / 60.0 * math.sqrt(hz) * rng.normal(size=rate.shape)
    force = attitude[1:].inv().apply(STANDARD_GRAVITY * UP) + force_bias * rng.normal(size=3)
    force += 5e-5 * math.sqrt(hz) * rng.normal(size=rate.shape)
    n = len(rate)
    columns = {
        "device_time_ns": np.round(np.arange(n) * 1e9 / hz).astype(np.int64),
        "segment": np.zeros(n, np.int64),
        **{f"gyro_{axis}": rate[:, j] for j, axis in enumerate("xyz")},
        **{f"accel_{axis}": force[:, j] for j, axis in enumerate("xyz")},
    }
    ahead = attitude[-1].apply([1.0, 0.0, 0.0])
    return SampleBlock(columns), math.degrees(math.atan2(ahead[0], ahead[1]))
