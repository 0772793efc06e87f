"""What may be added to the declared model: effects with the scope of their coefficients, and their
columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.effects.base import Drive, Effect, Survey
from imumon.effects.hysteresis import Hysteresis
from imumon.effects.library import EFFECTS
from imumon.effects.thermal_lag import ThermalLag

SHARED = -1
"""Scope: one coefficient for all runs; a number from 0 on is the one run that has it."""
OWN_TOO = ("warm_up", "drift", "periodic")
"""Effects whose size may differ from run to run: tried with shared coefficients and with own ones."""
MOST_WIDTHS = 9
"""Widths of which pairs and triples are tried, and time constants of which pairs are."""

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
        return sum(len(part.effect.nonlinear) * max(1, _times(part)) for part in self.parts)


def _times(part: Part) -> int:
    return len(part.runs) if part.effect.name == "step" else 1


def candidates(survey: Survey, families: Iterable[str] = tuple(EFFECTS)) -> list[Candidate]:
    """Return everything worth trying on such runs."""
    found: list[Candidate] = []
    every = tuple(range(survey.runs))
    for name in families:
        grid = EFFECTS[name].grid(survey)
        if name == "step":
            found += [
                Candidate(name, (Part(effect, (run,)),))
                for run in every
                for effect in grid
                if 3 * survey.block_s <= effect.time_s <= survey.durations_s[run] - 3 * survey.block_s  # type: ignore[attr-defined]  # it is a Step
            ]
            continue
        if name == "run_offset":
            found += [Candidate(name, (Part(effect, every[1:]),)) for effect in grid]
            continue
        found += [Candidate(name, (Part(effect),)) for effect in grid]
        if EFFECTS[name].free_start:
            found += [Candidate(name, (Part(effect),), free_start=True) for effect in grid]
        if name in OWN_TOO and survey.runs > 1:
            found += [Candidate(name, (Part(effect, every),)) for effect in grid]
        found += _sums(name, grid, survey)
    return found


def _sums(name: str, grid: Sequence[Effect], survey: Survey) -> list[Candidate]:
    """Return sums of two lags, and of two and three widths of a loop, where the data can tell them."""
    if survey.runs < 2 and survey.reversals < 2:
        return []
    if name == "thermal_lag":
        return _grouped(
            name, [e for e in grid if isinstance(e, ThermalLag) and e.order == 1], (2,), (False, True)
        )
    if name == "hysteresis":
        loops = [e for e in grid if isinstance(e, Hysteresis) and e.order == 1]
        return [
            *_grouped(name, [e for e in loops if e.shape == "play"], (2, 3), (False,)),
            *_grouped(name, [e for e in loops if e.shape == "smooth"], (2,), (False,)),
        ]
    return []


def _grouped(
    name: str, chosen: Sequence[Effect], sizes: Sequence[int], starts: Sequence[bool]
) -> list[Candidate]:
    """Return sums of so many of the chosen effects, or of some spread over them where they are many."""
    spread = np.unique(np.linspace(0, len(chosen) - 1, min(MOST_WIDTHS, len(chosen))).round().astype(int))
    few = [chosen[index] for index in spread] if chosen else []
    return [
        Candidate(name, tuple(map(Part, group)), free_start)
        for size in sizes
        for group in combinations(few, size)
        for free_start in starts
    ]


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
