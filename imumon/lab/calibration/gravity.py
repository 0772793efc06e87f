"""Bias and scale of an accelerometer triad from the length of gravity in several poses."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import MICRO_G, STANDARD_GRAVITY

APART_DEG = 20.0
"""Poses that differ by less are one."""
ITERATIONS = 3
"""Gauss-Newton steps: the length depends on the errors to first order, the direction does as well."""
INDEPENDENT = 10.0
"""Means that count as one, for noise that is slow and for what a model lacks."""
LEAST_POSES, POSES_OF_MISALIGNMENT = 6, 9
"""Poses from which bias and scale, and the misalignment as well, follow from the length of gravity."""


@dataclass(frozen=True, slots=True, eq=False)
class Length:
    """What follows from |f| = g of an accelerometer triad, at the middle of the temperatures; (3,) each."""

    bias: FloatArray
    bias_per_half: FloatArray
    """m/s², and its linear change up to the warm end; it may be as curved as the declared model."""
    scale: FloatArray
    scale_per_half: FloatArray
    """Excess of the scale factors over 1; their mean includes the error of the assumed gravity."""
    misalignment: FloatArray
    """Of yz, xz and xy, rad; NaN with too few poses."""
    bias_sd: FloatArray
    scale_sd: FloatArray
    """Standard deviations; infinite where the poses do not determine the parameter."""
    before: float
    after: float
    """rms of |f| - g, m/s², with and without these errors."""

    @classmethod
    def from_poses(cls, force: FloatArray, warmth: FloatArray) -> tuple[int, Self] | None:
        """Return the number of poses and the errors by |f| = g in them; None with fewer than six poses.

        To first order |f| - g = u·b + g u·S u, with u the direction, b the bias, S scale and misalignment.

        `force` (n, 3): means of the specific force at rest, m/s².
        `warmth` (n, d): powers of the scaled temperature that the bias may follow; the first is linear.
        """
        poses = _distinct(force / np.linalg.norm(force, axis=1, keepdims=True))
        if poses < LEAST_POSES:
            return None
        skewed = poses >= POSES_OF_MISALIGNMENT
        true, found = force, np.zeros(1)
        before = _rms(np.linalg.norm(force, axis=1) - STANDARD_GRAVITY)
        for _ in range(ITERATIONS):
            size = np.linalg.norm(true, axis=1, keepdims=True)
            errors = _errors(true / size, warmth, skewed=skewed)
            columns = np.einsum("ij,ijk->ik", true / size, errors)
            excess = size[:, 0] - STANDARD_GRAVITY
            values = excess if len(found) == 1 else excess + columns @ found
            found, sd = _least_squares(columns, values)
            true = force - errors @ found
        bias_slope, scale_slope, bias, scale = np.split(found[-12:], 4)
        return poses, cls(
            bias=bias,
            bias_per_half=bias_slope,
            scale=scale,
            scale_per_half=scale_slope,
            misalignment=found[-15:-12] if skewed else np.full(3, np.nan),
            bias_sd=sd[-6:-3],
            scale_sd=sd[-3:],
            before=before,
            after=_rms(values - columns @ found),
        )

    def described(self, poses: int) -> str:
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


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _least_squares(columns: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of ordinary least squares, the smallest where columns are collinear, and their
    standard deviations, (k,); infinite where the columns do not determine one.

    `columns` (n, k), `values` (n,).
    """
    norm = np.linalg.norm(columns, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    scaled = columns / norm
    inverse = np.linalg.pinv(scaled, rcond=1e-6)
    determined = np.diag(inverse @ scaled)  # 1 where the columns determine a coefficient, else less
    residual = values - scaled @ (inverse @ values)
    freedom = max(len(values) - round(float(determined.sum())), 1)
    variance = np.where(determined > 1.0 - 1e-3, (inverse**2).sum(axis=1), np.inf)
    sd = np.sqrt(variance * float(residual @ residual) / freedom * INDEPENDENT)
    return inverse @ values / norm, sd / norm


def _errors(up: FloatArray, warmth: FloatArray, *, skewed: bool) -> FloatArray:
    """Return what each parameter adds to a reading, (n, 3, k).

    The last twelve are the slopes over temperature of bias and scale, then bias and scale; before them, where
    it is estimated, the misalignment.
    """
    n, unit = len(up), np.eye(3)
    bias = np.broadcast_to(unit, (n, 3, 3))
    scale = STANDARD_GRAVITY * up[:, :, np.newaxis] * unit
    misalignment = np.zeros((n, 3, 3))
    for at, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        misalignment[:, i, at] = STANDARD_GRAVITY * up[:, j]
        misalignment[:, j, at] = STANDARD_GRAVITY * up[:, i]
    powers = [power[:, np.newaxis, np.newaxis] for power in warmth.T] or [np.zeros((n, 1, 1))]
    curved = [power * bias for power in powers[1:]]
    slopes = [powers[0] * bias, powers[0] * scale]
    return np.concatenate([*curved, *([misalignment] if skewed else []), *slopes, bias, scale], axis=2)


def _distinct(up: FloatArray) -> int:
    """Return how many of the directions, (n, 3), differ from one another."""
    found: list[FloatArray] = []
    limit = float(np.cos(np.radians(APART_DEG)))
    for one in up:
        if all(float(one @ other) < limit for other in found):
            found.append(one)
    return len(found)
