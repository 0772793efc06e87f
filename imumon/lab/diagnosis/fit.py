"""Fit an extended model, the base with effects: coefficients, residuals, score on the test, sigmas.

Coefficients are those of ordinary least squares: the verdict goes by the rms, which they make least, and they
do not depend on the noise of (1): beside a large random walk, generalised least squares fit little but the
differences of neighbouring blocks.  That noise enters the sigmas only (`sigmas`).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.effects.base import Drive, Effect, Survey

from .blocks import RunBlocks
from .candidates import Candidate, Channel, Model, Part, least_squares, pseudo_inverse
from .likelihood import Likelihood

LEAST_TEST_BLOCKS = 10
"""Of fewer there is no rms of the test."""
LEAST_OFFSET_BLOCKS = 4
"""With one constant: the mean of fewer takes too much of their own noise away."""


class FittedPart(NamedTuple):
    """An effect of a fitted model, with the coefficients that carry over.

    `coefficients` are in the unit of the channel per unit of the column, (separate runs, k); where they are
    shared `separate_runs` is empty, and they are (1, k).  `start` are those of `Effect.start_columns`,
    (runs, m); empty when the start is not free.
    """

    effect: Effect
    separate_runs: tuple[int, ...]
    coefficients: FloatArray
    start: FloatArray

    @property
    def carries_over(self) -> bool:
        """Whether it predicts another run: its coefficients are shared, or nearly the same in every run, none
        further from their mean than 0.35 of it."""
        mean = self.coefficients.mean(axis=0)
        spread = np.linalg.norm(self.coefficients - mean, axis=1).max()
        same = self.effect.scope == "either" and spread <= 0.35 * float(np.linalg.norm(mean))
        return not self.separate_runs or same

    def known_in(self, run: int | None) -> bool:
        """Whether a training run has separate coefficients: an offset against the first run is 0 in that."""
        return run in self.separate_runs or (run is not None and self.effect.scope == "run")


class Fit(NamedTuple):
    """An extended model fitted by ordinary least squares; `residual` is y less it, (n,).

    `declared` are the coefficients of the powers of u, (degree + 1,), with the constant to predict another
    run by: the mean of the constants of runs or poses, of which further ones are differences from the first,
    plus `mean_of_separate`, that over training of what does not carry over, such as jumps.
    `constant_weights`, (p + k,), has the weight of each coefficient of [X Z] in it.
    """

    declared: FloatArray
    constant_weights: FloatArray
    mean_of_separate: float
    parts: list[FittedPart]
    residual: FloatArray

    @property
    def train_rms(self) -> float:
        """rms of the residual in training."""
        return root_mean_square(self.residual)

    @property
    def carries_over(self) -> bool:
        """Whether any effect carries over to another run."""
        return any(part.carries_over for part in self.parts)


def fit(channel: Channel, model: Model) -> Fit:
    """Fit the declared model and candidates to training by ordinary least squares."""
    design, n_base, n_powers = channel.design(model), channel.base.shape[1], channel.degree + 1
    coefficients = least_squares(design, channel.y)
    constant_weights, no_start = np.zeros(len(coefficients)), np.empty((0, 0))
    constant_weights[0], constant_weights[n_powers:n_base] = 1.0, 1.0 / (n_base - n_powers + 1)
    parts = [FittedPart(one, (), np.array([one.coefficients]), no_start) for one in channel.fixed_effects]
    for candidate, where, starts in _layout(channel, model):
        runs = len(channel.training.runs) if candidate.free_start else 0
        start_of_parts = coefficients[starts].reshape(len(candidate.parts), runs, -1 if runs else 0)
        rows_of_parts = _by_part(candidate, coefficients[where])
        for part, rows, start in zip(candidate.parts, rows_of_parts, start_of_parts, strict=True):
            effect = part.effect.with_coefficients(rows.mean(axis=0))
            parts.append(FittedPart(effect, part.separate_runs, rows, start))
        if not parts[-1].carries_over:
            constant_weights[where] = design[:, where].mean(axis=0)
    declared = np.append(constant_weights @ coefficients, coefficients[1:n_powers])
    mean_of_separate = float(constant_weights[n_base:] @ coefficients[n_base:])
    return Fit(declared, constant_weights, mean_of_separate, parts, channel.y - design @ coefficients)


def _layout(channel: Channel, model: Model) -> Iterator[tuple[Candidate, slice, slice]]:
    """Yield each candidate with its columns of the design, and those of its free start."""
    at = channel.base.shape[1]
    for one in model:
        of_effect, of_start = map(len, channel.training.terms(one))
        yield one, slice(at, at + of_effect), slice(at + of_effect, at + of_effect + of_start)
        at += of_effect + of_start


def _by_part(candidate: Candidate, values: FloatArray) -> list[FloatArray]:
    """Return values of a candidate's columns for each of its parts, (separate runs or 1, k)."""
    sizes = [part.effect.width * max(1, len(part.separate_runs)) for part in candidate.parts]
    rows = np.split(values, np.cumsum(sizes)[:-1])
    return [row.reshape(-1, part.effect.width) for part, row in zip(candidate.parts, rows, strict=True)]


class Score(NamedTuple):
    """How a model does on runs that it was not fitted to, in the unit of the channel; NaN without a test.

    *Predicted*, as `rms` is: by what carries over; nothing of the test is used but a constant where the
    declared model has one for each run or pose.  *Estimated*: with what does not carry over fitted to the
    test itself.  Of each run there are both residuals, and which blocks count, (n,).

    `coverage` is the share of the blocks inside the trained temperatures, `scored_share` that of those which
    count: after the state at power-on is forgotten.  `continues_training`: whether a run of the test
    continues a training run with separate coefficients.
    """

    rms: float
    estimated_rms: float
    coverage: float
    scored_share: float
    predicted_residual: list[FloatArray]
    estimated_residual: list[FloatArray]
    counts: list[BoolArray]
    continues_training: bool

    @property
    def smaller_rms(self) -> float:
        """rms predicted or estimated, the smaller one; NaN only without both."""
        return float(np.fmin(self.rms, self.estimated_rms))


def score_test(channel: Channel, model: Fit, settled_as: Fit | None = None) -> Score:
    """Return how a fitted model does on the test runs, within the trained temperatures.

    Blocks count after the state at power-on is forgotten, of the model `settled_as` where one is given: the
    same for the models that are compared.
    """
    trained, predicted, estimated, counts, inside = channel.temperature, [], [], [], 0
    begun_in, continues = [run.run.name for run in channel.training.runs], False
    for run in channel.test:
        # The training run that it continues; None where it has its own power-on.
        continued = begun_in.index(run.run.begun_in) if run.run.begun_in in begun_in else None
        continues |= any(part.known_in(continued) for part in model.parts)
        temperature = channel.training.temperature_name
        t, drive = run.temperature[temperature], run.drives[temperature]
        counting = (t >= trained.min()) & (t <= trained.max())
        inside += int(counting.sum())
        for part in (settled_as or model).parts:
            counting &= run.average(part.effect.settled(drive).astype(np.float64)) > 0.99
        residual = run.mean[channel.name] - _predicted_bias(channel, run, drive, model, continued)
        if channel.offset_per != "all":
            residual, counting = _without_offsets(residual, counting, channel.offset_numbers(run))
        predicted.append(residual)
        not_carried = [part for part in model.parts if not (part.carries_over or part.known_in(continued))]
        estimated.append(residual - _estimated_bias(channel, run, drive, not_carried, residual, counting))
        counts.append(counting)
    coverage = inside / sum(map(len, counts)) if channel.test else np.nan
    scored_share = sum(int(part.sum()) for part in counts) / max(inside, 1) if channel.test else np.nan
    rms, estimated_rms = _rms_of(predicted, counts), _rms_of(estimated, counts)
    return Score(rms, estimated_rms, coverage, scored_share, predicted, estimated, counts, continues)


def root_mean_square(values: FloatArray) -> float:
    """Return the rms of values; NaN without any."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def _rms_of(residuals: Sequence[FloatArray], counts: Sequence[BoolArray]) -> float:
    values = np.concatenate([np.empty(0), *(one[of] for one, of in zip(residuals, counts, strict=True))])
    return root_mean_square(values) if len(values) >= LEAST_TEST_BLOCKS else np.nan


def _without_offsets(
    residual: FloatArray, counting: BoolArray, numbers: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Return a residual less a constant for each number, and which blocks count: of numbers with enough."""
    member = numbers[:, None] == np.unique(numbers)
    number = member[counting].sum(axis=0)
    mean = residual[counting] @ member[counting] / np.maximum(number, 1)
    return residual - member @ mean, counting & (member @ (number >= LEAST_OFFSET_BLOCKS))


def _predicted_bias(
    channel: Channel, run: RunBlocks, drive: Drive, model: Fit, continued: int | None
) -> FloatArray:
    temperature = run.temperature[channel.training.temperature_name]
    bias = channel.powers(temperature, len(model.declared)) @ model.declared
    for part in model.parts:
        if part.carries_over:
            bias = bias + run.average(part.effect.simulate(drive))
        elif continued in part.separate_runs:
            row = part.coefficients[part.separate_runs.index(continued)]
            bias = bias + run.average(part.effect.columns(drive)) @ row
    return bias if continued is None else bias - model.mean_of_separate


def _estimated_bias(
    channel: Channel,
    run: RunBlocks,
    drive: Drive,
    parts: list[FittedPart],
    residual: FloatArray,
    counting: BoolArray,
) -> FloatArray:
    """Return the parts that do not carry over, fitted to the residual of the blocks that count, (n,).

    That is a constant, the coefficients that each run may have, and one jump where the model has jumps.  What
    the training run has that this one continues is predicted, and is not fitted.
    """
    if not parts or counting.sum() < LEAST_TEST_BLOCKS:
        return np.zeros(len(run))
    effects = [part.effect for part in parts]
    of_effects = [run.average(one.columns(drive)) for one in effects if one.scope == "either"]
    numbers = channel.offset_numbers(run)[:, None]
    columns = np.column_stack([numbers == np.unique(numbers[counting]), *of_effects]).astype(float)
    if any(one.scope == "event" for one in effects):
        first = np.flatnonzero(counting)[_jump_at(columns[counting], residual[counting])]
        columns = np.column_stack([columns, np.arange(len(run)) >= first])
    return columns @ least_squares(columns[counting], residual[counting])


def _jump_at(columns: FloatArray, residual: FloatArray) -> int:
    """Return the block from which on a jump, beside the columns (n, k), explains most of a residual (n,).

    By (7) with a jump z at each block: (z' v)² / (z' z - |Q' z|²).
    """
    basis = np.linalg.qr(columns)[0]
    v = residual - basis @ (basis.T @ residual)
    g = np.cumsum(v[::-1])[::-1]
    gram = np.arange(len(v), 0, -1) - (np.cumsum(basis[::-1], axis=0)[::-1] ** 2).sum(axis=1)
    explained = (g**2 / np.maximum(gram, 1e-9))[LEAST_OFFSET_BLOCKS : -LEAST_OFFSET_BLOCKS + 1]
    return LEAST_OFFSET_BLOCKS + int(np.argmax(explained))


class PartSigma(NamedTuple):
    """Standard deviations of a part: of its coefficients, (separate runs or 1, k), and of theta by name."""

    coefficients: FloatArray
    nonlinear: dict[str, float]


def sigmas(
    channel: Channel, span: Survey, likelihood: Likelihood, model: Model
) -> tuple[FloatArray, list[list[PartSigma]]]:
    """Return the covariance of the declared coefficients, (degree + 1, degree + 1), and the standard
    deviations of each candidate's parts, with the noise that the model is likeliest with.

    theta is where the likelihood is largest, b and c are those of ordinary least squares beside it.  Near the
    truth both are linear in the noise e.  With A = [X Z], D the slopes in ln theta, e = s L w, w white::

        error of ln theta = s M w,                       M the last rows of pinv(L^-1 [A D])            (9)
        error of (b, c)   = s (pinv(A) L - pinv(A) D M) w
    """
    design, runs = channel.design(model), channel.training.runs
    slopes = _slopes(channel, span, model)
    noise = likelihood.maximum(channel.y, design)[1]
    whitened, _ = likelihood.whitened(np.column_stack([design, slopes, channel.y]), noise)
    columns, y = whitened[:, :-1], whitened[:, -1]
    inverse, pinv_a = pseudo_inverse(columns), pseudo_inverse(design)
    s = np.sqrt(np.sum((y - columns @ (inverse @ y)) ** 2) / max(len(y) - columns.shape[1], 1))
    m = inverse[design.shape[1] :]
    # L has that of each run on its diagonal: Y = pinv(A) L solves Y L^-1 = pinv(A), run by run.
    identities = np.vstack([np.eye(len(run), max(map(len, runs))) for run in runs])
    l_inverse, _ = likelihood.whitened(identities, noise)
    of_runs = zip(channel.training.split(l_inverse), channel.training.split(pinv_a.T), strict=True)
    solved = [solve_triangular(one[:, : len(one)], rows, trans="T", lower=True) for one, rows in of_runs]
    linear = s * (np.concatenate(solved).T - (pinv_a @ slopes) @ m)
    sd_of_log, sd = s * np.linalg.norm(m, axis=1), np.linalg.norm(linear, axis=1)
    relative, found = iter(sd_of_log.tolist()), []
    for one, where, _ in _layout(channel, model):
        thetas = [{name: next(relative) * at for name, at in _theta(part).items()} for part in one.parts]
        found.append([*map(PartSigma, _by_part(one, sd[where]), thetas)])
    declared = np.vstack([fit(channel, model).constant_weights @ linear, linear[1 : channel.degree + 1]])
    return declared @ declared.T, found


def _theta(part: Part) -> dict[str, float]:
    """Return the nonlinear parameters of a part that are not zero."""
    found = {name: float(getattr(part.effect, name)) for name in part.effect.nonlinear}
    return {name: value for name, value in found.items() if value > 0.0}


def _slopes(channel: Channel, span: Survey, model: Model) -> FloatArray:
    """Return D of (9), how the model changes with the logarithm of each nonlinear parameter, (n, thetas)."""
    coefficients = least_squares(channel.design(model), channel.y)
    slopes = [np.empty((len(channel.y), 0))]
    for one, where, starts in _layout(channel, model):
        of_candidate = coefficients[where.start : starts.stop]
        for at, part in enumerate(one.parts):
            for name, value in _theta(part).items():
                # At most a quarter of its grid's distance: a percent of a period is a cycle in a hundred.
                change = min(0.01, abs(part.effect.moved(name, 0.25, span) / value - 1.0))
                values = value * (1.0 - change), value * (1.0 + change)
                moved = (part.effect.model_copy(update={name: changed}) for changed in values)
                ends = [
                    channel.training.design([one.with_effect(at, effect)]) @ of_candidate for effect in moved
                ]
                slopes.append(np.diff(np.column_stack(ends)) / (2.0 * change))
    return np.column_stack(slopes)
