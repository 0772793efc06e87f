"""Several models of one system at once: mode probabilities, mixing of an IMM, weights of an MMAE.

Names are those of Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001), ch. 11: a *mode* is one model of the set, `mu` its probability, `transition` the matrix of the
probabilities that one mode follows another.  A set whose mode may change is an IMM (interacting multiple
models, section 11.6.6): `mix` the estimates and predict the probabilities, filter each mode, and weigh the
modes by their likelihoods.  A set whose mode is fixed is an MMAE (static multiple models, section 11.6.2):
it is only weighed.

Arrays keep the axes of the state first and the modes last: means (n, ..., m), covariances (n, n, ..., m) and
probabilities (..., m).  Axes between them are sets apart, for example several MMAE hypotheses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray


class Mixed(NamedTuple):
    """Mean (n, ..., m), covariance (n, n, ..., m) and predicted probability (..., m) of each mode."""

    mean: FloatArray
    covariance: FloatArray
    probability: FloatArray


def mode_transition(modes: int, change: float) -> FloatArray:
    """Return a transition matrix, (m, m), of modes in an order: rows are the mode before.

    `change` is the probability to change to one of the two modes beside it.
    """
    matrix = change / 2.0 * (np.eye(modes, k=1) + np.eye(modes, k=-1))
    matrix[np.diag_indices(modes)] += 1.0 - matrix.sum(axis=1)
    return matrix


def mix(mean: FloatArray, covariance: FloatArray, mu: FloatArray, transition: FloatArray) -> Mixed:
    """Return the mixed initial condition of each mode and the predicted mode probabilities c̄.

    With the mixing probabilities ω_ij = M_ij μ_i / c̄_j, mode j begins with Σ_i ω_ij x_i and the covariance
    Σ_i ω_ij (P_i + d_i d_iᵀ), d_i = x_i - x_0j.  Sums are of differences from the mean over all modes, so
    that a large mean costs no digits.
    """
    predicted = mu @ transition
    centre = (mu * mean).sum(-1, keepdims=True) / mu.sum(-1, keepdims=True)
    off = mean - centre
    mixed = (mu * off) @ transition / predicted
    second = (mu * (covariance + off[:, np.newaxis] * off)) @ transition / predicted
    return Mixed(mixed + centre, second - mixed[:, np.newaxis] * mixed, predicted)


def mode_probabilities(mu: FloatArray, log_likelihood: FloatArray, least: float) -> FloatArray:
    """Return the probabilities given the likelihoods of a measurement, over all axes together.

    Parameters
    ----------
    mu, log_likelihood : array, same shape
        Before the measurement; all of one set of hypotheses, whose sum is 1.
    least : float
        No probability falls below this, so that none is lost for ever.
    """
    posterior = mu * np.exp(log_likelihood - log_likelihood.max())
    return np.asarray(np.maximum(posterior / posterior.sum(), least))


def mixture(mu: FloatArray, mean: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Return mean and variance of one quantity over all hypotheses.

    Parameters
    ----------
    mu, mean, variance : array, same shape
        The probabilities have the sum 1.
    """
    centre = float(mean.flat[int(mu.argmax())])
    off = mean - centre
    shift = float((mu * off).sum())
    return centre + shift, float((mu * (variance + (off - shift) ** 2)).sum())
