"""The earth rate in a unit that is laid in several poses: one vector, measured by three gyros.

A gyro along whose axis the specific force is a sees the earth rate's vertical part, rate x sin(latitude) x
a/g, up or down; with a magnetometer its horizontal part is measured too.  A sensitivity to g of its own has
another value for each gyro, or acts across axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import Effect
from imumon.effects.drift import Drift
from imumon.effects.step import EDGE_BLOCKS
from imumon.effects.thermal_lag import ThermalLag
from imumon.effects.warm_up import WarmUp
from imumon.filters.least_squares import INDEPENDENT, least_squares
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.lab.diagnosis.blocks import RunBlocks, specific_force
from imumon.lab.diagnosis.channel import Declared
from imumon.lab.diagnosis.choice import PROVEN

ALLOWANCE = 1.05
SIGMAS = 3.0
SPREAD = 0.15
LAGS_S = (60.0, 250.0, 1000.0)
LEAST_FREE = 1e-3
"""Share of a jump, or of one beside another, that is left beside the rest, below which it is not resolved."""
LEAST_TURN = 0.5
"""Change of a direction's component, about 30°, from which on its part of the earth rate is looked for."""
LEAST_LEVEL = 0.1
"""Share of the magnetic field that is horizontal, below which it does not say where north is."""


@dataclass(frozen=True, slots=True)
class EarthRate:
    """The earth rate in rad/s along the specific force at rest, magnetic north, and east; 0 where unknown.

    `upright` and `level` say whether the poses show the part along the vertical, and the horizontal one.
    """

    up: float
    north: float
    east: float
    upright: bool
    level: bool

    @property
    def latitude_deg(self) -> float:
        """Latitude, north positive where the specific force at rest points up."""
        if self.upright and self.level:
            return float(np.degrees(np.arctan2(self.up, self.across)))
        if self.upright:
            return float(np.degrees(np.arcsin(np.clip(self.up / EARTH_RATE, -1.0, 1.0))))
        return float(np.degrees(np.arccos(np.clip(self.across / EARTH_RATE, -1.0, 1.0))))

    @property
    def across(self) -> float:
        """Its horizontal part."""
        return float(np.hypot(self.north, self.east))

    @property
    def vector(self) -> FloatArray:
        """Up, north and east, (3,)."""
        return np.array([self.up, self.north, self.east])


def earth_rate(
    runs: Sequence[RunBlocks], channels: Sequence[str], temperatures: dict[str, str], declared: Declared
) -> EarthRate | None:
    """Return what the three gyros have in common, or None when it is not the earth rate."""
    directions = _directions(runs) if len(channels) == 3 else None
    if directions is None:
        return None
    varies = np.ptp(directions, axis=0).max(axis=0) >= LEAST_TURN  # by axis, up, north, east
    varies[1:] = varies[1:].any()
    for chosen in (varies, varies & [True, False, False]):
        if chosen.any():
            found = _common(runs, channels, temperatures, declared, directions[:, :, chosen])
            if found is not None:
                vector = np.zeros(3)
                vector[chosen] = found
                up, north, east = vector.tolist()
                return EarthRate(up, north, east, bool(chosen[0]), bool(chosen[1]))
    return None


def turned(runs: Sequence[RunBlocks]) -> bool:
    """Tell whether these runs show any part of the earth rate by turns of the unit."""
    directions = [part for run in runs if (part := _directions([run])) is not None]
    return any(float(np.ptp(part, axis=0).max()) >= LEAST_TURN for part in directions)


def without(runs: Sequence[RunBlocks], channels: Sequence[str], rate: EarthRate) -> list[RunBlocks]:
    """Return the runs with the earth rate taken from the gyros."""
    found = []
    for run in runs:
        directions = _directions([run])
        if directions is None:
            found.append(run)
            continue
        changed = {name: run.mean[name] - directions[:, at] @ rate.vector for at, name in enumerate(channels)}
        found.append(replace(run, mean={**run.mean, **changed}))
    return found


def _common(
    runs: Sequence[RunBlocks],
    channels: Sequence[str],
    temperatures: dict[str, str],
    declared: Declared,
    directions: FloatArray,
) -> FloatArray | None:
    """Return the earth rate along directions (n, 3 axes, k), (k,), if the gyros agree on it."""
    force = np.concatenate([part for run in runs if (part := specific_force(run)) is not None])
    each, sigma = [], []
    for axis, name in enumerate(channels):
        values = np.concatenate([run.mean[name] for run in runs])
        beside = np.concatenate([_beside(run, temperatures[name], declared) for run in runs])
        own, across = declared.training(runs, temperatures[name]), np.delete(force, axis, axis=1)
        columns = np.column_stack([own, beside, across, directions[:, axis]])
        columns = np.column_stack([_jumps(columns, values, runs), columns])
        estimate, sd = least_squares(columns, values)
        each.append(estimate[-directions.shape[2] :])
        sigma.append(sd[-directions.shape[2] :])
    found, sd = np.array(each), np.array(sigma)
    weight = 1.0 / sd**2
    mean = (weight * found).sum(axis=0) / weight.sum(axis=0)
    error = 1.0 / np.sqrt(weight.sum(axis=0))
    size = float(np.linalg.norm(mean))
    same = bool(np.all(np.abs(found - mean) <= np.maximum(SIGMAS * sd, SPREAD * size)))
    is_seen = size > SIGMAS * float(np.linalg.norm(error))
    return mean if same and is_seen and size <= ALLOWANCE * EARTH_RATE else None


def _jumps(columns: FloatArray, values: FloatArray, runs: Sequence[RunBlocks]) -> FloatArray:
    """Return a column for the jump, or for each of two in different runs, that leaves least, if that is
    plain, (n, jumps).  One at a turn of the unit is that turn's."""
    n = len(values)
    parts = list(pairwise(np.cumsum([0, *map(len, runs)]).tolist()))
    at = [first + _within(run.pose) for run, (first, _) in zip(runs, parts, strict=True)]
    rows = np.arange(n)[:, np.newaxis]
    steps = np.hstack([(rows >= k) & (rows < stop) for k, (_, stop) in zip(at, parts, strict=True)]) * 1.0
    run = np.repeat(np.arange(len(at)), [len(k) for k in at])
    norm = np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(columns / np.where(norm > 0, norm, 1.0))[0]
    left, free = values - basis @ (basis.T @ values), steps - basis @ (basis.T @ steps)
    slope, gram = free.T @ left, free.T @ free
    size = np.diag(gram)
    resolved = size > LEAST_FREE * n
    single = np.where(resolved, slope**2 / np.where(resolved, size, 1.0), 0.0)
    determinant = np.outer(size, size) - gram**2
    usable = (
        (run[:, np.newaxis] < run)
        & (determinant > LEAST_FREE * np.outer(size, size))
        & np.outer(resolved, resolved)
    )
    cross = np.outer(slope**2, size) - 2.0 * np.outer(slope, slope) * gram + np.outer(size, slope**2)
    double = np.where(usable, cross / np.where(usable, determinant, 1.0), 0.0)
    best = np.unravel_index(int(np.argmax(double)), double.shape)
    total = float(left @ left)
    one, two = (-n / INDEPENDENT * np.log1p(-min(gain.max() / total, 1 - 1e-9)) for gain in (single, double))
    if two > max(2.0 * PROVEN, one + PROVEN):
        return np.asarray(steps[:, best])
    return np.asarray(steps[:, [int(np.argmax(single))]] if one > PROVEN else steps[:, :0])


def _within(pose: IntArray) -> IntArray:
    """Return the blocks of a run that are in the middle of a pose."""
    turns = np.flatnonzero(np.diff(pose, prepend=-1, append=pose[-1] + 1))
    at = np.arange(len(pose))
    return np.asarray(at[np.abs(np.subtract.outer(at, turns)).min(axis=1) >= EDGE_BLOCKS])


def _directions(runs: Sequence[RunBlocks]) -> FloatArray | None:
    """Return up, and north and east where a magnetometer shows them, in body axes, (n, 3 axes, 3)."""
    found = []
    for run in runs:
        force = specific_force(run)
        if force is None:
            return None
        up = force / STANDARD_GRAVITY
        north_east = _north(run, force / np.linalg.norm(force, axis=1, keepdims=True))
        north, east = (np.zeros_like(up),) * 2 if north_east is None else north_east
        found.append(np.stack([up, north, east], axis=2))
    if any(not part[:, :, 1].any() for part in found):
        for part in found:
            part[:, :, 1:] = 0.0
    return np.concatenate(found)


def _north(run: RunBlocks, up: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return magnetic north and east in body axes, (n, 3) each; None where the field does not tell."""
    others = next((drive.others for drive in run.drives.values()), {})
    if any(f"mag_{axis}" not in others for axis in "xyz"):
        return None
    field = run.average(np.column_stack([others[f"mag_{axis}"] for axis in "xyz"]))
    level = field - (field * up).sum(axis=1, keepdims=True) * up
    size = np.linalg.norm(level, axis=1, keepdims=True)
    if np.any(size < LEAST_LEVEL * np.linalg.norm(field, axis=1, keepdims=True)) or not size.all():
        return None
    north = level / size
    return north, np.cross(north, up)


def _beside(run: RunBlocks, temperature: str, declared: Declared) -> FloatArray:
    """Return what else a bias may follow, so that it is not taken for a pose, (n, k)."""
    middle, half = declared.middle_degc, declared.half_span_degc
    effects: list[Effect] = [
        *(ThermalLag(time_constant_s=tau, middle=middle, half_span=half) for tau in LAGS_S),
        *(WarmUp(time_constant_s=tau) for tau in LAGS_S),
        Drift(),
    ]
    return np.column_stack([run.average(effect.columns(run.drives[temperature])) for effect in effects])
