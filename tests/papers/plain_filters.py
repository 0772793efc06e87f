"""The paper's 7-state RSUKF in covariance form, as printed, and the signal of the check values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray

CHECK_ROWS = [0, 9, 99, 1999]


def check_signal() -> FloatArray:
    """Return the signal without random numbers that the check values belong to."""
    k = np.arange(2000)
    z: FloatArray = 0.3 * np.sin(0.9 * k) + 0.2 * np.sin(2.3 * k + 1) + 0.05 * np.sin(0.01 * k)
    return z


@dataclass
class SevenStates:
    """Equations (11) to (21) with X augmented by (a_k, a_k-1), one full matrix at a time."""

    mean: FloatArray
    covariance: FloatArray
    noise_variance: float
    risk: FloatArray
    alpha: float = 1.0
    beta: float = 0.0

    def step(self, reading: float) -> float:
        """Return x_k|k of the next sample."""
        n = 7
        mean = np.concatenate([self.mean, np.zeros(2)])
        p = np.zeros((n, n))
        p[:5, :5], p[5:, 5:] = self.covariance, np.eye(2)
        scale = self.alpha**2 * n - n
        gamma = np.sqrt(n + scale)
        wm = np.full(2 * n + 1, 0.5 / gamma**2)
        wm[0] = scale / gamma**2
        wc = wm.copy()
        wc[0] += 1 - self.alpha**2 + self.beta
        s = np.linalg.cholesky(p)
        points = np.column_stack([mean, mean[:, None] + gamma * s, mean[:, None] - gamma * s])
        x, before, phi, d1, d2, a, b = points
        points = np.array([(1 + phi) * x - phi * before + d1 * a - d2 * b, x, phi, d1, d2, a, b])
        mean = points @ wm
        deviation = points - mean[:, None]
        p = (deviation * wc) @ deviation.T
        # (P⁻¹ - 2μ)⁻¹ without P⁻¹, which does not exist at φ = 0.
        p = p @ np.linalg.inv(np.eye(n) - 2 * np.diag(np.concatenate([self.risk, np.zeros(2)])) @ p)
        gain = p[:, 0] / (p[0, 0] + self.noise_variance)
        mean = mean + gain * (reading - mean[0])
        p = p - np.outer(gain, p[0])
        self.mean, self.covariance = mean[:5], (p[:5, :5] + p[:5, :5].T) / 2
        return float(mean[0])
