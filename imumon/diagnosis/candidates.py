"""What may be added to the declared model: effects with the scope of their coefficients, and their
columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.effects.base import Drive, Effect, Survey
from imumon.effects.follower import may_sum
from imumon.effects.library import EFFECTS

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
    """One or more parts of the same family, and whether the state at power-on of each run is free."""

    family: str
    parts: tuple[Part, ...]
    free_start: bool = False

    @property
    def nonlinear(self) -> int:
        """Number of nonlinear parameters."""
        return sum(len(part.effect.nonlinear) for part in self.parts)


def candidates(survey: Survey, families: Iterable[str] = tuple(EFFECTS)) -> list[Candidate]:
    """Return everything worth trying on such runs."""
    every = tuple(range(survey.runs))
    found: list[Candidate] = []
    for name in families:
        family = EFFECTS[name]
        grid = family.grid(survey)
        single = [Part(effect) for effect in grid]
        if family.scope == "event":
            found += [
                Candidate(name, (Part(effect, (run,)),))
                for run, duration_s in enumerate(survey.durations_s)
                for effect in grid
                if effect.fits_in(duration_s, survey)
            ]
            continue
        if family.scope == "run":
            found += [Candidate(name, (Part(effect, every[1:]),)) for effect in grid]
            continue
        found += [Candidate(name, (part,)) for part in single]
        if family.free_start != "never":
            found += [Candidate(name, (part,), free_start=True) for part in single]
        if family.scope == "either" and survey.runs > 1:
            found += [Candidate(name, (Part(effect, every),)) for effect in grid]
        starts = (False, True) if family.free_start == "in sums" else (False,)
        groups = family.sums(grid) if may_sum(survey, 2) else []
        found += [Candidate(name, tuple(map(Part, group)), start) for group in groups for start in starts]
    return found


@dataclass(slots=True)
class Pool:
    """Raw columns of effects as block means, made once for each effect and run.

    Parameters
    ----------
    runs : sequence of RunBlocks
    temperature : str
        Which temperature drives the effects; any name where there is none.
    """

    runs: Sequence[RunBlocks]
    temperature: str
    _columns: list[list[FloatArray]] = field(default_factory=list)
    _known: dict[tuple[int, str], tuple[Effect, list[int]]] = field(default_factory=dict)

    def terms(self, candidate: Candidate) -> tuple[list[Term], list[Term]]:
        """Return the terms that define a candidate, and those of its free start."""
        defining: list[Term] = []
        start: list[Term] = []
        for part in candidate.parts:
            scopes = part.runs or (SHARED,)
            defining += [
                (column, scope) for scope in scopes for column in self._index(part.effect, "columns")
            ]
            if candidate.free_start:
                columns = self._index(part.effect, "start_columns")
                start += [(column, run) for run in range(len(self.runs)) for column in columns]
        return defining, start

    def matrix(self, terms: Sequence[Term]) -> FloatArray:
        """Return the columns of terms over all runs, (n, k)."""
        offsets = np.concatenate([[0], np.cumsum([len(run) for run in self.runs])])
        out = np.zeros((int(offsets[-1]), len(terms)))
        for at, (column, scope) in enumerate(terms):
            for run in range(len(self.runs)) if scope == SHARED else (scope,):
                out[offsets[run] : offsets[run + 1], at] = self._columns[column][run]
        return out

    def raw(self, columns: Sequence[int], run: int) -> FloatArray:
        """Return these columns in one run, (n, k)."""
        if not columns:
            return np.empty((len(self.runs[run]), 0))
        return np.column_stack([self._columns[column][run] for column in columns])

    def _index(self, effect: Effect, what: str) -> list[int]:
        key = (id(effect), what)  # the effect is kept beside it, so that no other can have its id
        if key not in self._known:
            parts = [run.average(getattr(effect, what)(drive_of(run, self.temperature))) for run in self.runs]
            first = len(self._columns)
            width = parts[0].shape[1]
            self._columns += [[part[:, i] for part in parts] for i in range(width)]
            self._known[key] = effect, list(range(first, first + width))
        return self._known[key][1]


def drive_of(run: RunBlocks, temperature: str) -> Drive:
    """Return what drives the effects of a channel."""
    return run.drives[temperature]


def declared_columns(u: FloatArray, degree: int) -> FloatArray:
    """Return 1, u, ... u^degree, (n, degree + 1)."""
    return np.asarray(u[:, np.newaxis] ** np.arange(degree + 1))
