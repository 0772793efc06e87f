"""What may be added to the declared model: effects, the scope of their coefficients, their columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import Effect, Survey
from imumon.effects.follower import may_sum
from imumon.effects.library import EFFECTS
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.lab.diagnosis.blocks import RunBlocks

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
    """One or more parts of the same family, and whether the state at power-on of each run is free.

    The family is the label of its effects.  `choice` is the price in BIC for having been chosen among what
    other drivers there are (extended BIC, gamma = 1: Chen & Chen 2008, doi:10.1093/biomet/asn034).
    """

    family: str
    parts: tuple[Part, ...]
    free_start: bool = False
    choice: float = 0.0

    @property
    def nonlinear(self) -> int:
        """Number of nonlinear parameters."""
        return sum(len(part.effect.nonlinear) for part in self.parts)

    @property
    def scope(self) -> str:
        """Whose its coefficients are by nature, see `imumon.effects.base.Scope`."""
        return self.parts[0].effect.scope

    @property
    def is_plain(self) -> bool:
        """Whether it is one part with no free start, of no other driver than the temperature."""
        return len(self.parts) == 1 and not (self.free_start or self.choice)

    @property
    def carries(self) -> bool:
        """Whether its coefficients are shared by all runs."""
        return not any(part.runs for part in self.parts)

    def neighbours(self, survey: Survey, level: int) -> list[Candidate]:
        """Return candidates with one parameter of one part changed, closer at each level."""
        start = self.parts[0].effect.free_start and level == 0 and len(self.parts) == 1
        other = [replace(self, free_start=not self.free_start)] if start else []
        return other + [
            replace(self, parts=(*self.parts[:at], Part(effect, part.runs), *self.parts[at + 1 :]))
            for at, part in enumerate(self.parts)
            for effect in part.effect.refined(survey, level)
        ]


def candidates(survey: Survey, families: Iterable[str] = tuple(EFFECTS)) -> list[Candidate]:
    """Return everything worth trying on such runs."""
    every = tuple(range(survey.runs))
    found: list[Candidate] = []
    for name in families:
        family = EFFECTS[name]
        grid = family.grid(survey)
        if family.scope == "event":
            found += [
                Candidate(name, (Part(effect, (run,)),))
                for run, duration_s in enumerate(survey.durations_s)
                for effect in grid
                if effect.fits_in(duration_s, survey)
            ]
        elif family.scope == "run":
            found += [Candidate(name, (Part(effect, every[1:]),)) for effect in grid]
        else:
            single = [(Part(effect),) for effect in grid]
            found += [Candidate(part[0].effect.label, part) for part in single]
            price = 2.0 * float(np.log(survey.choices))
            found += [
                Candidate(effect.label, (Part(effect),), choice=price)
                for driver in survey.others
                for effect in family.driven(survey, driver)
            ]
            found += [Candidate(name, _late_curve(one, survey)) for one in family.of_curve(survey)]
            if family.free_start:
                found += [Candidate(name, part, free_start=True) for part in single]
            if family.scope == "either" and survey.runs > 1:
                found += [Candidate(name, (Part(effect, every),)) for effect in grid]
            groups = family.sums(grid) if may_sum(survey, 2) else []
            found += [Candidate(name, tuple(map(Part, group))) for group in groups]
    return found


def _late_curve(late: Effect, survey: Survey) -> tuple[Part, ...]:
    """Return a curve that is itself late: its powers less those of the late temperature, and the powers that
    the declared curve has not."""
    more = late.width - survey.degree
    if more <= 0:
        return (Part(late),)
    middle, half_span = survey.middle_degc, survey.half_span_degc
    powers = TemperatureCurve(middle=middle, half_span=half_span, first_power=survey.degree + 1, powers=more)
    return Part(late), Part(powers)


@dataclass(slots=True)
class Pool:
    """Columns of effects as block means, made once for each effect and run."""

    runs: Sequence[RunBlocks]
    temperature: str
    """Which temperature drives the effects."""
    _columns: list[list[FloatArray]] = field(default_factory=list)
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
        number = {one: at for at, one in enumerate(dict.fromkeys(found))}
        return np.array([number[one] if one[0] >= 0 else -1 for one in found], np.int64)

    def matrix(self, terms: Sequence[Term]) -> FloatArray:
        """Return the columns of terms over all runs, (n, k): zero in runs that a term is not of."""
        offsets = np.cumsum([0, *map(len, self.runs)]).tolist()
        out = np.zeros((offsets[-1], len(terms)))
        for at, (column, scope) in enumerate(terms):
            for run in range(len(self.runs)) if scope == SHARED else (scope,):
                out[offsets[run] : offsets[run + 1], at] = self._columns[column][run]
        return out

    def design(self, found: Sequence[Candidate]) -> FloatArray:
        """Return all columns of candidates over all runs, (n, k)."""
        return self.matrix([term for one in found for terms in self.terms(one) for term in terms])

    def _index(self, effect: Effect, what: str) -> list[int]:
        key = (id(effect), what)  # the effect is kept beside it, so that no other can have its id
        if key not in self._known:
            parts = [run.average(getattr(effect, what)(run.drives[self.temperature])) for run in self.runs]
            first, width = len(self._columns), parts[0].shape[1]
            self._columns += [[part[:, i] for part in parts] for i in range(width)]
            self._spectra += [first if effect.one_sign and what == "columns" else -1] * width
            self._known[key] = effect, list(range(first, first + width))
        return self._known[key][1]
