"""Coefficients of an extended model, what it leaves of the training data, and how it does on the test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BoolArray, RunBlocks
from imumon.diagnosis.candidates import Candidate, Part, Pool
from imumon.diagnosis.selection import ordinary
from imumon.diagnosis.tracking import track
from imumon.effects.base import Effect
from imumon.effects.library import EFFECTS

CARRY_SPREAD = 0.35
"""Own coefficients carry over when none is further from their mean than this share of it."""
LEAST_TEST_BLOCKS = 10


@dataclass(frozen=True, slots=True, eq=False)
class Declared:
    """The declared model: columns at blocks of a run, and what it subtracts beforehand.

    Parameters
    ----------
    degree : int
    middle_degc, half_span_degc : float
    offsets : bool
        Whether each run has a constant of its own.
    """

    degree: int
    middle_degc: float
    half_span_degc: float
    offsets: bool = False

    def columns(self, temperature: FloatArray) -> FloatArray:
        """Return 1, u, ... u^degree, (n, degree + 1)."""
        u = (temperature - self.middle_degc) / self.half_span_degc
        return np.asarray(u[:, np.newaxis] ** np.arange(self.degree + 1))

    def training(self, runs: Sequence[RunBlocks], temperature: str) -> FloatArray:
        """Return the columns over all training runs, with a constant for each further run where declared."""
        parts = [self.columns(run.temperature[temperature]) for run in runs]
        stacked = np.concatenate(parts)
        if not self.offsets:
            return stacked
        extra = np.zeros((len(stacked), len(runs) - 1))
        first = np.cumsum([len(part) for part in parts])
        for at in range(len(runs) - 1):
            extra[first[at] : first[at + 1], at] = 1.0
        return np.column_stack([stacked, extra])


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """An extended model fitted by ordinary least squares.

    Parameters
    ----------
    declared : array of shape (degree + 1,)
        Coefficients of the declared model; the constant is the one to predict with.
    parts : list of FittedPart
    train : array of shape (n,)
        Residual in training.
    lifted : float
        How much of the constant is the mean of jumps and the like, which a new run begins without.
    """

    declared: FloatArray
    parts: list[FittedPart]
    train: FloatArray
    lifted: float = 0.0

    @property
    def train_rms(self) -> float:
        """rms of the residual in training."""
        return float(np.sqrt(np.mean(self.train**2)))


@dataclass(frozen=True, slots=True, eq=False)
class FittedPart:
    """A part with its coefficients: what carries over, and what each run had."""

    effect: Effect
    runs: tuple[int, ...]
    own: FloatArray
    """(runs, k); one row when shared."""
    start: FloatArray
    """(runs, m); no rows when the start is not free."""
    carries: bool


def fit(
    runs: Sequence[RunBlocks],
    temperature: str,
    values: FloatArray,
    declared: Declared,
    found: Sequence[Candidate],
    pool: Pool,
) -> Fit:
    """Fit the declared model and the candidates by ordinary least squares."""
    base = declared.training(runs, temperature)
    terms = [pool.terms(candidate) for candidate in found]
    blocks = [base, *(pool.matrix([*defining, *start]) for defining, start in terms)]
    design = np.column_stack(blocks)
    coefficients = ordinary(design, values)
    at = base.shape[1]
    parts: list[FittedPart] = []
    offset, lifted = 0.0, 0.0
    for candidate, (defining, start) in zip(found, terms, strict=True):
        chunk = coefficients[at : at + len(defining) + len(start)]
        fitted = _parts(candidate, pool, len(runs), chunk)
        columns = design[:, at : at + len(defining)]
        if not any(part.carries for part in fitted):
            mean = float((columns @ chunk[: len(defining)]).mean())
            offset += mean
            lifted += mean if EFFECTS[candidate.family].scope != "run" else 0.0
        parts += fitted
        at += len(chunk)
    model = coefficients[: declared.degree + 1].copy()
    if declared.offsets and len(runs) > 1:
        extra = coefficients[declared.degree + 1 : base.shape[1]]
        model[0] += float(extra.sum()) / len(runs)
    model[0] += offset
    return Fit(model, parts, values - design @ coefficients, lifted)


def _parts(candidate: Candidate, pool: Pool, runs: int, chunk: FloatArray) -> list[FittedPart]:
    """Return the parts of a candidate with their coefficients, which are in the order of its terms."""
    found: list[FittedPart] = []
    defining, starts = 0, len(pool.terms(candidate)[0])
    for part in candidate.parts:
        alone = Candidate(candidate.family, (part,), candidate.free_start)
        own_terms, start_terms = pool.terms(alone)
        own = chunk[defining : defining + len(own_terms)].reshape(max(1, len(part.runs)), -1)
        start = (
            chunk[starts : starts + len(start_terms)].reshape(runs, -1) if start_terms else np.empty((0, 0))
        )
        defining, starts = defining + len(own_terms), starts + len(start_terms)
        mean, carries = _carried(part, own)
        found.append(FittedPart(part.effect.with_coefficients(mean), part.runs, own, start, carries))
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
    """How a model does on runs that it has not seen.

    Parameters
    ----------
    rms : float
        Predicted: no gyro of the test is used.
    tracked_rms : float
        With what was seen before in the test itself.
    coverage : float
        Share of the blocks inside the trained temperatures.
    scored : float
        Share of those that count: after the state at power-on is forgotten.
    residual, tracked : list of array
        Of each run, at every block.
    """

    __test__ = False

    rms: float
    tracked_rms: float
    coverage: float
    scored: float
    jumps: int
    residual: list[FloatArray]
    tracked: list[FloatArray]
    counted: list[BoolArray]
    quiet: list[BoolArray]
    """Those that count and are not too near a jump."""


def score(
    runs: Sequence[RunBlocks],
    channel: str,
    temperature: str,
    declared: Declared,
    model: Fit,
    inside: tuple[float, float],
    mask: Sequence[BoolArray] | None = None,
) -> TestScore:
    """Return how the fitted model does on test runs, within the trained temperatures `inside`.

    `mask` says which blocks count beside those: the same for the models that are compared.
    """
    left, followed, counted, covered, quiet, jumps = [], [], [], [], [], 0
    for at, run in enumerate(runs):
        t = run.temperature[temperature]
        covered.append((t >= inside[0]) & (t <= inside[1]))
        residual = run.mean[channel] - predicted(run, temperature, declared, model)
        use = covered[-1] & settled(run, temperature, model) if mask is None else covered[-1] & mask[at]
        if declared.offsets and use.any():
            residual = residual - residual[use].mean()
        result = _followed(run, temperature, residual, model)
        left.append(residual)
        followed.append(residual - result[0])
        quiet.append(use & ~result[1])
        counted.append(use)
        jumps += result[2]
    total = sum(map(len, covered))
    inside_count = sum(int(part.sum()) for part in covered)
    return TestScore(
        rms=mean_rms(left, counted),
        tracked_rms=mean_rms(followed, quiet),
        coverage=inside_count / total if total else 0.0,
        scored=sum(int(part.sum()) for part in counted) / inside_count if inside_count else 0.0,
        jumps=jumps,
        residual=left,
        tracked=followed,
        counted=counted,
        quiet=quiet,
    )


def mean_rms(parts: Sequence[FloatArray], counted: Sequence[BoolArray]) -> float:
    """Return the rms over the blocks that count; NaN when they are too few."""
    values = np.concatenate([part[use] for part, use in zip(parts, counted, strict=True)])
    return float(np.sqrt(np.mean(values**2))) if len(values) >= LEAST_TEST_BLOCKS else float("nan")


def predicted(run: RunBlocks, temperature: str, declared: Declared, model: Fit) -> FloatArray:
    """Return the bias that a fitted model foretells of a run, (n,)."""
    expected = declared.columns(run.temperature[temperature]) @ model.declared
    drive = run.drives[temperature]
    for part in model.parts:
        if part.carries:
            expected = expected + run.average(part.effect.simulate(drive)[:, np.newaxis])[:, 0]
    return np.asarray(expected)


def settled(run: RunBlocks, temperature: str, model: Fit) -> BoolArray:
    """Tell at which blocks of a run no state at power-on matters any more, (n,)."""
    drive = run.drives[temperature]
    found = np.ones(len(run), bool)
    for part in model.parts:
        found &= run.average(part.effect.settled(drive).astype(np.float64)[:, np.newaxis])[:, 0] > 0.99
    return found


def _followed(
    run: RunBlocks, temperature: str, residual: FloatArray, model: Fit
) -> tuple[FloatArray, BoolArray, int]:
    """Return what the past of the test says of its residual, which blocks are near a jump, and how many
    jumps."""
    drive = run.drives[temperature]
    columns, mean, sd = [np.ones((len(run), 1))], [np.array([-model.lifted])], [np.zeros(1)]
    jumps = False
    for part in model.parts:
        if part.effect.scope == "event":
            jumps = True
        elif part.effect.scope == "run":
            # The size of a turn-on offset is known from few: allow for twice what was seen.
            sd[0] = np.hypot(sd[0], 2.0 * np.sqrt(np.mean(part.own**2)))
        elif part.runs:
            columns.append(run.average(part.effect.columns(drive)))
            carried = np.array(part.effect.coefficients)
            mean.append(np.zeros(len(carried)))
            sd.append(np.full(len(carried), 2.0 * np.sqrt(np.mean((part.own - carried) ** 2))))
        if len(part.start):
            columns.append(run.average(part.effect.start_columns(drive)))
            mean.append(np.zeros(part.start.shape[1]))
            sd.append(2.0 * np.sqrt(np.mean(part.start**2, axis=0)))
    noise = model.train_rms * np.sqrt(run.white)
    if not jumps and not np.concatenate([*mean, *sd]).any():
        return np.zeros(len(run)), np.zeros(len(run), bool), 0
    result = track(
        run.time_s,
        residual,
        np.column_stack(columns),
        np.concatenate(mean),
        np.concatenate(sd),
        noise,
        jumps,
    )
    return result.expected, result.grace, result.jumps
