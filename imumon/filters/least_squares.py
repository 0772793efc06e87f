"""Ordinary least squares with the standard deviations of its coefficients."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray

INDEPENDENT = 10.0
"""Means that count as one, for noise that is slow and for what a model lacks."""


def least_squares(columns: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of ordinary least squares, the smallest where columns are collinear, and their
    standard deviations, (k,); infinite where the columns do not determine one.

    Parameters
    ----------
    columns, values : array of shape (n, k) and (n,)
    """
    norm = np.linalg.norm(columns, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    left, singular, right = np.linalg.svd(columns / norm, full_matrices=False)
    kept = singular > 1e-6 * singular[0]
    coefficients = right[kept].T @ ((left[:, kept].T @ values) / singular[kept])
    residual = values - columns / norm @ coefficients
    variance = ((right[kept] / singular[kept, np.newaxis]) ** 2).sum(axis=0)
    variance[(right[~kept] ** 2).sum(axis=0) > 1e-3] = np.inf
    freedom = max(len(values) - int(kept.sum()), 1)
    sd = np.sqrt(variance * float(residual @ residual) / freedom * INDEPENDENT)
    return coefficients / norm, sd / norm
