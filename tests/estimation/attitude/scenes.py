"""Units that are turned by known angles, with the truth as a matrix from body axes to east-north-up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.simulation.unit.scenario import Scenario
from imumon.simulation.unit.unit import SimulatedUnit

NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
NORTH_DEG = float(np.degrees(np.arctan2(1.0, 20.0)))
"""Of the simulated field, clockwise from true north."""
TURNS = [
    {"kind": "turn", "at_s": at, "duration_s": 3.0, "roll_deg": roll, "pitch_deg": pitch, "heading_deg": turn}
    for at, roll, pitch, turn in [
        (40.0, 20.0, 0.0, 90.0),
        (60.0, -40.0, 25.0, -30.0),
        (80.0, 20.0, -25.0, 120.0),
    ]
]


@dataclass(frozen=True)
class Scene:
    block: SampleBlock
    attitude: FloatArray
    """(n, 3, 3)"""
    at_rest: FloatArray


def scene(
    axes: Literal["FRD", "FLU"] = "FRD",
    rate_hz: float = 100.0,
    seconds: float = 110.0,
    seed: int = 0,
    turns: bool = True,
) -> Scene:
    """A unit with a gyro bias of some hundred °/h: three turns, no attitude of its own."""
    scenario = Scenario.model_validate(
        {
            "format": "imumon-scenario/1",
            "unit": {
                "base": "athermal",
                "gyro_turn_on": {"offset_deg_per_h": [200.0, -300.0, 250.0]},
                "accel_turn_on": {"sd_mg": 3.0},
            },
            "rate_hz": rate_hz,
            "duration_s": seconds,
            "axes": axes,
            "latitude_deg": 45.0,
            "attitude": {"roll_deg": 5.0, "pitch_deg": -4.0, "heading_deg": 70.0},
            "chamber": {"start_degc": 25.0},
            "motion": TURNS if turns else [],
        }
    )
    block, truth = SimulatedUnit(scenario, seed).run(scenario.samples)
    q = block.quaternion
    assert q is not None
    attitude = matrices(q)
    if axes == "FRD":
        attitude = NED_TO_ENU @ attitude
    own = {"roll", "pitch", "yaw", *(f"q_{part}" for part in "wxyz")}
    sent = {name: values for name, values in block.columns.items() if name not in own}
    return Scene(SampleBlock(sent), attitude, np.asarray(truth["at_rest"] == 1))


def without_mag(block: SampleBlock) -> SampleBlock:
    return SampleBlock({name: values for name, values in block.columns.items() if not name.startswith("mag")})


def matrices(q: FloatArray) -> FloatArray:
    """Return matrices of quaternions w, x, y, z, (n, 3, 3)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray(np.angle(np.exp(1j * angle)))
