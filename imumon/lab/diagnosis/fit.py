"""Fit an extended model: coefficients, their sigma, what is left in training, and the score on the test."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.effects.base import Effect
from imumon.lab.diagnosis.blocks import RunBlocks
from imumon.lab.diagnosis.candidates import Candidate, Channel, Part, least_squares
from imumon.lab.diagnosis.likelihood import Likelihood

CARRY_SPREAD = 0.35
"""Own coefficients carry over when none is further from their mean than this share of it."""
LEAST_TEST_BLOCKS = 10
"""Of fewer there is no rms."""
LEAST_LEVEL_BLOCKS = 4
"""Of fewer the mean takes too much of their own noise away."""
CHANGE = 0.01
"""Share by which a parameter is changed for the slope of the model in it."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedPart:
    """An effect of a fitted model."""

    effect: Effect
    """With the coefficients that carry over."""
    runs: tuple[int, ...]
    """The runs that have coefficients of their own; empty where they are shared."""
    own: FloatArray
    """Coefficients, (runs, k); one row where they are shared."""
    start: FloatArray
    """Of `Effect.start_columns`, (runs, m); empty when the start is not free."""

    @property
    def carries(self) -> bool:
        """Whether it carries over to another run: its coefficients are shared, or as good as."""
        mean = self.own.mean(axis=0)
        spread = float(np.linalg.norm(self.own - mean, axis=1).max())
        alike = self.effect.scope == "either" and spread <= CARRY_SPREAD * float(np.linalg.norm(mean))
        return not self.runs or alike


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """An extended model fitted by ordinary least squares."""

    declared: FloatArray
    """Coefficients of the declared model, (degree + 1,); the constant is the one to predict with."""
    parts: list[FittedPart]
    train: FloatArray
    """Residual in training, (n,)."""
    lifted: float = 0.0
    """Part of the constant: the mean of the effects that do not carry over, such as jumps."""

    @property
    def train_rms(self) -> float:
        """rms of the residual in training."""
        return root_mean_square(self.train)

    @property
    def carries(self) -> bool:
        """Whether any effect carries over to another run."""
        return any(part.carries for part in self.parts)


def fit(channel: Channel, found: Sequence[Candidate]) -> Fit:
    """Fit the declared model and the candidates by ordinary least squares."""
    width, further = channel.base.shape[1], channel.degree + 1
    design = channel.design(found)
    coefficients = least_squares(design, channel.values)
    model = coefficients[:further].copy()
    model[0] += float(coefficients[further:width].sum()) / (width - further + 1)
    none = np.empty((0, 0))
    parts = [FittedPart(one, (), np.array([one.coefficients]), none) for one in channel.kept]
    lifted = 0.0
    for candidate, where, starts in _layout(channel, found):
        own, runs = coefficients[where], len(channel.pool.runs) if candidate.free_start else 0
        begun_at = coefficients[starts].reshape(len(candidate.parts), runs, -1 if runs else 0)
        for part, rows, start in zip(candidate.parts, _by_part(candidate, own), begun_at, strict=True):
            effect = part.effect.with_coefficients(rows.mean(axis=0))
            parts.append(FittedPart(effect, part.runs, rows, start))
        if not parts[-1].carries:
            lifted += float((design[:, where] @ own).mean())
    model[0] += lifted
    return Fit(model, parts, channel.values - design @ coefficients, lifted)


def _layout(channel: Channel, model: Sequence[Candidate]) -> Iterator[tuple[Candidate, slice, slice]]:
    """Yield each candidate with the columns of the design that define it, and those of its free start."""
    at = channel.base.shape[1]
    for one in model:
        defining, start = map(len, channel.pool.terms(one))
        yield one, slice(at, at + defining), slice(at + defining, at + defining + start)
        at += defining + start


def _by_part(candidate: Candidate, values: FloatArray) -> list[FloatArray]:
    """Return values of all defining columns of a candidate for each of its parts, (runs or 1, k)."""
    sizes = [part.effect.width * max(1, len(part.runs)) for part in candidate.parts]
    rows = np.split(values, np.cumsum(sizes)[:-1])
    return [row.reshape(-1, part.effect.width) for part, row in zip(candidate.parts, rows, strict=True)]


# The test


@dataclass(slots=True, eq=False)
class TestScore:
    """How a model does on runs that it was not fitted to; NaN without a test."""

    __test__ = False

    rms: float
    """Predicted: no gyro of the test is used."""
    estimated_rms: float
    """With what does not carry over estimated in the test itself."""
    coverage: float
    """Share of the blocks inside the trained temperatures."""
    scored: float
    """Share of those that count: after the state at power-on is forgotten."""
    residual: list[FloatArray]
    estimated: list[FloatArray]
    counted: list[BoolArray]
    """What is left, predicted and estimated, and which blocks count, of each run."""

    @property
    def left(self) -> float:
        """What is left: predicted, or with what does not carry over estimated."""
        return float(np.fmin(self.rms, self.estimated_rms))


def score_test(channel: Channel, model: Fit, like: Fit | None = None) -> TestScore:
    """Return how a fitted model does on the test runs, within the trained temperatures.

    Blocks count after the state at power-on is forgotten, of the model `like` where one is given: the same
    for the models that are compared.
    """
    trained, left, estimated, counted, inside = channel.temperature, [], [], [], 0
    for run in channel.test:
        t = run.temperature[channel.pool.temperature]
        use = (t >= trained.min()) & (t <= trained.max())
        inside += int(use.sum())
        for part in (like or model).parts:
            settled = part.effect.settled(run.drives[channel.pool.temperature])
            use &= run.average(settled.astype(np.float64)) > 0.99
        residual = run.mean[channel.name] - _predicted(channel, run, model)
        if channel.own:
            residual, use = _without_levels(residual, use, channel.levels(run))
        left.append(residual)
        estimated.append(residual - _estimated(channel, run, model, residual, use))
        counted.append(use)
    coverage = inside / sum(map(len, counted)) if channel.test else np.nan
    scored = sum(int(part.sum()) for part in counted) / max(inside, 1) if channel.test else np.nan
    rms, estimated_rms = _rms_of(left, counted), _rms_of(estimated, counted)
    return TestScore(rms, estimated_rms, coverage, scored, left, estimated, counted)


def root_mean_square(values: FloatArray) -> float:
    """Return the rms of values; NaN without any."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _rms_of(parts: Sequence[FloatArray], counted: Sequence[BoolArray]) -> float:
    """Return the rms over the blocks that count; NaN when they are too few."""
    values = np.concatenate([np.empty(0), *(part[use] for part, use in zip(parts, counted, strict=True))])
    return root_mean_square(values) if len(values) >= LEAST_TEST_BLOCKS else float("nan")


def goes_on(channel: Channel, model: Fit) -> bool:
    """Return whether the test goes on from a training run that has coefficients of its own."""
    return any(_begun(channel, run) in part.runs for part in model.parts for run in channel.test)


def _begun(channel: Channel, run: RunBlocks) -> int | None:
    """Return the training run that a run goes on from; None where it begins with a power-on of its own."""
    names = [other.name for other in channel.pool.runs]
    return names.index(run.run.begun_in) if run.run.begun_in in names else None


def _without_levels(residual: FloatArray, use: BoolArray, levels: IntArray) -> tuple[FloatArray, BoolArray]:
    """Return a residual less the mean of each level, and which blocks count: of levels with enough."""
    each = levels[:, np.newaxis] == np.unique(levels)
    count = each[use].sum(axis=0)
    mean = residual[use] @ each[use] / np.maximum(count, 1)
    return residual - each @ mean, use & (each @ (count >= LEAST_LEVEL_BLOCKS))


def _predicted(channel: Channel, run: RunBlocks, model: Fit) -> FloatArray:
    """Return the bias that a fitted model predicts of a run, (n,)."""
    temperature = run.temperature[channel.pool.temperature]
    expected = channel.powers(temperature, len(model.declared)) @ model.declared
    drive, which = run.drives[channel.pool.temperature], _begun(channel, run)
    for part in model.parts:
        if part.carries:
            expected = expected + run.average(part.effect.simulate(drive))
        elif which in part.runs:
            expected = expected + run.average(part.effect.columns(drive)) @ part.own[part.runs.index(which)]
    return np.asarray(expected if which is None else expected - model.lifted)


def _estimated(channel: Channel, run: RunBlocks, model: Fit, left: FloatArray, use: BoolArray) -> FloatArray:
    """Return the least-squares estimate, from the blocks that count, of what does not carry over, (n,).

    That is a level, the coefficients that are each run's own, and one jump where the model has jumps.  What
    the training run has that this one goes on from is predicted.
    """
    which = _begun(channel, run)
    own = [part.effect for part in model.parts if not part.carries and which not in part.runs]
    if not own or int(use.sum()) < LEAST_TEST_BLOCKS:
        return np.zeros(len(run))
    drive = run.drives[channel.pool.temperature]
    further = [run.average(one.columns(drive)) for one in own if one.scope == "either"]
    levels = channel.levels(run)
    columns = np.column_stack([levels[:, np.newaxis] == np.unique(levels[use]), *further]).astype(float)
    if any(one.scope == "event" for one in own):
        first = np.flatnonzero(use)[_jump_at(columns[use], left[use])]
        columns = np.column_stack([columns, np.arange(len(run)) >= first])
    return np.asarray(columns @ least_squares(columns[use], left[use]))


def _jump_at(columns: FloatArray, residual: FloatArray) -> int:
    """Return the index from which a jump beside the columns leaves least of a residual."""
    basis = np.linalg.qr(columns)[0]
    left = residual - basis @ (basis.T @ residual)
    size = np.cumsum(left[::-1])[::-1]
    norm = np.arange(len(left), 0, -1) - (np.cumsum(basis[::-1], axis=0)[::-1] ** 2).sum(axis=1)
    taken = (size**2 / np.maximum(norm, 1e-9))[LEAST_LEVEL_BLOCKS : -LEAST_LEVEL_BLOCKS + 1]
    return LEAST_LEVEL_BLOCKS + int(np.argmax(taken))


# How well the parameters are known


class PartSigma(NamedTuple):
    """Standard deviations of a part of a model."""

    coefficients: FloatArray
    """One row where they are shared, (runs, k)."""
    searched: dict[str, float]
    """Of each nonlinear parameter, in its unit."""


def sigmas(
    channel: Channel, likelihood: Likelihood, model: Sequence[Candidate]
) -> tuple[FloatArray, list[list[PartSigma]]]:
    """Return the covariance of the declared model, (degree + 1, degree + 1), and the standard deviations of
    each candidate's parts, with the noise that the model is likeliest with.

    What is searched (time constants, widths) is where the likelihood is largest, what is linear is ordinary
    least squares beside it.  Both are linear in the noise near the truth, so one covariance of the noise
    gives all errors, those that the linear ones take over from the searched ones among them.
    """
    design = channel.design(model)
    slopes = _slopes(channel, model, least_squares(design, channel.values))
    whiten, _ = likelihood.white(np.eye(len(design)), likelihood.best(channel.values, design)[1])
    both, left = whiten @ np.column_stack([design, slopes]), whiten @ channel.values
    searching = np.linalg.pinv(both, rcond=1e-10)
    freedom = max(len(left) - both.shape[1], 1)
    sd = float(np.sqrt(np.sum((left - both @ (searching @ left)) ** 2) / freedom))
    # The error of each parameter as weights on whitened noise.
    logarithms = searching[design.shape[1] :]
    least = np.linalg.pinv(design, rcond=1e-10)
    linear = sd * (np.linalg.solve(whiten.T, least.T).T - (least @ slopes) @ logarithms)
    share, spread = sd * np.linalg.norm(logarithms, axis=1), np.linalg.norm(linear, axis=1)
    relative, parts = iter(share.tolist()), []
    for one, where, _ in _layout(channel, model):
        found = []
        for part, rows in zip(one.parts, _by_part(one, spread[where]), strict=True):
            found.append(PartSigma(rows, {name: next(relative) * at for name, at in _searched(part).items()}))
        parts.append(found)
    declared = linear[: channel.degree + 1]
    return declared @ declared.T, parts


def _searched(part: Part) -> dict[str, float]:
    """Return the nonlinear parameters of a part that are not zero."""
    found = {name: float(getattr(part.effect, name)) for name in part.effect.nonlinear}
    return {name: value for name, value in found.items() if value > 0.0}


def _slopes(channel: Channel, model: Sequence[Candidate], coefficients: FloatArray) -> FloatArray:
    """Return how the model changes with the logarithm of each searched parameter, (n, p)."""
    slopes = [np.empty((len(channel.values), 0))]
    for one, where, starts in _layout(channel, model):
        own = coefficients[where.start : starts.stop]
        for at, part in enumerate(one.parts):
            for name, value in _searched(part).items():
                ends = []
                for factor in (1.0 - CHANGE, 1.0 + CHANGE):
                    changed = Part(part.effect.model_copy(update={name: value * factor}), part.runs)
                    ends.append(channel.pool.design([one.with_part(at, changed)]) @ own)
                slopes.append(np.diff(np.column_stack(ends)) / (2.0 * CHANGE))
    return np.column_stack(slopes)
