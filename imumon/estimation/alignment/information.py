"""Gaussians in information form: log density η'x - ½ x'Λx + const of unknowns x.

Observations add up, and unknowns with a prior are eliminated by a Schur complement.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray


class Information(NamedTuple):
    """Information on n unknowns, of which there are k independent sets (the real parts of complex ones).

    `matrix` Λ is (..., n, n), and `vector` η (..., n, k).
    """

    matrix: FloatArray
    vector: FloatArray

    def plus(self, other: Information) -> Information:
        """Return the information of both."""
        return Information(self.matrix + other.matrix, self.vector + other.vector)

    def without(self, sd: FloatArray) -> tuple[Information, FloatArray]:
        """Eliminate the last m unknowns, N(0, sd²).

        Parameters
        ----------
        sd : array (..., m)

        Returns
        -------
        Information on the other unknowns, and the log density of what does not depend on them, (...).
        """
        kept, sets = self.matrix.shape[-1] - sd.shape[-1], self.vector.shape[-1]
        precision = self.matrix[..., kept:, kept:] + np.eye(sd.shape[-1]) / sd[..., None, :] ** 2
        covariance = np.linalg.inv(precision)
        gain, vector = self.matrix[..., :kept, kept:] @ covariance, self.vector[..., kept:, :]
        log_density = 0.5 * np.sum(vector * (covariance @ vector), axis=(-2, -1))
        log_density -= sets * (0.5 * np.linalg.slogdet(precision)[1] + np.log(sd).sum(axis=-1))
        rest = Information(
            self.matrix[..., :kept, :kept] - gain @ self.matrix[..., kept:, :kept],
            self.vector[..., :kept, :] - gain @ vector,
        )
        return rest, log_density


def information(design: FloatArray, data: FloatArray, covariance: FloatArray) -> Information:
    """Return the information of data (m, k) = design (m, n) x + noise with this covariance (m, m)."""
    weighted = np.linalg.solve(covariance, design).T
    return Information(weighted @ design, weighted @ data)
