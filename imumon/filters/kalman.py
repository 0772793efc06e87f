"""The Kalman filter's two steps as every textbook writes them, for one filter or for many side by side.

All functions take arrays with any leading dimensions: a bank of filters is one more axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray

LOG_2_PI = float(np.log(2.0 * np.pi))


class Estimate(NamedTuple):
    """Mean (..., n) and covariance (..., n, n) of a state."""

    mean: FloatArray
    covariance: FloatArray


class Correction(NamedTuple):
    """What a measurement did."""

    estimate: Estimate
    """After the measurement."""
    innovation: FloatArray
    """Measurement less its prediction."""
    innovation_covariance: FloatArray
    log_likelihood: FloatArray
    """Logarithm of the density of the measurement as it was predicted."""

    @property
    def standardised(self) -> FloatArray:
        """Each innovation over its own standard deviation, (..., m)."""
        variance = np.diagonal(self.innovation_covariance, axis1=-2, axis2=-1)
        return np.asarray(self.innovation / np.sqrt(variance))


def transposed(matrix: npt.NDArray[np.floating]) -> FloatArray:
    """Return the transpose of the last two axes."""
    return np.asarray(np.swapaxes(matrix, -1, -2))


def predict(
    estimate: Estimate, transition: FloatArray, noise: FloatArray, known_input: FloatArray | float = 0.0
) -> Estimate:
    """Return x = F x + u and P = F P Fᵀ + Q.

    Parameters
    ----------
    transition, noise : array, (..., n, n)
        F and Q.
    known_input : array, (..., n)
        u.
    """
    mean = np.einsum("...ij,...j->...i", transition, estimate.mean) + known_input
    return Estimate(mean, transition @ estimate.covariance @ transposed(transition) + noise)


def correct(estimate: Estimate, measurement: FloatArray, model: FloatArray, noise: FloatArray) -> Correction:
    """Update with z = H x + v, v of covariance R, in Joseph's form.

    Raises numpy.linalg.LinAlgError when the covariance of the innovation is singular.

    Parameters
    ----------
    measurement : array, (..., m)
        z.
    model : array, (..., m, n)
        H.
    noise : array, (..., m, m)
        R.
    """
    mean, covariance = estimate
    innovation = measurement - np.einsum("...ij,...j->...i", model, mean)
    spread = covariance @ transposed(model)
    innovation_covariance = model @ spread + noise
    if innovation.shape[-1] == 1:
        return _correct_with_one(estimate, innovation, spread, innovation_covariance)
    gain = transposed(np.linalg.solve(innovation_covariance, transposed(spread)))
    rest = np.eye(mean.shape[-1]) - gain @ model
    corrected = rest @ covariance @ transposed(rest) + gain @ noise @ transposed(gain)
    weighted = np.linalg.solve(innovation_covariance, innovation[..., np.newaxis])[..., 0]
    log_determinant = np.linalg.slogdet(innovation_covariance)[1]
    log_likelihood = -0.5 * (
        (innovation * weighted).sum(-1) + log_determinant + innovation.shape[-1] * LOG_2_PI
    )
    after = Estimate(mean + np.einsum("...ij,...j->...i", gain, innovation), corrected)
    return Correction(after, innovation, innovation_covariance, np.asarray(log_likelihood))


def _correct_with_one(
    estimate: Estimate, innovation: FloatArray, spread: FloatArray, variance: FloatArray
) -> Correction:
    """Update with a single value: the same, multiplied out, without solving for a matrix of one."""
    if not variance.all():
        raise np.linalg.LinAlgError("the innovation has no variance")
    mean, covariance = estimate
    gain = spread / variance
    # (1 - K H) P (1 - K H)' + K R K' with K S = P H'.
    corrected = covariance - gain @ transposed(spread)
    corrected = 0.5 * (corrected + transposed(corrected))
    after = Estimate(mean + gain[..., 0] * innovation, corrected)
    square = innovation**2 / variance[..., 0]
    log_likelihood = -0.5 * (square + np.log(variance[..., 0]) + LOG_2_PI)[..., 0]
    return Correction(after, innovation, variance, log_likelihood)


def smooth(filtered: Estimate, predicted: Estimate, later: Estimate, transition: FloatArray) -> Estimate:
    """Return the estimate given later measurements too (Rauch, Tung and Striebel 1965, eq. 3.28-3.30).

    Parameters
    ----------
    filtered : Estimate
        At step k, after its measurement.
    predicted : Estimate
        At step k + 1, before its measurement.
    later : Estimate
        At step k + 1, smoothed.
    transition : array, (..., n, n)
        From step k to k + 1.
    """
    gain = transposed(np.linalg.solve(predicted.covariance, transition @ filtered.covariance))
    mean = filtered.mean + np.einsum("...ij,...j->...i", gain, later.mean - predicted.mean)
    return Estimate(
        mean, filtered.covariance + gain @ (later.covariance - predicted.covariance) @ transposed(gain)
    )
