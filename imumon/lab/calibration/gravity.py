"""Bias and scale of an accelerometer triad from the length of gravity in several poses."""

from typing import NamedTuple, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.geodesy import MICRO_G, STANDARD_GRAVITY


class TriadErrors(NamedTuple):
    """Errors of an accelerometer triad by |f| = g, at the middle of the temperatures; (3,) each.

    `bias` is in m/s², `scale` the excess of the scale factors over 1, whose mean includes the error of the
    assumed gravity.  `_per_half` is the linear change from the middle to the warm end, over half the range;
    the bias may follow higher powers as well.  A standard deviation is infinite where the poses do not
    determine it.  `misalignment` is, for yz, xz and xy, half of what the angle between the two axes lacks to
    90°, rad; NaN with too few poses.  `before` and `after`: rms of |f| - g, m/s², with and without these.
    """

    bias: FloatArray
    bias_per_half: FloatArray
    scale: FloatArray
    scale_per_half: FloatArray
    misalignment: FloatArray
    bias_sd: FloatArray
    scale_sd: FloatArray
    before: float
    after: float

    @classmethod
    def from_poses(cls, force: FloatArray, warmth: FloatArray) -> tuple[int, Self] | None:
        """Return the number of poses and the errors by |f| = g in them; None with fewer than six poses.

        To first order |f| - g = u·b + g u·S u, with u the direction, b the bias, S scale and misalignment.

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
            size = np.linalg.norm(true, axis=1, keepdims=True)
            direction = true / size
            names, design = _design(direction, warmth, with_misalignment)
            columns = np.einsum("ij,ijk->ik", direction, design)
            values = size[:, 0] - STANDARD_GRAVITY + columns @ x
            x, x_sd = _least_squares(columns, values)
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
            after=_rms(values - columns @ x),
        )

    def described(self, poses: int) -> str:
        """Return bias and scale with their standard deviations as a sentence."""
        bias, bias_sd = (_listed(part / MICRO_G) for part in (self.bias, self.bias_sd))
        scale, scale_sd = (_listed(part * 1e6) for part in (self.scale, self.scale_sd))
        return (
            f"{poses} poses: by |f| = g the accelerometers have biases of {bias} µg (sd {bias_sd}) and scale"
            f" errors of {scale} ppm (sd {scale_sd}) on x / y / z; |f| - g is"
            f" {self.before / MICRO_G:.0f} µg rms before and {self.after / MICRO_G:.0f} after"
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
    inverse = np.linalg.pinv(scaled, rcond=1e-6)  # below that share of the largest it is rounding.  Assumed.
    determined = np.diag(inverse @ scaled)  # 1 where the columns determine a coefficient, else less
    residual = values - scaled @ (inverse @ values)
    freedom = max(len(values) - round(determined.sum()), 1)
    # The sum is the diagonal of (CᵀC)⁻¹, with C the scaled columns.  What differs from 1 by 1e-3 is assumed.
    variance = np.where(determined > 1.0 - 1e-3, (inverse**2).sum(axis=1), np.inf)
    # Ten means count as one, for noise that is slow and for what a model lacks.  Assumed.
    sd = np.sqrt(variance * (residual @ residual) / freedom * 10.0)
    return inverse @ values / norm, sd / norm


def _design(up: FloatArray, warmth: FloatArray, with_misalignment: bool) -> tuple[list[str], FloatArray]:
    """Return the names of errors, and what each of their three parameters adds to a reading, (n, 3, k)."""
    bias = np.broadcast_to(np.eye(3), (len(up), 3, 3))
    scale = STANDARD_GRAVITY * up[:, :, None] * np.eye(3)
    misalignment = np.zeros_like(scale)
    for pair, (i, j) in enumerate(((1, 2), (0, 2), (0, 1))):
        misalignment[:, i, pair] = STANDARD_GRAVITY * up[:, j]
        misalignment[:, j, pair] = STANDARD_GRAVITY * up[:, i]
    # Without any power (d = 0) nothing is added, and the slopes over temperature are not determined.
    first, *higher = [power[:, None, None] for power in warmth.T] or [np.zeros((len(up), 1, 1))]
    errors = {f"bias of power {k}": power * bias for k, power in enumerate(higher, 2)}
    if with_misalignment:
        errors["misalignment"] = misalignment
    errors |= {"bias_per_half": first * bias, "scale_per_half": first * scale, "bias": bias, "scale": scale}
    return list(errors), np.concatenate(list(errors.values()), axis=2)


def _distinct(up: FloatArray) -> int:
    """Return how many of the directions, (n, 3), differ from one another by 20° or more (assumed)."""
    distinct: list[FloatArray] = []
    limit = np.cos(np.radians(20.0))
    for direction in up:
        if all(direction @ other < limit for other in distinct):
            distinct.append(direction)
    return len(distinct)
