"""The likelihood of every candidate at once: generalised least squares for a grid of noise parameters, in
batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.diagnosis.blocks import BoolArray, RunBlocks
from imumon.diagnosis.candidates import SHARED, Candidate, Pool, Term
from imumon.diagnosis.noise import FLICKER, WALK, Whitener, whitener

Noise = tuple[float, float]
"""r and q."""

COARSE_FLICKER = (0.3, 3.0, 30.0, 1000.0)
COARSE_WALK = (0.0, 10.0, 1000.0)
COLLINEAR = 1e-5
"""A column of which less is left beside the base is not used."""
RIDGE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A channel to explain: its block means over all runs and the columns of its model so far."""

    name: str
    values: FloatArray
    base: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Log-likelihoods of candidates for each target, each at its own best noise.

    Parameters
    ----------
    likelihood : array of shape (targets, candidates)
    noise : array of int, shape (targets, candidates)
        Index into `grid`.
    grid : list of Noise
    """

    likelihood: FloatArray
    noise: IntArray
    grid: list[Noise]


class Likelihood:
    """Whitens the runs and evaluates candidates.

    Parameters
    ----------
    runs : sequence of RunBlocks
        Training runs, in blocks.
    """

    def __init__(self, runs: Sequence[RunBlocks]) -> None:
        self.runs = runs
        self.n = sum(len(run) for run in runs)
        self._offsets = np.concatenate([[0], np.cumsum([len(run) for run in runs])]).astype(int)
        self._whiteners: dict[Noise, list[Whitener]] = {}

    def null(self, targets: Sequence[Target]) -> tuple[FloatArray, list[Noise]]:
        """Return the best log-likelihood of each target's model so far, and its noise on the whole grid."""
        best = np.full(len(targets), -np.inf)
        noise = [(0.0, 0.0)] * len(targets)
        for r in FLICKER:
            for q in WALK:
                for at, target in enumerate(targets):
                    value = self._plain(target, (r, q))
                    if value > best[at]:
                        best[at], noise[at] = value, (r, q)
        return best, noise

    def null_at(self, target: Target, noise: Noise) -> float:
        """Return the log-likelihood of a target's model so far for one r and q."""
        return self._plain(target, noise)

    def scan(
        self,
        targets: Sequence[Target],
        pool: Pool,
        terms: Sequence[Sequence[Term]],
        grid: Sequence[Noise],
    ) -> Scan:
        """Return the likelihood of each candidate, given as terms, added to each target's model."""
        used = list(dict.fromkeys(term for group in terms for term in group))
        place = {term: at for at, term in enumerate(used)}
        groups = _by_size([[place[term] for term in group] for group in terms])
        columns = list(dict.fromkeys(column for column, _ in used))
        raw = [pool.raw(columns, run) for run in range(len(self.runs))]
        order = {column: at for at, column in enumerate(columns)}
        best = np.full((len(targets), len(terms)), -np.inf)
        noise = np.zeros((len(targets), len(terms)), np.int64)
        for index, point in enumerate(grid):
            filters = self._filters(point)
            white = [filters[run](raw[run]) for run in range(len(self.runs))]
            matrix = self._spread(white, used, order)
            determinant = sum(item.log_determinant for item in filters)
            for at, target in enumerate(targets):
                residual, basis = self._projected(target, filters)
                value = _explained(residual, basis, matrix, groups, len(terms))
                left = np.maximum(residual @ residual - value, 1e-300)
                found = -0.5 * self.n * np.log(left / self.n) - determinant
                better = found > best[at]
                best[at][better] = found[better]
                noise[at][better] = index
        return Scan(best, noise, list(grid))

    def whitened(self, columns: FloatArray, noise: Noise) -> FloatArray:
        """Return columns (n, k) over all runs, whitened."""
        return self._white(columns, self._filters(noise))

    def rows(self) -> list[BoolArray]:
        """Return which blocks are those of each run, (n,) each."""
        run = np.repeat(np.arange(len(self.runs)), [len(run) for run in self.runs])
        return [run == at for at in range(len(self.runs))]

    def _filters(self, noise: Noise) -> list[Whitener]:
        if noise not in self._whiteners:
            self._whiteners[noise] = [whitener(run.time_s, run.white, *noise) for run in self.runs]
        return self._whiteners[noise]

    def _white(self, columns: FloatArray, filters: Sequence[Whitener]) -> FloatArray:
        bounds = self._offsets
        return np.concatenate(
            [item(columns[bounds[run] : bounds[run + 1]]) for run, item in enumerate(filters)]
        )

    def _projected(self, target: Target, filters: Sequence[Whitener]) -> tuple[FloatArray, FloatArray]:
        """Return the whitened residual of the model so far, and an orthonormal basis of it."""
        both = self._white(np.column_stack([target.base, target.values]), filters)
        basis = _orthonormal(both[:, :-1])
        values = both[:, -1]
        return values - basis @ (basis.T @ values), basis

    def _plain(self, target: Target, noise: Noise) -> float:
        filters = self._filters(noise)
        residual, _ = self._projected(target, filters)
        left = max(float(residual @ residual), 1e-300)
        determinant = sum(item.log_determinant for item in filters)
        return float(-0.5 * self.n * np.log(left / self.n) - determinant)

    def _spread(self, white: Sequence[FloatArray], used: Sequence[Term], order: dict[int, int]) -> FloatArray:
        """Return the whitened columns of all terms, (terms, n): zero in runs that a term is not of."""
        out = np.zeros((len(used), self.n))
        for run, part in enumerate(white):
            rows = [at for at, (_, scope) in enumerate(used) if scope in (SHARED, run)]
            picked = [order[used[at][0]] for at in rows]
            out[rows, self._offsets[run] : self._offsets[run + 1]] = part[:, picked].T
        return out


def fine_grid(start: Noise) -> list[Noise]:
    """Return every r and q up to the given ones: a better model leaves less for the noise to explain."""
    return [(r, q) for r in FLICKER if r <= start[0] for q in WALK if q <= start[1]]


def coarse_grid(starts: Sequence[Noise]) -> list[Noise]:
    """Return a coarser grid up to the largest of the given r and q, with these among it."""
    r_top, q_top = max(r for r, _ in starts), max(q for _, q in starts)
    points = [(r, q) for r in COARSE_FLICKER if r <= r_top for q in COARSE_WALK if q <= q_top]
    return list(dict.fromkeys([*points, *starts]))


def neighbours(noise: Noise) -> list[Noise]:
    """Return the points of the whole grid beside this one, and it."""
    return [(r, q) for r in _beside(FLICKER, noise[0]) for q in _beside(WALK, noise[1])]


def _beside(values: tuple[float, ...], value: float) -> tuple[float, ...]:
    at = values.index(value) if value in values else int(np.argmin(np.abs(np.subtract(values, value))))
    return values[max(0, at - 1) : at + 2]


def _by_size(groups: Sequence[Sequence[int]]) -> list[tuple[IntArray, IntArray]]:
    """Return, for each number of terms, which candidates have it and their terms (count, size)."""
    sizes = sorted({len(group) for group in groups})
    found = []
    for size in sizes:
        which = [at for at, group in enumerate(groups) if len(group) == size]
        if size:
            found.append((np.array(which), np.array([groups[at] for at in which])))
    return found


def _explained(
    residual: FloatArray,
    basis: FloatArray,
    matrix: FloatArray,
    groups: Sequence[tuple[IntArray, IntArray]],
    count: int,
) -> FloatArray:
    """Return by how much each candidate lowers the sum of squares of the whitened residual."""
    before = np.einsum("ij,ij->i", matrix, matrix)
    left = matrix - (matrix @ basis) @ basis.T
    after = np.einsum("ij,ij->i", left, left)
    usable = after > COLLINEAR**2 * before
    scale = np.where(usable, 1.0 / np.sqrt(np.where(usable, after, 1.0)), 0.0)
    left *= scale[:, np.newaxis]
    slope = left @ residual
    out = np.zeros(count)
    for which, places in groups:
        part = slope[places]
        if places.shape[1] == 1:
            out[which] = part[:, 0] ** 2
            continue
        x = left[places]
        gram = x @ x.transpose(0, 2, 1)
        gram += RIDGE * np.eye(places.shape[1])
        # A term that the base explains has a zero row: one on the diagonal makes its coefficient zero.
        gaps = (~usable[places]).astype(np.float64)
        gram += gaps[:, :, np.newaxis] * np.eye(places.shape[1])
        solution = np.linalg.solve(gram, part[:, :, np.newaxis])[:, :, 0]
        out[which] = np.einsum("ij,ij->i", solution, part)
    return out


def _orthonormal(columns: FloatArray) -> FloatArray:
    """Return an orthonormal basis of the columns, without those that add nothing."""
    norm = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(norm > 0, norm, 1.0)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(left[:, values > 1e-10 * values[0]]) if len(values) else left


def parameters(candidate: Candidate, terms: Sequence[Term]) -> int:
    """Return the number of linear and nonlinear parameters."""
    return len(terms) + candidate.nonlinear
