"""A channel with its declared model, and what may be added to that: effects and their columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import Effect, Scale, Survey
from imumon.effects.library import EFFECTS
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.lab.diagnosis.blocks import RunBlocks, WhiteFloor
from imumon.lab.diagnosis.runs import unit_of

Own = Literal["", "run", "pose"]
"""Whether each run, or each pose of each run, has a constant of its own."""
SHARED = -1
"""Scope: one coefficient for all runs; a number from 0 on is the one run that has it."""

Term = tuple[int, int]
"""Column of a pool, and scope."""


@dataclass(frozen=True, slots=True)
class Part:
    """An effect with the scope of its coefficients: shared, or own to these runs."""

    effect: Effect
    runs: tuple[int, ...] = ()
    """Empty when the coefficients are shared by all runs."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One or more parts, and whether the state at power-on of each run is free.

    `choice` is the price in BIC for having been chosen among what other drivers there are (extended BIC,
    gamma = 1: Chen & Chen 2008, doi:10.1093/biomet/asn034).
    """

    parts: tuple[Part, ...]
    free_start: bool = False
    choice: float = 0.0

    @property
    def family(self) -> str:
        """Name of its effect."""
        return self.parts[0].effect.label

    @property
    def nonlinear(self) -> int:
        """Number of nonlinear parameters."""
        return sum(len(part.effect.nonlinear) for part in self.parts)

    @property
    def scope(self) -> str:
        """Whose its coefficients are by nature, see `imumon.effects.base.Scope`."""
        return self.parts[0].effect.scope

    @property
    def carries(self) -> bool:
        """Whether its coefficients are shared by all runs."""
        return not any(part.runs for part in self.parts)

    def neighbours(self, survey: Survey, level: int) -> list[Candidate]:
        """Return candidates with one parameter of one part changed, closer at each level."""
        start = self.parts[0].effect.free_start and level == 0 and len(self.parts) == 1
        other = [replace(self, free_start=not self.free_start)] if start else []
        return other + [
            self.with_part(at, Part(effect, part.runs))
            for at, part in enumerate(self.parts)
            for effect in part.effect.refined(survey, level)
        ]

    def with_part(self, at: int, part: Part) -> Candidate:
        """Return it with another part in the place of one."""
        return replace(self, parts=(*self.parts[:at], part, *self.parts[at + 1 :]))


def candidates(survey: Survey, families: Iterable[str] = tuple(EFFECTS)) -> list[Candidate]:
    """Return everything worth trying on such runs.

    By its scope an effect has coefficients that all runs share, is tried so and with those of each run
    ("either"), has them in each run but the first ("run": an offset), or in one alone ("event": a jump).
    """
    every, price = tuple(range(survey.runs)), 2.0 * float(np.log(survey.choices))
    found: list[Candidate] = []
    for family in (EFFECTS[name] for name in families):
        grid = family.grid(survey)
        if family.scope == "event":
            found += [
                Candidate((Part(effect, (run,)),))
                for run, duration_s in enumerate(survey.durations_s)
                for effect in grid
                if effect.fits_in(duration_s, survey)
            ]
            continue
        if family.scope == "run":
            found += [Candidate((Part(effect, every[1:]),)) for effect in grid]
            continue
        shared = [Candidate((Part(effect),)) for effect in grid]
        driven = [effect for driver in survey.others for effect in family.driven(survey, driver)]
        found += [*shared, *(Candidate((Part(effect),), choice=price) for effect in driven)]
        found += [Candidate(_late_curve(effect, survey)) for effect in family.of_curve(survey)]
        if family.free_start:
            found += [replace(one, free_start=True) for one in shared]
        if family.scope == "either" and survey.runs > 1:
            found += [Candidate((Part(effect, every),)) for effect in grid]
    return found


def _late_curve(late: Effect, survey: Survey) -> tuple[Part, ...]:
    """Return a curve that is itself late: powers less late powers, and those that are not declared."""
    more = late.width - survey.degree
    if more <= 0:
        return (Part(late),)
    middle, half_span = survey.middle_degc, survey.half_span_degc
    powers = TemperatureCurve(middle=middle, half_span=half_span, first_power=survey.degree + 1, powers=more)
    return Part(late), Part(powers)


class Scored(NamedTuple):
    """A candidate with its gain over the model so far.

    `fit` is the gain without the price of the nonlinear parameters and of the choice.  `partner` names the
    effect beside which it gains so much, where neither gains it alone.
    """

    candidate: Candidate
    gain: float
    fit: float
    partner: str = ""

    @property
    def family(self) -> str:
        """Name of its effect."""
        return self.candidate.family


Table = Mapping[str, Scored]
"""The best candidate of each family."""


@dataclass(slots=True, eq=False)
class Finding:
    """An effect that was chosen for a channel, or that the present model has.

    `gain` is that over the model before it, `pooled_gain` the same summed over the channels that show it, and
    `rivals` has the gain of every family at that stage.
    """

    candidate: Candidate
    """With refined parameters; coefficients come with the fit."""
    gain: float = 0.0
    pooled_gain: float = 0.0
    rivals: dict[str, float] = field(default_factory=dict)
    others: dict[str, Candidate] = field(default_factory=dict)
    """The best of each other family that is not told apart from it."""
    size: float = 0.0
    """rms of what it took away from training when it was found."""
    by_test: bool = False
    """Whether the test alone proves it."""
    known: bool = False
    """Whether it is of the present model, and fitted anew."""

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.family

    @property
    def alike(self) -> list[str]:
        """It and the families that are not told apart from it; empty when there is no other."""
        return [self.name, *self.others] if self.others else []


@dataclass(slots=True)
class Pool:
    """Columns of effects as block means, made once for each effect and run."""

    runs: Sequence[RunBlocks]
    temperature: str
    """Which temperature drives the effects."""
    _columns: list[FloatArray] = field(default_factory=list)
    _spectra: list[int] = field(default_factory=list)
    _known: dict[tuple[int, str], tuple[Effect, list[int]]] = field(default_factory=dict)

    def terms(self, candidate: Candidate) -> tuple[list[Term], list[Term]]:
        """Return the terms that define a candidate, and those of its free start."""
        defining, start = list[Term](), list[Term]()
        for part in candidate.parts:
            columns = self._index(part.effect, "columns")
            defining += [(column, scope) for scope in part.runs or (SHARED,) for column in columns]
            if candidate.free_start:
                columns = self._index(part.effect, "start_columns")
                start += [(column, run) for run in range(len(self.runs)) for column in columns]
        return defining, start

    def spectra(self, terms: Sequence[Term]) -> IntArray:
        """Return a number for each term, (k,): those of the same are of one sign; -1 where that is free."""
        found = [(self._spectra[column], scope) for column, scope in terms]
        of_each = len(self.runs) + 1
        return np.array([one * of_each + scope + 1 if one >= 0 else -1 for one, scope in found], np.int64)

    def matrix(self, terms: Sequence[Term]) -> FloatArray:
        """Return the columns of terms over all runs, (n, k): zero in runs that a term is not of."""
        which = np.repeat(np.arange(len(self.runs)), [*map(len, self.runs)])
        out = np.empty((len(which), len(terms)))
        for at, (column, scope) in enumerate(terms):
            out[:, at] = self._columns[column] * ((scope == SHARED) | (which == scope))
        return out

    def design(self, found: Sequence[Candidate]) -> FloatArray:
        """Return all columns of candidates over all runs, (n, k)."""
        return self.matrix([term for one in found for terms in self.terms(one) for term in terms])

    def _index(self, effect: Effect, what: str) -> list[int]:
        key = (id(effect), what)  # the effect is kept beside it, so that no other can have its id
        if key not in self._known:
            parts = [run.average(getattr(effect, what)(run.drives[self.temperature])) for run in self.runs]
            first, width = len(self._columns), parts[0].shape[1]
            self._columns += [*np.concatenate(parts).T]
            self._spectra += [first if effect.one_sign and what == "columns" else -1] * width
            self._known[key] = effect, list(range(first, first + width))
        return self._known[key][1]


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel over the runs that it is fitted to, and those that prove what was found.

    The declared model of its bias is a polynomial of u = (T - middle) / half span, and a constant of its own
    for each run, or each pose of each run, where `own` is set.
    """

    name: str
    floor: WhiteFloor
    """Of a block."""
    degree: int
    own: Own
    pool: Pool
    """Training runs, which temperature drives the channel, and the columns of effects over them."""
    test: Sequence[RunBlocks]
    faults: Mapping[str, float] = field(default_factory=dict)
    """What is wrong with its data, and the most that this alone makes of a smooth bias: a smaller effect
    cannot be found.  It is infinite where nothing that is fitted would be the bias."""
    known: tuple[Effect, ...] | None = None
    """Effects of the present model, whose curve is off the means already; None without one."""
    kept: tuple[Effect, ...] = ()
    """Those of them that stay as they are; a search begins with the others, and fits them anew."""

    @property
    def unit(self) -> str:
        """Unit of its bias."""
        return unit_of(self.name)

    @property
    def blind(self) -> float:
        """rms below which an effect may be a fault of the data."""
        return max(self.faults.values(), default=0.0)

    @property
    def limit(self) -> float:
        """rms that white noise and faults of the data together make of a block: no structure is below it."""
        return float(np.hypot(self.floor.sd, self.blind))

    @property
    def coarse(self) -> bool:
        """Whether faults of the data may make what matters of a smooth bias: an error of a floor."""
        return self.blind >= self.floor.sd

    @property
    def refitted(self) -> bool:
        """Whether the present model is fitted anew, its curve, or effects of it."""
        return self.known is not None and bool(self.degree or len(self.kept) < len(self.known))

    def as_given(self) -> Channel:
        """Return it with the present model as it is, where there is one, but for a constant."""
        return self if self.known is None else replace(self, degree=0, kept=self.known)

    @cached_property
    def temperature(self) -> FloatArray:
        """Temperature of each block over all training runs, °C, (n,)."""
        return np.concatenate([run.temperature[self.pool.temperature] for run in self.pool.runs])

    @cached_property
    def scale(self) -> Scale:
        """Middle and half of the span of the trained temperatures, °C."""
        low, high = float(self.temperature.min()), float(self.temperature.max())
        return Scale(0.5 * (low + high), max(0.5 * (high - low), 1e-3))

    def powers(self, temperature: FloatArray, count: int) -> FloatArray:
        """Return the first `count` of 1, u, u², ..., (n, count)."""
        u = (temperature - self.scale.middle) / self.scale.half_span
        return np.asarray(u[:, np.newaxis] ** np.arange(count))

    def levels(self, run: RunBlocks) -> IntArray:
        """Return which of the constants of a run each block has, (n,), from 0."""
        return run.pose if self.own == "pose" else np.zeros(len(run), np.int64)

    @cached_property
    def values(self) -> FloatArray:
        """Block means over all training runs less the effects that stay as they are, (n,)."""
        means = np.concatenate([run.mean[self.name] for run in self.pool.runs])
        for effect in self.kept:
            columns = self.pool.design([Candidate((Part(effect),))])
            means = means - columns @ np.asarray(effect.coefficients)
        return means

    @cached_property
    def base(self) -> FloatArray:
        """Columns of the declared model over all training runs, (n, p): powers of u, and a constant for each
        further run or pose that has one of its own."""
        runs, columns = self.pool.runs, self.powers(self.temperature, self.degree + 1)
        if not self.own:
            return columns
        which = [np.column_stack([np.full(len(run), at), self.levels(run)]) for at, run in enumerate(runs)]
        level = np.unique(np.concatenate(which), axis=0, return_inverse=True)[1].reshape(-1, 1)
        return np.column_stack([columns, level == np.arange(1, level.max() + 1)]).astype(np.float64)

    def design(self, found: Sequence[Candidate]) -> FloatArray:
        """Return the columns of the declared model and of what was found, (n, k)."""
        return np.column_stack([self.base, self.pool.design(found)])

    def residual_rms(self, found: Sequence[Candidate]) -> float:
        """Return the rms of what ordinary least squares leave beside what was found."""
        columns = self.design(found)
        left = self.values - columns @ least_squares(columns, self.values)
        return float(np.sqrt(np.mean(left**2)))


def least_squares(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Return the coefficients of ordinary least squares, the smallest where columns are collinear."""
    norm = np.linalg.norm(columns, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    return np.asarray(np.linalg.lstsq(columns / norm, values, rcond=1e-10)[0] / norm)
