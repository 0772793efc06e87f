"""Gravity in a unit that is laid in several poses: what an accelerometer reads is that, and its errors.

Within a pose gravity stays, and what a reading does is the bias's; from pose to pose it is one length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.channel import Declared, estimated
from imumon.geodesy import MICRO_G, STANDARD_GRAVITY

APART_DEG = 20.0
"""Poses that differ by less are one."""
ITERATIONS = 3
"""Of Gauss and Newton: the length has the errors to first order, the direction has them, too."""
SIX, NINE = 6, 9
"""Poses from which on bias and scale, and misalignment as well, follow from the length of gravity."""


def at_poses(runs: Sequence[RunBlocks]) -> list[RunBlocks]:
    """Return runs in which the specific force that drives effects is the mean of the pose.

    A reading that is to be explained must not explain its own noise.
    """
    found = []
    for run in runs:
        middle = 0.5 * (run.time_s[1:] + run.time_s[:-1])
        drives = {}
        for name, drive in run.drives.items():
            if drive.accel is None:
                drives[name] = drive
                continue
            level = _levels(run, drive.accel)
            pose = run.pose[np.searchsorted(middle, drive.time_s)]
            drives[name] = replace(drive, accel=level[pose])
        found.append(replace(run, drives=drives))
    return found


def _levels(run: RunBlocks, force: FloatArray) -> FloatArray:
    """Return the mean specific force in each pose, (poses, 3)."""
    means, count = run.average(force), np.bincount(run.pose)
    sums = [np.bincount(run.pose, means[:, axis]) for axis in range(3)]
    return np.column_stack(sums) / np.maximum(count, 1)[:, np.newaxis]


@dataclass(frozen=True, slots=True, eq=False)
class Length:
    """What follows from |f| = g of an accelerometer triad, at the middle of the temperatures."""

    bias: FloatArray
    bias_per_half: FloatArray
    """m/s², and its linear change up to the warm end, (3,); it may be as curved as the declared model."""
    scale: FloatArray
    scale_per_half: FloatArray
    """Excess of the scale factors over 1; their mean is not told from the gravity of the place, (3,)."""
    misalignment: FloatArray
    """Of yz, xz and xy, rad, (3,); NaN with too few poses."""
    bias_sd: FloatArray
    scale_sd: FloatArray
    """Array, (3,)."""
    before: float
    after: float
    """rms of |f| - g, m/s²."""

    def said(self, poses: int) -> str:
        """Return it in words."""
        bias, bias_sd = (_listed(part / MICRO_G) for part in (self.bias, self.bias_sd))
        scale, scale_sd = (_listed(part * 1e6) for part in (self.scale, self.scale_sd))
        before, after = self.before / MICRO_G, self.after / MICRO_G
        return (
            f"{poses} poses: by |f| = g the accelerometers have biases of {bias} µg (sd {bias_sd}) and scale"
            f" errors of {scale} ppm (sd {scale_sd}) on x / y / z; |f| - g is {before:.0f} µg rms before and"
            f" {after:.0f} after"
        )


def _listed(values: FloatArray) -> str:
    return " / ".join(f"{value:.0f}" for value in values)


def length(runs: Sequence[RunBlocks], temperature: str, declared: Declared) -> tuple[int, Length] | None:
    """Return the number of poses and what their common length says; None with fewer than six.

    To first order |f| - g = u·b + g u·S u, u the direction, b the bias and S scale and misalignment.
    """
    forces = [specific_force(run) for run in runs]
    if any(part is None for part in forces):
        return None
    force = np.concatenate([part for part in forces if part is not None])
    poses = _apart(force / np.linalg.norm(force, axis=1, keepdims=True))
    if poses < SIX:
        return None
    warmth = np.concatenate([declared.columns(run.temperature[temperature])[:, 1:] for run in runs])
    true, values = force, np.linalg.norm(force, axis=1) - STANDARD_GRAVITY
    before = float(np.sqrt(np.mean(values**2)))
    found: FloatArray = np.zeros(1)
    for _ in range(ITERATIONS):
        size = np.linalg.norm(true, axis=1, keepdims=True)
        errors = _errors(true / size, warmth, askew=poses >= NINE)
        columns = np.einsum("ij,ijk->ik", true / size, errors)
        values = size[:, 0] - STANDARD_GRAVITY + (columns @ found if len(found) > 1 else 0.0)
        found, sd = estimated(columns, values, columns.shape[1])
        true = force - errors @ found
    left = values - columns @ found
    values_of, sd_of = np.split(found[-12:], 4), np.split(sd[-12:], 4)
    return poses, Length(
        bias=values_of[2],
        bias_per_half=values_of[0],
        scale=values_of[3],
        scale_per_half=values_of[1],
        misalignment=found[-15:-12] if poses >= NINE else np.full(3, np.nan),
        bias_sd=sd_of[2],
        scale_sd=sd_of[3],
        before=before,
        after=float(np.sqrt(np.mean(left**2))),
    )


def _errors(up: FloatArray, warmth: FloatArray, *, askew: bool) -> FloatArray:
    """Return what each parameter adds to a reading, (n, 3, k); the last twelve are bias and scale over
    temperature in a line, bias and scale; before them the misalignment, where it is askew."""
    n, unit = len(up), np.eye(3)
    warm = warmth[:, 0] if warmth.size else np.zeros(n)
    bias = np.broadcast_to(unit, (n, 3, 3))
    scale = STANDARD_GRAVITY * up[:, :, np.newaxis] * unit
    across = np.zeros((n, 3, 3))
    for at, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        across[:, i, at], across[:, j, at] = STANDARD_GRAVITY * up[:, j], STANDARD_GRAVITY * up[:, i]
    line = warm[:, np.newaxis, np.newaxis]
    curved = [power[:, np.newaxis, np.newaxis] * bias for power in warmth[:, 1:].T]
    return np.concatenate(
        [*curved, *([across] if askew else []), line * bias, line * scale, bias, scale], axis=2
    )


def _apart(up: FloatArray) -> int:
    """Return how many directions, (n, 3), are apart from one another."""
    found: list[FloatArray] = []
    limit = float(np.cos(np.radians(APART_DEG)))
    for one in up:
        if all(float(one @ other) < limit for other in found):
            found.append(one)
    return len(found)


def specific_force(run: RunBlocks) -> FloatArray | None:
    """Return the specific force in each block, (n, 3); None where it is not recorded."""
    accel = next((drive.accel for drive in run.drives.values()), None)
    return None if accel is None else run.average(accel)
