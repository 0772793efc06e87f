"""A channel with its declared model, X b of (1), and what may be added: candidates, and their columns of Z.

Coefficients are *shared* by all runs, or *separate* in each of some; `Effect.scope` states which may be::

    shared    shared
    either    tried as shared, and as separate in every run
    run       separate in every run but the first: an offset against the first
    event     separate in one run, tried in each: a jump

`imumon.effects.base` has what an effect provides, `Survey`, what runs can show, and `Drive`, what drives it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import DrivenEffect, Effect, Scale, Survey
from imumon.effects.library import EFFECTS
from imumon.effects.product import Product
from imumon.effects.temperature_curve import TemperatureCurve

from .blocks import RunInBlocks, RunsInBlocks, WhiteFloor

# What has a constant of the declared model: all runs one, each run one, or each pose of each run one.
OffsetPer = Literal["all", "run", "pose"]
ALL_RUNS = -1  # as the run of a term


class Term(NamedTuple):
    """One column of Z.

    Terms of one `spectrum`, a distribution over time constants, have coefficients of one sign: a candidate
    that generalised least squares give both signs explains nothing in a scan, and so is not found.
    """

    column: int  # index of a column that `Training` has made
    run: int  # number of the run outside of which it is zero, or `ALL_RUNS`
    spectrum: int = -1  # index of the first column of its effect, which names the spectrum; -1: of none


class Part(NamedTuple):
    """An effect with shared or separate coefficients."""

    effect: Effect
    separate_runs: tuple[int, ...] = ()  # numbers of the runs with separate coefficients; none: shared


class Candidate(NamedTuple):
    """What may be added at once: one part, or two that are shared; other pairs are scored, and not added."""

    parts: tuple[Part, ...]
    free_start: bool = False  # whether the state at each power-on is fitted, too
    choice_price: float = 0.0  # 2 ln(choices) of (3)

    @property
    def family(self) -> str:
        """Name of its first effect: kind and driver.  Candidates of one family differ in their parameters."""
        return self.parts[0].effect.label

    @property
    def n_nonlinear(self) -> int:
        """Number of nonlinear parameters theta, such as time constants."""
        return sum(len(part.effect.nonlinear) for part in self.parts)

    @property
    def scope(self) -> str:
        """Scope of its first effect, see the table above."""
        return self.parts[0].effect.scope

    @property
    def shared(self) -> bool:
        """Whether all its coefficients are shared by all runs."""
        return not any(part.separate_runs for part in self.parts)

    def neighbours(self, survey: Survey, level: int) -> "list[Candidate]":
        """Return candidates with one parameter of one part changed, closer at each level."""
        may_start = self.parts[0].effect.free_start and level == 0 and len(self.parts) == 1
        return ([self._replace(free_start=not self.free_start)] if may_start else []) + [
            self.with_effect(number, effect)
            for number, part in enumerate(self.parts)
            for effect in part.effect.refined(survey, level)
        ]

    def with_effect(self, number: int, effect: Effect) -> "Candidate":
        """Return it with another effect in one part."""
        part = self.parts[number]._replace(effect=effect)
        return self._replace(parts=(*self.parts[:number], part, *self.parts[number + 1 :]))


Candidates = Sequence[Candidate]  # as those of a model: what it has beside its base


def candidates(survey: Survey, kinds: Iterable[str]) -> list[Candidate]:
    """Return all candidates of these kinds that such runs can show, over their grids of theta."""
    of_a_driver = sum(issubclass(kind, (DrivenEffect, Product)) for kind in EFFECTS.values())
    price = 2.0 * np.log(max(1, len(survey.others)) * of_a_driver)
    every_run = tuple(range(survey.runs))
    made: list[Candidate] = []
    for kind in (EFFECTS[name] for name in kinds):
        grid = kind.grid(survey)
        if kind.scope == "event":
            for run, duration_s in enumerate(survey.durations_s):
                made += [Candidate((Part(one, (run,)),)) for one in grid if one.fits_in(duration_s, survey)]
        elif kind.scope == "run":
            made += [Candidate((Part(effect, every_run[1:]),)) for effect in grid]
        else:
            shared = [Candidate((Part(effect),)) for effect in grid]
            driven = [effect for driver in survey.others for effect in kind.driven(survey, driver)]
            made += [*shared, *(Candidate((Part(effect),), choice_price=price) for effect in driven)]
            made += [Candidate(_late_curve(effect, survey)) for effect in kind.of_curve(survey)]
            if kind.free_start:
                made += [candidate._replace(free_start=True) for candidate in shared]
            if kind.scope == "either" and survey.runs > 1:
                made += [Candidate((Part(effect, every_run),)) for effect in grid]
    return made


def _late_curve(late: Effect, survey: Survey) -> tuple[Part, ...]:
    """Return a curve that is itself late: each power less itself late, and the powers above the declared."""
    more = late.width - survey.degree
    if more <= 0:
        return (Part(late),)
    powers = TemperatureCurve(**survey.scale._asdict(), first_power=survey.degree + 1, powers=more)
    return Part(late), Part(powers)


class Scored(NamedTuple):
    """A candidate with its gain (4) over a model."""

    candidate: Candidate
    gain: float
    linear_gain: float  # the gain without the price of theta and of the choice
    partner: str = ""  # the family beside which it gains so much, where neither gains it alone


GainTable = Mapping[str, Scored]  # the candidate of each family that gains most


@dataclass(eq=False)
class Finding:
    """An effect that the search added to a channel, or that is `of_present_model`, with refined theta."""

    candidate: Candidate
    gain: float = 0.0  # over the model before it
    gain_over_axes: float = 0.0  # the same, summed over the axes that show it
    family_gains: dict[str, float] = field(default_factory=dict)  # of each family at that stage
    # The best candidates of other families that these data do not separate from it.
    alternatives: dict[str, Candidate] = field(default_factory=dict)
    removed_rms: float = 0.0  # what it took away from the training then, in the channel's unit
    partner: str = ""  # that of `Scored`
    by_test: bool = False  # only the test proves it
    of_present_model: bool = False

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.family

    @property
    def names(self) -> list[str]:
        """Its name, and those of the alternatives that are not told apart from it."""
        return [self.name, *self.alternatives]


@dataclass
class Training:
    """Training runs, and block means of the columns of effects of one temperature, made once for each."""

    runs: RunsInBlocks
    temperature_name: str
    _columns: list[FloatArray] = field(default_factory=list)
    _made: dict[tuple[int, str], tuple[Effect, range]] = field(default_factory=dict)

    def terms(self, candidate: Candidate) -> tuple[list[Term], list[Term]]:
        """Return the terms of a candidate's coefficients, and those of its free start."""
        effect_terms, start_terms = list[Term](), list[Term]()
        for part in candidate.parts:
            columns = self._indices(part.effect, "columns")
            runs = part.separate_runs or (ALL_RUNS,)
            spectrum = columns[0] if part.effect.one_sign else -1
            effect_terms += [Term(column, run, spectrum) for run in runs for column in columns]
            if candidate.free_start:
                columns = self._indices(part.effect, "start_columns")
                start_terms += [Term(column, run) for run in range(len(self.runs)) for column in columns]
        return effect_terms, start_terms

    @property
    def run_of_block(self) -> IntArray:
        """Number of the run of each training block, (n,)."""
        return np.repeat(np.arange(len(self.runs)), [*map(len, self.runs)])

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Return rows of the n training blocks by run."""
        return np.split(values, np.cumsum([*map(len, self.runs)])[:-1])

    def matrix(self, terms: Sequence[Term]) -> FloatArray:
        """Return the columns of terms over all n training blocks, (n, k)."""
        run_of_block = self.run_of_block
        rows = [
            self._columns[column] if run == ALL_RUNS else self._columns[column] * (run_of_block == run)
            for column, run, _ in terms
        ]
        # Reshaped for no terms: (0, n).
        return np.ascontiguousarray(np.reshape(rows, (len(terms), len(run_of_block))).T)

    def effect_columns(self, model: Candidates) -> FloatArray:
        """Return Z of (1) for the candidates of a model, (n, k): columns of each, then of its free start."""
        return self.matrix([term for candidate in model for terms in self.terms(candidate) for term in terms])

    def _indices(self, effect: Effect, method: str) -> range:
        """Return where the columns are that a method of an effect returns; they are made if need be."""
        # An effect has a list, and so no hash.  It is kept beside its columns, so that no other has its id.
        key = (id(effect), method)
        if key not in self._made:
            make, made = getattr(effect, method), len(self._columns)
            means = [run.average(make(run.drives[self.temperature_name])) for run in self.runs]
            self._columns += [*np.concatenate(means).T]
            self._made[key] = effect, range(made, len(self._columns))
        return self._made[key][1]


@dataclass(frozen=True, eq=False)
class Channel:
    """One axis of a sensor with its declared model, over training and test.

    The declared model is a polynomial of u = (T - middle) / half span, T in °C; `offset_per` has a constant.
    """

    name: str
    floor: WhiteFloor  # the white noise of a block mean
    degree: int
    offset_per: OffsetPer
    training: Training
    test: RunsInBlocks
    # What is wrong with its samples, and the rms that this alone makes of a smooth bias, below which no
    # effect can be found; infinite where nothing that is fitted would be the bias.
    faults: Mapping[str, float] = field(default_factory=dict)
    # Those of the present model, whose curve is off the means already; None without one.
    present_effects: tuple[Effect, ...] | None = None
    fixed_effects: tuple[Effect, ...] = ()  # those of them that stay as they are; others are fitted anew

    @property
    def fault_rms(self) -> float:
        """rms below which an effect may be a fault of the data."""
        return max(self.faults.values(), default=0.0)

    @property
    def faulty(self) -> bool:
        """Whether one value of its samples is far too frequent: nothing that is fitted would be the bias."""
        return self.fault_rms == np.inf

    @property
    def total_floor(self) -> float:
        """rms that white noise and faults together make of a block mean: no structure is below it."""
        return float(np.hypot(self.floor.sd, self.fault_rms))

    @property
    def coarse(self) -> bool:
        """Whether faults may make as much of a smooth bias as white noise does of a block mean."""
        return self.fault_rms >= self.floor.sd

    @property
    def refits_model(self) -> bool:
        """Whether anything of a present model is fitted anew: its curve, or some of its effects."""
        present = self.present_effects
        return present is not None and bool(self.degree or len(self.fixed_effects) < len(present))

    def with_model_fixed(self) -> "Channel":
        """Return it with the present model as it is but for a constant; without one, itself."""
        if self.present_effects is None:
            return self
        return replace(self, degree=0, fixed_effects=self.present_effects)

    @cached_property
    def temperature(self) -> FloatArray:
        """Temperature of each training block, °C, (n,)."""
        return np.concatenate([run.temperature[self.training.temperature_name] for run in self.training.runs])

    @cached_property
    def scale(self) -> Scale:
        """Middle and half span of the trained temperatures, °C."""
        low, high = float(self.temperature.min()), float(self.temperature.max())
        return Scale(0.5 * (low + high), max(0.5 * (high - low), 1e-3))

    def powers(self, temperature: FloatArray, count: int) -> FloatArray:
        """Return the first `count` of 1, u, u², ..., (n, count)."""
        u = (temperature - self.scale.middle) / self.scale.half_span
        return u[:, None] ** np.arange(count)

    def offset_numbers(self, run: RunInBlocks) -> IntArray:
        """Return which of the constants of a run each of its blocks has, (n,), from 0."""
        return run.pose if self.offset_per == "pose" else np.zeros(len(run), np.int64)

    @cached_property
    def offsets(self) -> tuple[IntArray, IntArray]:
        """Run and pose of each constant, (constants, 2), and which of them each training block has, (n,)."""
        numbers = np.concatenate([self.offset_numbers(run) for run in self.training.runs])
        pairs = np.column_stack([self.training.run_of_block, numbers])
        constants, which = np.unique(pairs, axis=0, return_inverse=True)
        return constants, which.reshape(-1)

    @cached_property
    def y(self) -> FloatArray:
        """y of (1), (n,): training block means less the effects that stay as they are."""
        means = np.concatenate([run.mean[self.name] for run in self.training.runs])
        for effect in self.fixed_effects:
            means = means - self.training.effect_columns([Candidate((Part(effect),))]) @ effect.coefficients
        return means

    @cached_property
    def base(self) -> FloatArray:
        """X of (1), (n, p): powers of u, and a column of 0 and 1 for each constant but the first."""
        columns = self.powers(self.temperature, self.degree + 1)
        if self.offset_per == "all":
            return columns
        constants, which = self.offsets
        return np.column_stack([columns, which[:, None] == np.arange(1, len(constants))]).astype(float)

    @property
    def offset_columns(self) -> slice:
        """Columns of X for the constants but the first; their coefficients are differences from that."""
        return slice(self.degree + 1, self.base.shape[1])

    def design(self, model: Candidates) -> FloatArray:
        """Return [X Z] of (1), (n, p + k)."""
        return np.column_stack([self.base, self.training.effect_columns(model)])

    def residual_rms(self, model: Candidates) -> float:
        """Return the rms that ordinary least squares leave of training with a model."""
        design = self.design(model)
        return root_mean_square(self.y - design @ least_squares(design, self.y))


def root_mean_square(values: FloatArray) -> float:
    """Return the rms of values; NaN without any."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else np.nan


def least_squares(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Return the coefficients of ordinary least squares, the smallest where columns are collinear."""
    norm = norms(columns)
    return np.linalg.lstsq(columns / norm, values, rcond=1e-10)[0] / norm


def pseudo_inverse(columns: FloatArray) -> FloatArray:
    """Return the matrix that gives these coefficients of values, (k, n); columns may have any unit."""
    norm = norms(columns)
    return np.linalg.pinv(columns / norm, rcond=1e-10) / norm[:, None]


def norms(columns: FloatArray) -> FloatArray:
    """Return the norm of each column, (k,), or 1 where that is 0."""
    norm = np.linalg.norm(columns, axis=0)
    return np.where(norm > 0, norm, 1.0)
