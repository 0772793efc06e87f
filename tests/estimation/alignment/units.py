"""Simulated units for the alignment, and running them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment
from imumon.simulation.unit import SimulatedUnit
from imumon.simulation.unit.scenario import Scenario

NAVIGATION_ARW = 2.43e-4
"""deg/√h: 1e-6 rad/s per sample at 200 Hz."""
MEMS_ARW = 0.28
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
