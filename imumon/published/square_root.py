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

from imumon.blocks import FloatArray
from imumon.compiled import njit


@njit
def update(x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float) -> None:
    """Take the measurement z = h x + noise into x, (n,), and S, (n, n), in place (eqs. 9 and 11)."""
    residual = z
    for i in range(x.size):
        residual -= h[i] * x[i]
    gain = np.zeros(x.size)
    d0 = sigma * sigma
    for j in range(x.size):
        f = 0.0
        for i in range(j + 1):
            f += s[i, j] * h[i]
        d1 = d0 + f * f
        b = math.sqrt(d0 / d1)
        c = f / math.sqrt(d0 * d1)
        for i in range(j + 1):
            e = gain[i]
            gain[i] += s[i, j] * f
            s[i, j] = b * s[i, j] - c * e
        d0 = d1
    for i in range(x.size):
        x[i] += gain[i] / d0 * residual


@njit
def pull_back(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float, least_share: float
) -> bool:
    """Take a measurement out of x and S again, in place (eq. 12); return False, and change nothing, if not.

    The share of the measurement's variance that the others leave, 1 - h P hᵀ/σ², must exceed `least_share`:
    below it they do not determine the state (share 0), or cancellation eats up the digits.
    """
    n = x.size
    f = np.zeros(n)
    residual, d1 = z, sigma * sigma
    for j in range(n):
        residual -= h[j] * x[j]
        for i in range(j + 1):
            f[j] += s[i, j] * h[i]
        d1 -= f[j] * f[j]
    if not d1 > least_share * sigma * sigma:
        return False
    gain = np.zeros(n)
    d0 = sigma * sigma
    for j in range(n):
        d1 = d0 - f[j] * f[j]
        b = math.sqrt(d0 / d1)
        c = f[j] / math.sqrt(d0 * d1)
        for i in range(j + 1):
            e = gain[i]
            gain[i] += s[i, j] * f[j]
            s[i, j] = b * s[i, j] + c * e
        d0 = d1
    for i in range(n):
        x[i] -= gain[i] / d0 * residual
    return True


@njit
def rotate_in(r: FloatArray, row: FloatArray) -> None:
    """Add a weighted row [h, z]/σ, (n + 1,), to the triangular system r = [R, q], (n, n + 1), in place.

    Givens rotations: no squares are formed, so half of the condition number is spared.  `row` is used up.
    """
    n = r.shape[0]
    for j in range(n):
        if row[j] == 0.0:
            continue
        length = math.hypot(r[j, j], row[j])
        c, d = r[j, j] / length, row[j] / length
        for k in range(j, n + 1):
            above = r[j, k]
            r[j, k] = c * above + d * row[k]
            row[k] = c * row[k] - d * above


@njit
def solve(r: FloatArray, x: FloatArray, s: FloatArray) -> bool:
    """Turn R x = q into x and S = R⁻¹ (upper, positive diagonal); return False when R is singular."""
    n = r.shape[0]
    for j in range(n):
        if not abs(r[j, j]) > 0.0:
            return False
    for j in range(n - 1, -1, -1):
        x[j] = r[j, n]
        for k in range(j + 1, n):
            x[j] -= r[j, k] * x[k]
        x[j] /= r[j, j]
    for j in range(n):
        for i in range(n):
            s[i, j] = 0.0
        s[j, j] = 1.0 / r[j, j]
        for i in range(j - 1, -1, -1):
            total = 0.0
            for k in range(i + 1, j + 1):
                total += r[i, k] * s[k, j]
            s[i, j] = -total / r[i, i]
        if s[j, j] < 0.0:
            for i in range(j + 1):
                s[i, j] = -s[i, j]
    return True
