"""The vertical earth rate in a unit that is laid in several poses: the same on all three gyros.

A gyro along whose axis the specific force is a sees the earth rate's vertical part, rate x sin(latitude) x
a/g, up or down.  A sensitivity to g of its own has another value for each gyro, or acts across axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.channel import Declared, ordinary, residual_rms
from imumon.effects.base import Effect
from imumon.effects.drift import Drift
from imumon.effects.thermal_lag import ThermalLag
from imumon.effects.warm_up import WarmUp
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY

ALLOWANCE = 1.05
SIGMAS = 3.0
SPREAD = 0.15
LAGS_S = (60.0, 250.0, 1000.0)
INDEPENDENT = 10.0
"""Blocks that count as one, for noise that is slow and for what the model lacks."""


@dataclass(frozen=True, slots=True)
class VerticalRate:
    """rad/s per m/s² along the own axis, and the latitude that it means."""

    per_force: float

    @property
    def latitude_deg(self) -> float:
        """Latitude, north positive where the specific force at rest points up."""
        sine = self.per_force * STANDARD_GRAVITY / EARTH_RATE
        return float(np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))))


def vertical_rate(
    runs: Sequence[RunBlocks], channels: Sequence[str], temperatures: dict[str, str], declared: Declared
) -> VerticalRate | None:
    """Return what the three gyros have in common, or None when it is not the earth rate."""
    if len(channels) != 3:
        return None
    found, sigma = [], []
    for axis, name in enumerate(channels):
        temperature = temperatures[name]
        forces = [_force(run) for run in runs]
        if any(force is None for force in forces):
            return None
        force = np.concatenate([part for part in forces if part is not None])
        values = np.concatenate([run.mean[name] for run in runs])
        beside = np.concatenate([_beside(run, temperature, declared) for run in runs])
        columns = np.column_stack([declared.training(runs, temperature), beside, force])
        found.append(ordinary(columns, values)[-3 + axis])
        spread = float(np.std(force[:, axis])) * np.sqrt(len(values) / INDEPENDENT)
        sigma.append(residual_rms(columns, values) / spread if spread > 0 else np.inf)
    mean = float(np.mean(found))
    limit = np.maximum(SIGMAS * np.array(sigma), SPREAD * abs(mean))
    same = bool(np.all(np.abs(np.array(found) - mean) <= limit))
    seen = abs(mean) > SIGMAS * float(np.max(sigma)) / np.sqrt(3)
    if same and seen and abs(mean) * STANDARD_GRAVITY <= ALLOWANCE * EARTH_RATE:
        return VerticalRate(mean)
    return None


def without(runs: Sequence[RunBlocks], channels: Sequence[str], rate: VerticalRate) -> list[RunBlocks]:
    """Return the runs with the vertical earth rate taken from the gyros."""
    found = []
    for run in runs:
        force = _force(run)
        if force is None:
            found.append(run)
            continue
        changed = {name: run.mean[name] - rate.per_force * force[:, at] for at, name in enumerate(channels)}
        found.append(replace(run, mean={**run.mean, **changed}))
    return found


def _beside(run: RunBlocks, temperature: str, declared: Declared) -> FloatArray:
    """Return what else a bias may follow, so that it is not taken for a pose, (n, k)."""
    middle, half = declared.middle_degc, declared.half_span_degc
    effects: list[Effect] = [
        *(ThermalLag(time_constant_s=tau, middle=middle, half_span=half) for tau in LAGS_S),
        *(WarmUp(time_constant_s=tau) for tau in LAGS_S),
        Drift(),
    ]
    return np.column_stack([run.average(effect.columns(run.drives[temperature])) for effect in effects])


def _force(run: RunBlocks) -> np.ndarray[tuple[int, int], np.dtype[np.float64]] | None:
    accel = next((drive.accel for drive in run.drives.values()), None)
    return None if accel is None else run.average(accel)
