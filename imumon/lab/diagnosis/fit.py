"""Fit an extended model, the base with effects: coefficients, residuals, score on the test, sigmas.

Coefficients are those of ordinary least squares: the verdict goes by the rms, which they make least, and they
do not depend on the noise of (1): beside a large random walk, generalised least squares fit little but the
differences of neighbouring blocks.  That noise enters the sigmas only (`sigmas`).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.effects.base import Drive, Effect, Survey

from .blocks import RunInBlocks
from .candidates import Candidate, Candidates, Channel, Part, least_squares, pseudo_inverse, root_mean_square
from .likelihood import Likelihood

LEAST_TEST_BLOCKS = 10  # of fewer there is no rms of the test (assumed)
# Of those that share a constant: less the mean of fewer, too little is left of their own noise.  Assumed.
LEAST_OFFSET_BLOCKS = 4


class FittedPart(NamedTuple):
    """An effect of a fitted model; its own coefficients are those that carry over, the mean of the runs'."""

    effect: Effect
    separate_runs: tuple[int, ...]  # runs with coefficients of their own; none: they are shared
    coefficients: FloatArray  # unit of the channel per unit of the column, (separate runs or 1, k)
    start: FloatArray  # those of `Effect.start_columns`, (runs, m); empty when the start is not free

    @property
    def carries_over(self) -> bool:
        """Whether it predicts another run: its coefficients are shared, or nearly the same in every run, none
        further from their mean than 0.35 of it (assumed)."""
        mean = self.coefficients.mean(axis=0)
        spread = np.linalg.norm(self.coefficients - mean, axis=1).max()
        same = self.effect.scope == "either" and spread <= 0.35 * float(np.linalg.norm(mean))
        return not self.separate_runs or same

    def known_in(self, run: int | None) -> bool:
        """Whether a training run has separate coefficients (in the first an offset against it is 0); None: a
        run with a power-on of its own, which has not."""
        return run is not None and (run in self.separate_runs or self.effect.scope == "run")


class Fit(NamedTuple):
    """An extended model fitted by ordinary least squares.

    The declared constant predicts another run.  There the size of what does not carry over is not known, such
    as a jump: for these columns Z_s of Z their mean over training stands::

        constant = constant_weights' (b, c) = mean of the constants of all runs or poses + mean of Z_s c_s

    Of a jump by c in the middle of the training Z_s c_s is 0 before it, c after it, and c / 2 in the mean.
    """

    declared: FloatArray  # coefficients of the powers of u, the constant first, (degree + 1,)
    constant_weights: FloatArray  # (p + k,)
    mean_of_separate: float  # that of Z_s c_s over training
    parts: list[FittedPart]
    residual: FloatArray  # y less the model, (n,)

    @property
    def train_rms(self) -> float:
        """rms of the residual in training."""
        return root_mean_square(self.residual)

    @property
    def carries_over(self) -> bool:
        """Whether any effect carries over to another run."""
        return any(part.carries_over for part in self.parts)


def fit(channel: Channel, model: Candidates) -> Fit:
    """Fit the declared model and candidates to training by ordinary least squares."""
    design = channel.design(model)
    coefficients = least_squares(design, channel.y)
    offsets = channel.offset_columns
    # Constants are b_0, and b_0 plus each offset from it: their mean.
    constant_weights = np.zeros_like(coefficients)
    constant_weights[0] = 1.0
    constant_weights[offsets] = 1.0 / (offsets.stop - offsets.start + 1)
    no_start = np.empty((0, 0))
    parts = [FittedPart(one, (), np.array([one.coefficients]), no_start) for one in channel.fixed_effects]
    for candidate, columns, start_columns in _layout(channel, model):
        # A candidate with a free start has one part.
        n_runs = len(channel.training.runs)
        start = coefficients[start_columns].reshape(n_runs, -1) if candidate.free_start else no_start
        for part, rows in zip(candidate.parts, _by_part(candidate, coefficients[columns]), strict=True):
            effect = part.effect.with_coefficients(rows.mean(axis=0))
            parts.append(FittedPart(effect, part.separate_runs, rows, start))
            if not parts[-1].carries_over:
                # All columns of the candidate: where it has two parts, both carry over.
                constant_weights[columns] = design[:, columns].mean(axis=0)
    declared = np.append(constant_weights @ coefficients, coefficients[1 : offsets.start])
    mean_of_separate = float(constant_weights[offsets.stop :] @ coefficients[offsets.stop :])
    return Fit(declared, constant_weights, mean_of_separate, parts, channel.y - design @ coefficients)


def _layout(channel: Channel, model: Candidates) -> Iterator[tuple[Candidate, slice, slice]]:
    """Yield each candidate with its columns of the design: those of its effects, and of its free start."""
    first = channel.base.shape[1]
    for candidate in model:
        n_effects, n_start = map(len, channel.training.terms(candidate))
        middle = first + n_effects
        yield candidate, slice(first, middle), slice(middle, middle + n_start)
        first = middle + n_start


def _by_part(candidate: Candidate, values: FloatArray) -> list[FloatArray]:
    """Return values of a candidate's columns for each of its parts, (separate runs or 1, k)."""
    sizes = [part.effect.width * max(1, len(part.separate_runs)) for part in candidate.parts]
    rows = np.split(values, np.cumsum(sizes)[:-1])
    return [row.reshape(-1, part.effect.width) for part, row in zip(candidate.parts, rows, strict=True)]


class Score(NamedTuple):
    """How a model does on runs that it was not fitted to, in the unit of the channel; NaN without a test.

    *Predicted*: by what carries over; nothing of the test is used but a constant where the declared model has
    one for each run or pose.  *Estimated*: with what does not carry over fitted to the test itself.
    """

    rms: float  # predicted
    estimated_rms: float
    coverage: float  # share of the blocks inside the trained temperatures
    scored_share: float  # share of these that count: after the state at power-on is forgotten
    predicted_residual: list[FloatArray]  # of each run, (n,)
    estimated_residual: list[FloatArray]
    counts: list[BoolArray]  # which blocks count
    continues_training: bool  # whether a run continues a training run with separate coefficients

    @property
    def smaller_rms(self) -> float:
        """rms predicted or estimated, the smaller one; NaN only without both."""
        return float(np.fmin(self.rms, self.estimated_rms))


def score_test(channel: Channel, fitted: Fit, settled_as: Fit | None = None) -> Score:
    """Return how a fitted model does on the test runs, within the trained temperatures.

    Blocks count after the state at power-on is forgotten, of the model `settled_as` where one is given: the
    same for the models that are compared.
    """
    trained = channel.temperature
    names = [run.in_slots.name for run in channel.training.runs]
    temperature_name = channel.training.temperature_name
    predicted, estimated, counts = [], [], []
    inside, continues = 0, False
    for run in channel.test:
        # The training run that it continues; None where it has its own power-on.
        continued = names.index(run.in_slots.begun_in) if run.in_slots.begun_in in names else None
        continues |= any(part.known_in(continued) for part in fitted.parts)
        t, drive = run.temperature[temperature_name], run.drives[temperature_name]
        counting = (t >= trained.min()) & (t <= trained.max())
        inside += int(counting.sum())
        for part in (settled_as or fitted).parts:
            settled_share = run.average(part.effect.settled(drive).astype(np.float64))
            counting &= settled_share > 0.99  # 1, but for rounding
        residual = run.mean[channel.name] - _predicted_bias(channel, run, drive, fitted, continued)
        if channel.offset_per != "all":
            residual, counting = _without_offsets(residual, counting, channel.offset_numbers(run))
        predicted.append(residual)
        unknown = [part for part in fitted.parts if not (part.carries_over or part.known_in(continued))]
        estimated.append(residual - _estimated_bias(channel, run, unknown, residual, counting))
        counts.append(counting)
    coverage = inside / sum(map(len, counts)) if channel.test else np.nan
    scored_share = sum(map(np.count_nonzero, counts)) / max(inside, 1) if channel.test else np.nan
    rms, estimated_rms = _rms_of(predicted, counts), _rms_of(estimated, counts)
    return Score(rms, estimated_rms, coverage, scored_share, predicted, estimated, counts, continues)


def _rms_of(residuals: Sequence[FloatArray], counts: Sequence[BoolArray]) -> float:
    values = np.concatenate([np.empty(0), *(r[c] for r, c in zip(residuals, counts, strict=True))])
    return root_mean_square(values) if len(values) >= LEAST_TEST_BLOCKS else np.nan


def _without_offsets(
    residual: FloatArray, counting: BoolArray, numbers: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Return a residual less its mean over the blocks of each number, and which count: those of enough."""
    member = numbers[:, None] == np.unique(numbers)
    size = member[counting].sum(axis=0)
    mean = residual[counting] @ member[counting] / np.maximum(size, 1)
    return residual - member @ mean, counting & (member @ (size >= LEAST_OFFSET_BLOCKS))


def _predicted_bias(
    channel: Channel, run: RunInBlocks, drive: Drive, fitted: Fit, continued: int | None
) -> FloatArray:
    """Return what a fitted model predicts of a test run, (n,), which may continue a training run."""
    # What does not carry over goes on from a training run; in other runs the constant has its mean (`Fit`).
    temperature = run.temperature[channel.training.temperature_name]
    bias = channel.powers(temperature, len(fitted.declared)) @ fitted.declared
    for part in fitted.parts:
        if part.carries_over:
            bias = bias + run.average(part.effect.simulate(drive))
        elif continued in part.separate_runs:
            row = part.coefficients[part.separate_runs.index(continued)]
            bias = bias + run.average(part.effect.columns(drive)) @ row
    # Of a run that continues, its own is in the bias by now: the mean must not be in there as well.
    return bias if continued is None else bias - fitted.mean_of_separate


def _estimated_bias(
    channel: Channel, run: RunInBlocks, parts: list[FittedPart], residual: FloatArray, counting: BoolArray
) -> FloatArray:
    """Return the parts that do not carry over, fitted to the residual of the blocks that count, (n,)."""
    # That is a constant, the coefficients that each run may have, and one jump where the model has jumps.
    if not parts or counting.sum() < LEAST_TEST_BLOCKS:
        return np.zeros(len(run))
    drive = run.drives[channel.training.temperature_name]
    of_runs = [run.average(part.effect.columns(drive)) for part in parts if part.effect.scope == "either"]
    numbers = channel.offset_numbers(run)[:, None]
    columns = np.column_stack([numbers == np.unique(numbers[counting]), *of_runs]).astype(float)
    if any(part.effect.scope == "event" for part in parts):
        first = np.flatnonzero(counting)[_jump_at(columns[counting], residual[counting])]
        columns = np.column_stack([columns, np.arange(len(run)) >= first])
    return columns @ least_squares(columns[counting], residual[counting])


def _jump_at(columns: FloatArray, residual: FloatArray) -> int:
    """Return the block from which on a jump, beside the columns (n, k), explains most of a residual (n,).

    By (7) of `likelihood` with a column z for each block, 0 before it and 1 from it on::

        explained = g² / G,    g = z' v,    G = z' z - |z' Q|²
    """
    q = np.linalg.qr(columns)[0]
    v = residual - q @ (q.T @ residual)
    # For all z at once: z' v is the sum of v from a block to the end, and so is z' Q of the rows of Q.
    g = np.cumsum(v[::-1])[::-1]
    z_q = np.cumsum(q[::-1], axis=0)[::-1]
    gram = np.arange(len(v), 0, -1) - (z_q**2).sum(axis=1)
    explained = (g**2 / np.maximum(gram, 1e-9))[LEAST_OFFSET_BLOCKS : -LEAST_OFFSET_BLOCKS + 1]
    return LEAST_OFFSET_BLOCKS + int(np.argmax(explained))


class PartSigma(NamedTuple):
    """Standard deviations of a part: of its coefficients, (separate runs or 1, k), and of theta by name."""

    coefficients: FloatArray
    nonlinear: dict[str, float]


def sigmas(
    channel: Channel, span: Survey, likelihood: Likelihood, model: Candidates
) -> tuple[FloatArray, list[list[PartSigma]]]:
    """Return the covariance of the declared coefficients, (degree + 1, degree + 1), and the standard
    deviations of each candidate's parts, with the noise that the model is likeliest with.

    theta is where the likelihood is largest, b and c are those of ordinary least squares beside it.  Near the
    truth both are linear in the noise e.  With A = [X Z], D the slopes in ln theta, V = L L' of the noise,
    e = sigma L w and w white, of variance 1, the errors are N w and P w::

        of ln theta:    N = sigma M,                      M the last rows of pinv(L^-1 [A D])           (9)
        of (b, c):      P = sigma (pinv(A) L - pinv(A) D M)

    Least squares take e for part of the model, pinv(A) e, and so they do D times the error of ln theta.
    """
    a = channel.design(model)
    d = _slopes(channel, span, model)
    pinv_a = pseudo_inverse(a)
    noise = likelihood.maximum(channel.y, a)[1]
    whitened, _ = likelihood.whitened(np.column_stack([a, d, channel.y]), noise)
    columns, y = whitened[:, :-1], whitened[:, -1]
    inverse = pseudo_inverse(columns)
    rss = np.sum((y - columns @ (inverse @ y)) ** 2)
    sigma = np.sqrt(rss / max(len(y) - columns.shape[1], 1))
    m = inverse[a.shape[1] :]
    p = sigma * (likelihood.times_l(pinv_a, noise) - (pinv_a @ d) @ m)
    sd_of_linear = np.linalg.norm(p, axis=1)
    sd_of_log = iter((sigma * np.linalg.norm(m, axis=1)).tolist())  # in the order of the columns of D
    of_each = []
    for candidate, effect_columns, _ in _layout(channel, model):
        # The sd of theta is theta times that of its logarithm.
        sd_of_theta = [
            {name: theta * next(sd_of_log) for name, theta in _theta(part).items()}
            for part in candidate.parts
        ]
        of_each.append([*map(PartSigma, _by_part(candidate, sd_of_linear[effect_columns]), sd_of_theta)])
    # The declared coefficients are the constant, a weighted sum, and the powers as they are.
    declared = np.vstack([fit(channel, model).constant_weights @ p, p[1 : channel.degree + 1]])
    return declared @ declared.T, of_each


def _theta(part: Part) -> dict[str, float]:
    """Return the nonlinear parameters of a part that are not zero."""
    effect = part.effect
    return {name: theta for name in effect.nonlinear if (theta := float(getattr(effect, name))) > 0.0}


def _slopes(channel: Channel, span: Survey, model: Candidates) -> FloatArray:
    """Return D of (9), how the model changes with the logarithm of each nonlinear parameter, (n, thetas)."""
    coefficients = least_squares(channel.design(model), channel.y)
    slopes = [np.empty((len(channel.y), 0))]
    for candidate, effect_columns, start_columns in _layout(channel, model):
        of_candidate = coefficients[effect_columns.start : start_columns.stop]
        for at, part in enumerate(candidate.parts):
            for name, theta in _theta(part).items():
                # 1 %, or a quarter of the distance in its grid: of a short period, whose grid is fine, 1 %
                # would be a whole cycle after a hundred.
                change = min(0.01, abs(part.effect.moved(name, 0.25, span) / theta - 1.0))
                values = theta * (1.0 - change), theta * (1.0 + change)
                moved = [part.effect.model_copy(update={name: value}) for value in values]
                models = [[candidate.with_effect(at, effect)] for effect in moved]
                below, above = (channel.training.effect_columns(one) @ of_candidate for one in models)
                slopes.append((above - below) / (2.0 * change))
    return np.column_stack(slopes)
