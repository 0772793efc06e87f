"""The likelihood of every candidate at once: generalised least squares for a grid of noise parameters.

The covariance of a run is s² [W + r F + q R]: W of the white noise of each block, F the mean of
exp(-|lag|/tau) over `TAUS_S`, which is close to flicker, R = min(ti, tj) over 2 h.  As a state space, x is
the walk and the Gauss-Markov processes, the bias their sum, in units of s::

    x(t + dt) = Phi x(t) + w,         Phi = diag(1, exp(-dt/tau_i))
    cov w = diag(q dt / 2 h, (r / 6) (1 - exp(-2 dt/tau_i)))
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.compiled import njit
from imumon.lab.diagnosis.candidates import Pool, Term

Noise = tuple[float, float]
"""Flicker r and random walk q, variances over that of the white noise of a full block."""

TAUS_S = np.array([30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0])
"""s, half a decade apart: from one block to longer than most runs."""
WALK_S = 7200.0
"""s: q is the variance of the walk after this time."""
FLICKER = (0.0, 0.3, 1.0, 3.0, 10.0, 100.0, 1000.0)
WALK = (0.0, 1.0, 10.0, 100.0, 1000.0)
GRID = [(r, q) for r in FLICKER for q in WALK]
"""Half a decade to a decade apart; each likelihood is the largest over these."""
COLLINEAR = 1e-5
"""A column of which less is left beside the base is not used."""
RIDGE = 1e-9
"""On the diagonal of normalised equations, so that collinear terms can be solved for."""


class Likelihood:
    """Log-likelihoods of the n block means of some runs, for a base (n, p) that the model so far has."""

    def __init__(self, pool: Pool) -> None:
        self.n = sum(map(len, pool.runs))
        self.price = float(np.log(self.n))
        """What a parameter costs in BIC."""
        self._pool = pool
        self._sd = {noise: self.white(np.empty((self.n, 0)), noise)[1] for noise in GRID}
        """Standard deviation of each innovation, for each noise, (n,)."""
        self._whitened: dict[Noise, dict[Term, FloatArray]] = {noise: {} for noise in GRID}

    def best(self, values: FloatArray, base: FloatArray) -> tuple[float, Noise]:
        """Return the best log-likelihood of values (n,), and its noise on the whole grid."""
        found = []
        for noise in GRID:
            left, _ = self.left(values, base, noise)
            found.append((float(self._of(left @ left, noise)), noise))
        return max(found)

    def predictive(self, values: FloatArray, early: BoolArray) -> float:
        """Return the predictive log-likelihood of later values, given the early ones and their noise."""
        found = []
        for noise in GRID:
            (white,), sd = self.white(values[:, np.newaxis], noise)[0].T, self._sd[noise]
            variance = float(np.mean(white[early] ** 2))
            fit = -0.5 * early.sum() * np.log(variance) - np.log(sd[early]).sum()
            later = -0.5 * np.sum(white[~early] ** 2) / variance
            found.append((fit, float(later - np.log(sd[~early] * np.sqrt(variance)).sum())))
        return max(found)[1]

    def scan(
        self, values: FloatArray, base: FloatArray, terms: Sequence[Sequence[Term]], grid: Sequence[Noise]
    ) -> FloatArray:
        """Return the best log-likelihood of the base with each candidate, given as terms.

        A candidate whose spectrum would have both signs explains nothing.
        """
        used = list(dict.fromkeys(term for group in terms for term in group))
        place = {term: at for at, term in enumerate(used)}
        groups = _by_size([[place[term] for term in group] for group in terms], self._pool.spectra(used))
        best = np.full(len(terms), -np.inf)
        for point in grid:
            residual, basis = self.left(values, base, point)
            explained = _explained(residual, basis, self._terms(used, point), groups, len(terms))
            best = np.maximum(best, self._of(residual @ residual - explained, point))
        return best

    def _terms(self, terms: Sequence[Term], noise: Noise) -> FloatArray:
        """Return the whitened columns of terms, a row each; each is whitened once for each noise."""
        known = self._whitened[noise]
        new = [term for term in terms if term not in known]
        known.update(zip(new, self.white(self._pool.matrix(new), noise)[0].T, strict=True))
        return np.array([known[term] for term in terms])

    def _of(self, squares: npt.ArrayLike, noise: Noise) -> FloatArray:
        """Return log-likelihoods from sums of squares of whitened residuals, s² profiled."""
        determinant = np.log(self._sd[noise]).sum()
        return np.asarray(-0.5 * self.n * np.log(np.maximum(squares, 1e-300) / self.n) - determinant)

    def left(self, values: FloatArray, base: FloatArray, noise: Noise) -> tuple[FloatArray, FloatArray]:
        """Return what the base leaves of the values, whitened, and an orthonormal basis of the base."""
        both, _ = self.white(np.column_stack([base, values]), noise)
        basis = _orthonormal(both[:, :-1])
        return both[:, -1] - basis @ (basis.T @ both[:, -1]), basis

    def white(self, columns: FloatArray, noise: Noise) -> tuple[FloatArray, FloatArray]:
        """Return columns (n, k) whitened: behind the inverse Cholesky factor of the covariance over s², and
        the standard deviations of their innovations, (n,)."""
        flicker, walk = noise
        markov_sd = np.full(len(TAUS_S), np.sqrt(flicker / len(TAUS_S)))
        parts = np.split(columns, np.cumsum([len(run) for run in self._pool.runs])[:-1])
        both, walk_sd = zip(self._pool.runs, parts, strict=True), np.sqrt(walk / WALK_S)
        found = [whiten(part, run.time_s, run.white, TAUS_S, markov_sd, walk_sd) for run, part in both]
        return np.concatenate([part for part, _ in found]), np.concatenate([sd for _, sd in found])


def no_larger(start: Noise) -> list[Noise]:
    """Return every noise that is no larger: a better model leaves less for the noise to explain.

    What a walk explained may have been flicker and an effect, or the other way round: both together are less.
    """
    return [point for point in GRID if sum(point) <= sum(start)]


def _by_size(terms: Sequence[Sequence[int]], spectra: IntArray) -> list[tuple[IntArray, IntArray, BoolArray]]:
    """Return, for each number of terms, which candidates have it (count,), their terms (count, size), and
    whether a term and the next are of one sign (count, size - 1)."""
    found = []
    for size in sorted({len(group) for group in terms} - {0}):
        which = [at for at, group in enumerate(terms) if len(group) == size]
        places = np.array([terms[at] for at in which])
        this, following = spectra[places[:, :-1]], spectra[places[:, 1:]]
        found.append((np.array(which), places, (this == following) & (this >= 0)))
    return found


def _explained(
    residual: FloatArray,
    basis: FloatArray,
    matrix: FloatArray,
    groups: Sequence[tuple[IntArray, IntArray, BoolArray]],
    count: int,
) -> FloatArray:
    """Return by how much each candidate lowers the sum of squares of the whitened residual.

    What the base leaves of a term is never written out: the residual is orthogonal to it already.
    """
    within = matrix @ basis
    before = np.einsum("ij,ij->i", matrix, matrix)
    after = before - np.einsum("ij,ij->i", within, within)
    usable = after > COLLINEAR**2 * before
    scale = np.where(usable, 1.0 / np.sqrt(np.where(usable, after, 1.0)), 0.0)
    slope = scale * (matrix @ residual)
    out = np.zeros(count)
    for which, places, one_sign in groups:
        part = slope[places]
        if places.shape[1] == 1:
            out[which] = part[:, 0] ** 2
            continue
        x, y = (part_of[places] * scale[places][:, :, np.newaxis] for part_of in (matrix, within))
        # A term that the base explains has a zero row: one on the diagonal makes its coefficient zero.
        diagonal = RIDGE + (~usable[places])
        gram = x @ x.transpose(0, 2, 1) - y @ y.transpose(0, 2, 1)
        gram += diagonal[:, :, np.newaxis] * np.eye(places.shape[1])
        solution = np.linalg.solve(gram, part[:, :, np.newaxis])[:, :, 0]
        against = one_sign & (solution[:, :-1] * solution[:, 1:] < 0)
        out[which] = np.where(against.any(axis=1), 0.0, np.einsum("ij,ij->i", solution, part))
    return out


def _orthonormal(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the columns, without those that add nothing."""
    norm = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(norm > 0, norm, 1.0), full_matrices=False)
    return np.asarray(left[:, values > 1e-10 * values[0]]) if len(values) else left


def whiten(
    columns: FloatArray,
    time_s: FloatArray,
    white: FloatArray,
    taus_s: FloatArray,
    markov_sd: FloatArray,
    walk: float,
) -> tuple[FloatArray, FloatArray]:
    """Return columns (n, k) of means behind the inverse Cholesky factor of their covariance, and the factor's
    diagonal (n,): innovations of a Kalman filter over their standard deviations, in linear time.

    Parameters
    ----------
    time_s, white : array of shape (n,)
        Time of each mean since power-on, and variance of its white noise.
    taus_s, markov_sd : array of shape (m,)
        Correlation times and standard deviations of the processes, which begin stationary.
    walk : float
        K, in the unit of the bias per sqrt(s); the walk begins at zero.
    """
    dt = np.diff(time_s, prepend=0.0)[:, np.newaxis]
    decay = np.column_stack([np.ones(len(dt)), np.exp(-dt / taus_s)])
    growth = np.column_stack([walk**2 * dt, markov_sd**2 * -np.expm1(-2.0 * dt / taus_s)])
    growth[0, 1:] = markov_sd**2
    variance = np.asarray(white, np.float64)
    whitened, sd = _innovations(decay, growth, variance, np.ascontiguousarray(columns))
    return np.asarray(whitened), np.asarray(sd)


@partial(njit, fastmath=True)
def _innovations(
    decay: FloatArray, growth: FloatArray, white: FloatArray, columns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Predict, and correct by the innovation, all columns at once: compiled, for a search has thousands.

    The one measurement is the sum of the states.  Columns come innermost: they lie side by side in memory.
    """
    n, m = columns.shape
    states = decay.shape[1]
    out, sd = np.empty((n, m)), np.empty(n)
    x, innovation = np.zeros((states, m)), np.empty(m)
    covariance, spread = np.zeros((states, states)), np.empty(states)
    for k in range(n):
        variance = white[k]
        for i in range(states):
            spread[i] = 0.0
            for j in range(states):
                covariance[i, j] *= decay[k, i] * decay[k, j]
            covariance[i, i] += growth[k, i]
            for j in range(states):
                spread[i] += covariance[i, j]
            variance += spread[i]
        sd[k] = np.sqrt(variance)
        for c in range(m):
            innovation[c] = columns[k, c]
        for i in range(states):
            for c in range(m):
                x[i, c] *= decay[k, i]
                innovation[c] -= x[i, c]
        for c in range(m):
            out[k, c] = innovation[c] / sd[k]
        for i in range(states):
            gain = spread[i] / variance
            for c in range(m):
                x[i, c] += gain * innovation[c]
            for j in range(states):
                covariance[i, j] -= gain * spread[j]
    return out, sd
