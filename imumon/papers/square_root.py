"""Least squares in upper-triangular square-root form: update, its exact inverse, and a fit from scratch.

The covariance is P = S Sᵀ with S upper triangular.  After Carlson and Potter; the notation is that of Kozlov
and Tarygin, Sensors 2020, 20(5), 1299, appendices A to D, derived anew because signs are lost there.

For the update write P⁺ = S (E - f fᵀ / (σ² + fᵀf)) Sᵀ with f = Sᵀhᵀ, and d_j = σ² + Σ_{k≤j} f_k².
The upper triangular B with B Bᵀ = E - f fᵀ/d_n has B_jj = √(d_{j-1}/d_j) and, for i < j,
B_ij = -f_i f_j / √(d_{j-1} d_j).  Then S⁺ = S B: its column j is
S_j √(d_{j-1}/d_j) - K_j f_j / √(d_{j-1} d_j) with K_j = Σ_{k<j} S_k f_k.
The removal has P⁻ = S (E + f fᵀ / (σ² - fᵀf)) Sᵀ, that is the same with f² counted negatively:
d_j = σ² - Σ_{k≤j} f_k², and B_ij = +f_i f_j / √(d_{j-1} d_j).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import solve_triangular

from imumon.blocks import FloatArray


def update(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Return x, (n,), and S, (n, n), with the measurement z = h x + noise taken in (eqs. 9 and 11)."""
    return _change(x, s, z, h, sigma, 1.0)


def pull_back(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float, least_share: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return x and S with a measurement taken out again (eq. 12), or None if it cannot be.

    The share of the measurement's variance that the others leave, 1 - h P hᵀ/σ², must exceed `least_share`:
    below it they do not determine the state (share 0), or cancellation eats up the digits.
    """
    f = h @ s
    if not sigma**2 - float(f @ f) > least_share * sigma**2:
        return None
    return _change(x, s, z, h, sigma, -1.0)


def _change(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float, sign: float
) -> tuple[FloatArray, FloatArray]:
    """Take in (sign 1) or out (sign -1), column by column: B_ij = ∓f_i f_j / √(d_j-1 d_j)."""
    f, changed, gain, before = h @ s, np.empty_like(s), np.zeros(len(x)), sigma**2
    for j, f_j in enumerate(f.tolist()):
        after = before + sign * f_j * f_j
        changed[:, j] = math.sqrt(before / after) * s[:, j] - sign * f_j / math.sqrt(before * after) * gain
        gain += f_j * s[:, j]
        before = after
    return x + sign * gain / before * (z - float(h @ x)), changed


def fit(rows: FloatArray, z: FloatArray, sigma: float, start_sd: float) -> tuple[FloatArray, FloatArray]:
    """Return x and S of a fit from scratch, by QR: no squares are formed, half of the condition is spared.

    Parameters
    ----------
    rows : array (m, n)
        h of each measurement.
    z : array (m,)
    sigma, start_sd : float
        Standard deviation of a measurement, and of each element of x before.
    """
    n = rows.shape[1]
    system = np.vstack([np.eye(n) / start_sd, rows / sigma])
    q, r = np.linalg.qr(system)
    x = solve_triangular(r, q.T @ np.concatenate([np.zeros(n), z / sigma]))
    # R⁻¹ with a positive diagonal.
    s = solve_triangular(r, np.eye(n))
    return x, s * np.sign(np.diag(s))
