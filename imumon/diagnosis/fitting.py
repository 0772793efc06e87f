"""Fit an extended model: coefficients, residual in training, and score on the test runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.candidates import Candidate, Part
from imumon.diagnosis.channel import Channel, ordinary
from imumon.diagnosis.tracking import Prior, track
from imumon.effects.base import Drive, Effect
from imumon.models.model import REACH

CARRY_SPREAD = 0.35
"""Own coefficients carry over when none is further from their mean than this share of it."""
LEAST_TEST_BLOCKS = 10
LEAST_LEVEL_BLOCKS = 4
"""Of fewer the mean takes too much of their own noise away."""
WIDER = 2.0
"""What differs from run to run is known from few: the prior allows for so many times what was seen."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedPart:
    """An effect with the coefficients that carry over, and with what each run had."""

    effect: Effect
    runs: tuple[int, ...]
    """Empty where the coefficients are shared."""
    own: FloatArray
    """One row where they are shared, (runs, k)."""
    start: FloatArray
    """Of `Effect.start_columns`, (runs, m); empty when the start is not free."""
    carries: bool
    """Whether anything carries over to another run."""

    def added(self, run: RunBlocks, drive: Drive, at: int) -> FloatArray:
        """Return what it adds to the training run of index `at`, (n,)."""
        total = np.zeros(len(run))
        if not self.runs or at in self.runs:
            row = self.runs.index(at) if self.runs else 0
            total += run.average(self.effect.columns(drive)) @ self.own[row]
        if len(self.start):
            total += run.average(self.effect.start_columns(drive)) @ self.start[at]
        return total


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """An extended model fitted by ordinary least squares."""

    declared: FloatArray
    """Coefficients of the declared model, or of the curve in its place, (degree + 1,); the constant is the
    one to predict with."""
    parts: list[FittedPart]
    train: FloatArray
    """Residual in training, (n,)."""
    lifted: float = 0.0
    """How much of the constant is the mean of jumps and the like, which a new run begins without."""

    @property
    def train_rms(self) -> float:
        """rms of the residual in training."""
        return float(np.sqrt(np.mean(self.train**2)))


def fit(channel: Channel, found: Sequence[Candidate]) -> Fit:
    """Fit the declared model and the candidates by ordinary least squares."""
    pool, runs, width = channel.pool, len(channel.train), channel.base.shape[1]
    further = channel.declared.degree + 1
    design = channel.design(found)
    coefficients = ordinary(design, channel.values)
    model = coefficients[:further].copy()
    model[0] += float(coefficients[further:width].sum()) / (width - further + 1)
    parts = [_as_it_is(effect) for effect in channel.kept]
    lifted, at = 0.0, width
    for candidate in found:
        defining, start = map(len, pool.terms(candidate))
        own, starts = np.split(coefficients[at : at + defining + start], [defining])
        if candidate.whole:
            own = -own  # the curve less how late it is
        fitted = _parts(candidate, own, starts, runs)
        if candidate.whole:
            curve = channel.declared.powers(fitted[0].effect.curve())
            model = np.pad(model, (0, max(0, fitted[0].effect.width + 1 - len(model))))
            model[: len(curve)] += curve
        if not any(part.carries for part in fitted):
            mean = float((design[:, at : at + defining] @ own).mean())
            model[0] += mean
            lifted += mean if candidate.scope != "run" else 0.0
        parts += fitted
        at += defining + start
    return Fit(model, parts, channel.values - design @ coefficients, lifted)


def fit_given(channel: Channel) -> Fit:
    """Fit what was assumed: the declared model, or to the model that was given a constant."""
    found = fit(channel.as_given(), [])
    missing = max(0, channel.declared.degree + 1 - len(found.declared))
    return replace(found, declared=np.pad(found.declared, (0, missing)))


def _as_it_is(effect: Effect) -> FittedPart:
    return FittedPart(effect, (), np.array([effect.coefficients]), np.empty((0, 0)), carries=True)


def _parts(candidate: Candidate, own: FloatArray, start: FloatArray, runs: int) -> list[FittedPart]:
    """Return the parts of a candidate with their coefficients, which are in the order of its terms."""
    found: list[FittedPart] = []
    count = len(candidate.parts)
    starts = start.reshape(count, runs, -1) if start.size else np.empty((count, 0, 0))
    at = 0
    for number, part in enumerate(candidate.parts):
        size = part.effect.width * max(1, len(part.runs))
        rows = own[at : at + size].reshape(-1, part.effect.width)
        mean, carries = _carried(part, rows)
        effect = part.effect.with_coefficients(mean)
        found.append(FittedPart(effect, part.runs, rows, starts[number], carries))
        at += size
    return found


def _carried(part: Part, own: FloatArray) -> tuple[FloatArray, bool]:
    """Return the coefficients for another run, and whether anything carries over."""
    if not part.runs:
        return own[0], True
    mean = own.mean(axis=0)
    spread = np.linalg.norm(own - mean, axis=1).max()
    if part.effect.scope == "either" and spread <= CARRY_SPREAD * np.linalg.norm(mean):
        return mean, True
    return np.zeros_like(mean), False


@dataclass(slots=True, eq=False)
class TestScore:
    """How a model does on runs that it has not seen."""

    __test__ = False

    rms: float
    """Predicted: no gyro of the test is used."""
    tracked_rms: float
    """With what was seen before in the test itself."""
    coverage: float
    """Share of the blocks inside the trained temperatures."""
    scored: float
    """Share of those that count: after the state at power-on is forgotten."""
    residual: list[FloatArray]
    tracked: list[FloatArray]
    """Of each run, at every block."""
    counted: list[BoolArray]
    quiet: list[BoolArray]
    """Blocks that count; those of them that are not too near a jump."""


def score(channel: Channel, model: Fit, like: Fit | None = None) -> TestScore:
    """Return how a fitted model does on the test runs, within the trained temperatures.

    Blocks count after the state at power-on is forgotten, of the model `like` where one is given: the same
    for the models that are compared.
    """
    trained = np.concatenate([run.temperature[channel.temperature] for run in channel.train])
    left, followed, counted, covered, quiet = [], [], [], [], []
    for run in channel.test:
        t = run.temperature[channel.temperature]
        inside_range = (t >= trained.min()) & (t <= trained.max())
        covered.append(inside_range & _within_drivers(channel, run, like or model))
        use = covered[-1] & _settled(channel, run, like or model)
        residual = run.mean[channel.name] - _predicted(channel, run, model)
        if channel.declared.own:
            residual, use = _without_levels(residual, use, channel.declared.levels(run))
        lifted = 0.0 if begun(channel, run) is not None else model.lifted
        expected, near = _followed(run, run.drives[channel.temperature], residual, model, lifted)
        left.append(residual)
        followed.append(residual - expected)
        counted.append(use)
        quiet.append(use & ~near)
    inside = sum(int(part.sum()) for part in covered)
    return TestScore(
        rms=mean_rms(left, counted),
        tracked_rms=mean_rms(followed, quiet),
        coverage=inside / max(sum(map(len, covered)), 1),
        scored=sum(int(part.sum()) for part in counted) / max(inside, 1),
        residual=left,
        tracked=followed,
        counted=counted,
        quiet=quiet,
    )


def _without_levels(residual: FloatArray, use: BoolArray, levels: IntArray) -> tuple[FloatArray, BoolArray]:
    """Return a residual less the mean of each level, and which blocks count: of levels with enough."""
    left, counted = residual.copy(), use.copy()
    for level in np.unique(levels):
        here = levels == level
        number = int((here & use).sum())
        left[here] -= residual[here & use].mean() if number else 0.0
        counted[here] &= number >= LEAST_LEVEL_BLOCKS
    return left, counted


def mean_rms(parts: Sequence[FloatArray], counted: Sequence[BoolArray]) -> float:
    """Return the rms over the blocks that count; NaN when they are too few."""
    values = np.concatenate([part[use] for part, use in zip(parts, counted, strict=True)])
    return float(np.sqrt(np.mean(values**2))) if len(values) >= LEAST_TEST_BLOCKS else float("nan")


def _predicted(channel: Channel, run: RunBlocks, model: Fit) -> FloatArray:
    """Return the bias that a fitted model predicts of a run, (n,)."""
    temperature = run.temperature[channel.temperature]
    expected = channel.declared.columns(temperature, len(model.declared)) @ model.declared
    drive, which = run.drives[channel.temperature], begun(channel, run)
    for part in model.parts:
        if part.carries:
            simulated = part.effect.simulate(drive)
            expected = expected + run.average(simulated[:, np.newaxis])[:, 0]
        elif part.effect.scope == "event" and which in part.runs:
            expected = expected + run.average(part.effect.columns(drive)) @ part.own[part.runs.index(which)]
    return np.asarray(expected if which is None else expected - model.lifted)


def goes_on(channel: Channel, model: Fit) -> bool:
    """Tell whether a jump of the training is still there in a run of the test."""
    goes_on_from = [begun(channel, run) for run in channel.test]
    return any(
        part.effect.scope == "event" and run in part.runs for part in model.parts for run in goes_on_from
    )


def begun(channel: Channel, run: RunBlocks) -> int | None:
    """Return the training run that a run goes on from; None where it begins with a power-on of its own."""
    names = [other.name for other in channel.train]
    return names.index(run.begun_in) if run.begun_in in names else None


def _within_drivers(channel: Channel, run: RunBlocks, model: Fit) -> BoolArray:
    """Tell at which blocks of a run every other driver is where training, or nearly, has shown it, (n,)."""
    drive, found = run.drives[channel.temperature], np.ones(len(run), bool)
    for effect in (part.effect for part in model.parts):
        for name in effect.inputs:
            scale = effect.scale_of(name)
            if scale is not None and name in drive.others:
                far = np.abs(run.average(drive.others[name][:, np.newaxis])[:, 0] - scale.middle)
                found &= far <= scale.half_span * (1.0 + 2.0 * REACH)
    return found


def _settled(channel: Channel, run: RunBlocks, model: Fit) -> BoolArray:
    """Tell at which blocks of a run no state at power-on matters any more, (n,)."""
    found = np.ones(len(run), bool)
    for part in model.parts:
        settled = part.effect.settled(run.drives[channel.temperature]).astype(np.float64)
        found &= run.average(settled[:, np.newaxis])[:, 0] > 0.99
    return found


def _followed(
    run: RunBlocks, drive: Drive, residual: FloatArray, model: Fit, lifted: float
) -> tuple[FloatArray, BoolArray]:
    """Return what the past of the test says of its residual, and which blocks are near a jump."""
    level_sd, jumps = 0.0, False
    priors: list[Prior] = []
    for part in model.parts:
        effect = part.effect
        jumps |= effect.scope == "event"
        if effect.scope == "run":
            level_sd = float(np.hypot(level_sd, WIDER * np.sqrt(np.mean(part.own**2))))
        elif part.runs and effect.scope != "event":
            spread = WIDER * float(np.sqrt(np.mean((part.own - effect.coefficients) ** 2)))
            columns = run.average(effect.columns(drive))
            priors.append(Prior(columns, np.zeros(effect.width), np.full(effect.width, spread)))
        if len(part.start):
            columns, start_sd = (
                run.average(effect.start_columns(drive)),
                np.sqrt(np.mean(part.start**2, axis=0)),
            )
            priors.append(Prior(columns, np.zeros(len(start_sd)), WIDER * start_sd))
    level = Prior(np.ones((len(run), 1)), np.array([-lifted]), np.array([level_sd]))
    prior = Prior.joined([level, *priors])
    if not jumps and not prior.mean.any() and not prior.sd.any():
        return np.zeros(len(run)), np.zeros(len(run), bool)
    return track(run.time_s, residual, prior, model.train_rms * np.sqrt(run.white), jumps)
