"""The log-likelihood (2) of every candidate at once: generalised least squares for a grid of noise (r, q).

Rows of y, X and Z are blocks, n over all runs.  With V = L L' a tilde means behind L^-1, as in ỹ = L^-1 y::

    v         = ỹ - Q Q' ỹ                  Q (n, p) an orthonormal basis of X̃                       (6)
    RSS(X)    = v' v
    RSS(X, Z) = v' v - g' G^-1 g            g = B' v,   G = B' B,   B = Z̃ - Q Q' Z̃                    (7)

(7) is the theorem of Frisch, Waugh and Lovell.  L^-1 is a Kalman filter for each run, in linear time: its
state x is the random walk and a Gauss-Markov process for each tau, the bias their sum, in units of sigma::

    x(t + dt) = Phi x(t) + w,         Phi = diag(1, exp(-dt / tau_i))                                 (8)
    cov w     = diag(q dt / 7200 s, (r / 6) (1 - exp(-2 dt / tau_i)))

Its innovations over their standard deviations are ỹ, and these are the diagonal of L.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.compiled import njit

from .candidates import Term, Training, norms

# Flicker r and random walk q, variances over sigma², that of the white noise of a full block.
Noise = tuple[float, float]
# Half a decade apart: from one block to longer than most runs.
TAUS_S = np.array([30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0])
WALK_S = 7200.0  # q is the variance of the walk after this time, a unit only
# Half a decade to a decade apart; each likelihood is the largest over these.
NOISE_GRID = [(r, q) for r in (0.0, 0.3, 1.0, 3.0, 10.0, 100.0, 1e3) for q in (0.0, 1.0, 10.0, 100.0, 1e3)]
AT_ONCE = 256  # candidates that are whitened at once: all would take gigabytes where there are days of them


class Likelihood:
    """Log-likelihoods, half of (2), of values of the n training blocks, over all runs."""

    def __init__(self, training: Training) -> None:
        self.n = sum(map(len, training.runs))
        self.price = float(np.log(self.n))  # what a parameter costs in BIC
        self._training = training
        # For each noise: Phi and cov w of (8), by run, and the diagonal of L, (n,).
        self._laws = {noise: [law(run.time_s, noise) for run in training.runs] for noise in NOISE_GRID}
        # Of no columns, for the diagonal alone.
        self._diagonal = {noise: self.whitened(np.empty((self.n, 0)), noise)[1] for noise in NOISE_GRID}

    def maximum(self, y: FloatArray, base: FloatArray) -> tuple[float, Noise]:
        """Return loglik of y (n,) beside a base (n, p) at its maximum over the grid, and the noise there."""
        residuals = [(noise, self.v_and_q(y, base, noise)[0]) for noise in NOISE_GRID]
        return max((float(self._loglik(v @ v, noise)), noise) for noise, v in residuals)

    def predictive(self, y: FloatArray, early: BoolArray) -> float:
        """Return loglik of the later values given the early ones (n,), sigma, r and q fitted to these."""
        each = []
        for noise in NOISE_GRID:
            innovation, sd = self.whitened(y[:, None], noise)[0][:, 0], self._diagonal[noise]
            variance = np.mean(innovation[early] ** 2)
            loglik_early = -0.5 * early.sum() * np.log(variance) - np.log(sd[early]).sum()
            loglik_later = -0.5 * np.sum(innovation[~early] ** 2) / variance
            loglik_later -= np.log(sd[~early] * np.sqrt(variance)).sum()
            each.append((loglik_early, float(loglik_later)))
        return max(each)[1]  # with the noise by which the early ones are likeliest

    def scan(
        self, y: FloatArray, base: FloatArray, candidates: Sequence[Sequence[Term]], grid: Sequence[Noise]
    ) -> FloatArray:
        """Return loglik of the base with each of the candidates, its maximum over a grid, (candidates,)."""
        if len(candidates) > AT_ONCE:
            batches = [candidates[at : at + AT_ONCE] for at in range(0, len(candidates), AT_ONCE)]
            return np.concatenate([self.scan(y, base, batch, grid) for batch in batches])
        terms = list(dict.fromkeys(term for candidate in candidates for term in candidate))
        place = {term: at for at, term in enumerate(terms)}
        indices = [[place[term] for term in candidate] for candidate in candidates]
        groups = _by_size(indices, np.array([(term.spectrum, term.run) for term in terms]))
        columns, best = self._training.matrix(terms), np.full(len(candidates), -np.inf)
        for noise in grid:
            residual, basis = self.v_and_q(y, base, noise)
            rows = self.whitened(columns, noise)[0].T.copy()  # a term side by side in memory
            explained = _explained(residual, basis, rows, groups, len(candidates))
            best = np.maximum(best, self._loglik(residual @ residual - explained, noise))
        return best

    def v_and_q(self, y: FloatArray, base: FloatArray, noise: Noise) -> tuple[FloatArray, FloatArray]:
        """Return v (n,) and Q (n, p) of (6)."""
        whitened, _ = self.whitened(np.column_stack([base, y]), noise)
        white_base, white_y = whitened[:, :-1], whitened[:, -1]
        left, values, _ = np.linalg.svd(white_base / norms(white_base), full_matrices=False)
        basis = left[:, values > 1e-10 * values[0]] if len(values) else left  # without what adds nothing
        return white_y - basis @ (basis.T @ white_y), basis

    def whitened(self, columns: FloatArray, noise: Noise) -> tuple[FloatArray, FloatArray]:
        """Return L^-1 columns, (n, k), and the diagonal of L, (n,), for V of (1)."""
        each = zip(self._laws[noise], self._training.runs, self._training.split(columns), strict=True)
        rows, sd = zip(*(whiten(*noise_law, run.white, part) for noise_law, run, part in each), strict=True)
        return np.concatenate(rows), np.concatenate(sd)

    def times_l(self, rows: FloatArray, noise: Noise) -> FloatArray:
        """Return Y = rows L, (k, n), of rows (k, n)."""
        # L^-1 of each run is what `whitened` returns of an identity: L^-1' Y' = rows' is solved run by run.
        most = max(map(len, self._training.runs))
        identities = np.vstack([np.eye(len(run), most) for run in self._training.runs])
        l_inverse, _ = self.whitened(identities, noise)
        each = zip(self._training.split(l_inverse), self._training.split(rows.T), strict=True)
        solved = [solve_triangular(one[:, : len(one)], of_run, trans="T", lower=True) for one, of_run in each]
        return np.concatenate(solved).T

    def _loglik(self, rss: npt.ArrayLike, noise: Noise) -> FloatArray:
        """Return loglik by (2) of sums of squares of whitened residuals, sigma² = RSS / n."""
        half_ln_det = np.log(self._diagonal[noise]).sum()
        return np.asarray(-0.5 * self.n * np.log(np.maximum(rss, 1e-300) / self.n) - half_ln_det)


def noise_no_larger(than: Noise) -> list[Noise]:
    """Return every noise of the grid that is no larger: a better model leaves less for it to explain.  What a
    walk explained may have been flicker and an effect, or the other way round: so the sum counts."""
    return [noise for noise in NOISE_GRID if sum(noise) <= sum(than)]


# The m candidates of k terms: which they are (m,), the indices of their terms (m, k), and whether the
# coefficients of two terms, those of one spectrum in one run, have one sign (m, k, k).
_Group = tuple[IntArray, IntArray, BoolArray]


def _by_size(candidates: Sequence[Sequence[int]], spectra: IntArray) -> list[_Group]:
    """Return the candidates by their number of terms (none: in no group); `spectra` has the spectrum, or -1,
    and the run of each term, (terms, 2)."""
    groups = []
    for size in sorted({len(terms) for terms in candidates} - {0}):
        numbers = [at for at, terms in enumerate(candidates) if len(terms) == size]
        terms = np.array([candidates[at] for at in numbers])
        of_terms = spectra[terms]
        # Of the same spectrum and run, and of a spectrum at all.
        one_sign = (of_terms[:, :, None] == of_terms[:, None]).all(-1) & (of_terms[..., :1] >= 0)
        groups.append((np.array(numbers), terms, one_sign))
    return groups


def _explained(
    residual: FloatArray, basis: FloatArray, rows: FloatArray, groups: Sequence[_Group], count: int
) -> FloatArray:
    """Return g' G^-1 g of (7) for each of `count` candidates; `rows` is Z̃' of all their terms, (k, n)."""
    # Columns are normalised: their norm beside the base is 1, so that the diagonal of G is.
    beside = rows - (rows @ basis) @ basis.T
    norm = np.linalg.norm(beside, axis=1)
    usable = norm > 1e-5 * np.linalg.norm(rows, axis=1)  # else the base explains it but for rounding
    beside /= np.where(usable, norm, np.inf)[:, None]
    g_of_terms = beside @ residual
    explained = np.zeros(count)
    for numbers, terms, one_sign in groups:
        g, z = g_of_terms[terms], beside[terms]
        # A term that the base explains has a zero row: one on the diagonal makes its coefficient zero; 1e-9
        # lets collinear columns be solved for.
        ridge = np.where(usable[terms], 1e-9, 1.0)
        gram = z @ z.transpose(0, 2, 1) + ridge[:, :, None] * np.eye(terms.shape[1])
        c = np.linalg.solve(gram, g[:, :, None])[:, :, 0]
        both_signs = one_sign & (c[:, :, None] * c[:, None] < 0)
        explained[numbers] = np.where(both_signs.any(axis=(1, 2)), 0.0, np.einsum("ij,ij->i", c, g))
    return explained


def law(time_s: FloatArray, noise: Noise) -> tuple[FloatArray, FloatArray]:
    """Return the diagonals of Phi and cov w of (8), (n, states), for blocks of one run, `time_s` (n,) after
    power-on.  Its processes begin stationary, the random walk at zero."""
    flicker, walk = noise
    dt, of_each = np.diff(time_s, prepend=0.0)[:, None], flicker / len(TAUS_S)
    phi = np.column_stack([np.ones(len(dt)), np.exp(-dt / TAUS_S)])
    process = np.column_stack([walk * dt / WALK_S, of_each * -np.expm1(-2.0 * dt / TAUS_S)])
    process[0, 1:] = of_each
    return phi, process


@partial(njit, fastmath=True)
def whiten(
    phi: FloatArray, process: FloatArray, white: FloatArray, columns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return L^-1 columns, (n, k), and the diagonal of L, (n,), for means over the n blocks of one run.

    `phi`, `process`: their `law`; `white` (n,): variances of their white noise.  Predict by (8), correct by
    the innovation; H = (1, ..., 1), as the measurement is the sum of the states.  Compiled, with all columns
    at once, for there are thousands; columns come innermost, as they lie side by side in memory.
    """
    n, m = columns.shape
    states = phi.shape[1]
    out, sd = np.empty((n, m)), np.empty(n)
    x, innovation = np.zeros((states, m)), np.empty(m)
    p, ph = np.zeros((states, states)), np.empty(states)
    for k in range(n):
        variance = white[k]  # that of the innovation: H P H' + W
        for i in range(states):
            ph[i] = 0.0
            for j in range(states):
                p[i, j] *= phi[k, i] * phi[k, j]
            p[i, i] += process[k, i]
            for j in range(states):
                ph[i] += p[i, j]
            variance += ph[i]
        sd[k] = np.sqrt(variance)
        for c in range(m):
            innovation[c] = columns[k, c]
        for i in range(states):
            for c in range(m):
                x[i, c] *= phi[k, i]
                innovation[c] -= x[i, c]
        for c in range(m):
            out[k, c] = innovation[c] / sd[k]
        for i in range(states):
            gain = ph[i] / variance
            for c in range(m):
                x[i, c] += gain * innovation[c]
            for j in range(states):
                p[i, j] -= gain * ph[j]
    return out, sd
