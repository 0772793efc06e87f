"""Bias and scale of an accelerometer triad from the length of gravity in several poses."""

from typing import NamedTuple, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import MICRO_G, STANDARD_GRAVITY

COS_OTHER_POSE = np.cos(np.radians(20.0))  # directions that differ by more are two poses.  Assumed.


class TriadErrors(NamedTuple):
    """Errors of an accelerometer triad by |f| = g, at the middle of the temperatures; arrays are (3,).

    They are what a reading has beyond the specific force.  `_per_half` is the linear change from the middle
    to the warm end, over half the range; the bias may follow higher powers as well.  A standard deviation is
    infinite where the poses do not determine the error.
    """

    bias: FloatArray  # m/s²
    bias_per_half: FloatArray
    scale: FloatArray  # factor less 1; the mean of the three includes the error of the assumed gravity
    scale_per_half: FloatArray
    misalignment: FloatArray  # of yz, xz, xy: half of what the angle lacks to 90°, rad; NaN in few poses
    bias_sd: FloatArray
    scale_sd: FloatArray
    before: float  # rms of |f| - g, m/s², as read
    after: float  # the same with these errors taken off

    @classmethod
    def from_poses(cls, force: FloatArray, warmth: FloatArray) -> tuple[int, Self] | None:
        """Return the number of poses and the errors by |f| = g in them; None with fewer than six poses.

        To first order |f| - g = u·b + g u·S u, with u the direction, b the bias, S scale and misalignment.
        Only the symmetric part of S has an effect, so misalignment is one number for each two axes.

        `force` (n, 3): means of the specific force at rest, m/s².
        `warmth` (n, d): powers 1 to d of the scaled temperature, -1 to 1, which the bias may follow.
        """
        direction = force / np.linalg.norm(force, axis=1, keepdims=True)
        poses = _distinct(direction)
        if poses < 6:  # at least bias and scale of three axes are unknown
            return None
        with_misalignment = poses >= 9  # three unknowns more
        _, design = _design(direction, warmth, with_misalignment)
        x = np.zeros(design.shape[2])  # no errors at first
        for _ in range(3):  # Gauss-Newton steps (assumed): the direction depends on the errors as well
            true = force - design @ x
            length = np.linalg.norm(true, axis=1, keepdims=True)
            direction = true / length
            names, design = _design(direction, warmth, with_misalignment)
            # What each error adds to |f|, uᵀ D, and what |f| of the readings has beyond g.
            columns = np.einsum("ij,ijk->ik", direction, design)
            excess = length[:, 0] - STANDARD_GRAVITY + columns @ x
            x, x_sd = _least_squares(columns, excess)
        error, sd = (dict(zip(names, part.reshape(-1, 3), strict=True)) for part in (x, x_sd))
        return poses, cls(
            bias=error["bias"],
            bias_per_half=error["bias_per_half"],
            scale=error["scale"],
            scale_per_half=error["scale_per_half"],
            misalignment=error.get("misalignment", np.full(3, np.nan)),
            bias_sd=sd["bias"],
            scale_sd=sd["scale"],
            before=_rms(np.linalg.norm(force, axis=1) - STANDARD_GRAVITY),
            after=_rms(excess - columns @ x),
        )

    def described(self, poses: int) -> str:
        """Return bias and scale with their standard deviations as a sentence."""
        millionths = self.bias / MICRO_G, self.bias_sd / MICRO_G, self.scale * 1e6, self.scale_sd * 1e6
        bias, bias_sd, scale, scale_sd = (" / ".join(f"{value:.0f}" for value in part) for part in millionths)
        return (
            f"{poses} poses: by |f| = g the accelerometers have biases of {bias} µg (sd {bias_sd}) and scale"
            f" errors of {scale} ppm (sd {scale_sd}) on x / y / z; |f| - g is"
            f" {self.before / MICRO_G:.0f} µg rms before and {self.after / MICRO_G:.0f} after"
        )


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
    inverse = np.linalg.pinv(scaled, rcond=1e-6)  # below that share of the largest it is rounding.  Assumed.
    coefficients = inverse @ values
    residual = values - scaled @ coefficients
    # Diagonal of the resolution matrix: 1 where the columns determine a coefficient, else less.
    resolution = np.diag(inverse @ scaled)
    freedom = max(len(values) - round(resolution.sum()), 1)
    # The sum is the diagonal of (CᵀC)⁻¹, with C the scaled columns.  What differs from 1 by 1e-3 is assumed.
    variance = np.where(resolution > 1.0 - 1e-3, (inverse**2).sum(axis=1), np.inf)
    # Ten means count as one, for noise that is slow and for what a model lacks.  Assumed.
    sd = np.sqrt(variance * (residual @ residual) / freedom * 10.0)
    return coefficients / norm, sd / norm


def _design(up: FloatArray, warmth: FloatArray, with_misalignment: bool) -> tuple[list[str], FloatArray]:
    """Return the names of errors, and what each of their three parameters adds to a reading, (n, 3, k)."""
    bias = np.broadcast_to(np.eye(3), (len(up), 3, 3))
    scale = STANDARD_GRAVITY * up[:, :, None] * np.eye(3)
    misalignment = np.zeros_like(scale)
    for pair, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        misalignment[:, i, pair] = STANDARD_GRAVITY * up[:, j]
        misalignment[:, j, pair] = STANDARD_GRAVITY * up[:, i]
    powers = [power[:, None, None] for power in warmth.T]
    # Without any power (d = 0) nothing is added, and the slopes over temperature are not determined.
    first = powers[0] if powers else np.zeros((len(up), 1, 1))
    errors = {f"bias of power {k}": power * bias for k, power in enumerate(powers[1:], 2)}
    if with_misalignment:
        errors["misalignment"] = misalignment
    errors |= {"bias_per_half": first * bias, "scale_per_half": first * scale, "bias": bias, "scale": scale}
    return list(errors), np.concatenate(list(errors.values()), axis=2)


def _distinct(up: FloatArray) -> int:
    """Return how many of the directions, (n, 3), are in another pose than those counted before."""
    distinct: list[FloatArray] = []
    for direction in up:
        if all(direction @ other < COS_OTHER_POSE for other in distinct):
            distinct.append(direction)
    return len(distinct)
