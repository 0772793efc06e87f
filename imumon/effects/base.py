"""What all effects share: what drives them, and the small protocol that makes each usable in three ways.

An effect is a set of parameters and a causal operator: from time since power-on, temperature and specific
force it makes k columns; the bias that it adds is columns times coefficients.

- simulate: ``effect.simulate(drive)``;
- regress: ``effect.columns(drive)`` for each parameter of ``type(effect).grid(survey)``;
- live: ``Carrier(effect)``, fed block by block, with the same numbers whatever the division into blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray, IntArray
from imumon.config import StrictModel

Positive = Annotated[FiniteFloat, Field(gt=0.0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]


@dataclass(frozen=True, slots=True)
class Drive:
    """What drives the effects in one run from power-on.

    Parameters
    ----------
    time_s : array of shape (n,)
        Time since power-on, increasing.
    temperature_degc : array of shape (n,)
        Finite.
    accel : array of shape (n, 3), or None
        Specific force in m/s², body axes.
    """

    time_s: FloatArray
    temperature_degc: FloatArray
    accel: FloatArray | None = None

    def __len__(self) -> int:
        """Return the number of times."""
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class Survey:
    """What the training runs can show: it decides which parameters of an effect are worth trying.

    Parameters
    ----------
    durations_s : sequence of float
        Length of each run.
    span_degc : float
        From the lowest to the highest temperature.
    reversals : int
        Turns of the temperature by more than a fifth of the span, summed over the runs.
    accel_range : float
        Largest range of any component of the specific force within a run, m/s².
    block_s : float
        Length of the blocks whose means are regressed.
    degree : int
        Degree of the declared polynomial.
    middle_degc, half_span_degc : float
        Temperature is scaled to u = (T - middle) / half span.
    """

    durations_s: Sequence[float]
    span_degc: float
    reversals: int
    accel_range: float
    block_s: float
    degree: int
    middle_degc: float
    half_span_degc: float

    @property
    def runs(self) -> int:
        """Number of runs."""
        return len(self.durations_s)

    @property
    def shortest_s(self) -> float:
        """Length of the shortest run."""
        return min(self.durations_s)

    @property
    def thermal(self) -> bool:
        """Whether the temperature moves enough for an effect of temperature to be told."""
        return self.span_degc >= LEAST_SPAN_DEGC


LEAST_SPAN_DEGC = 3.0
"""With less the curve itself is not determined, let alone what it lacks."""


class Effect(StrictModel):
    """Base of the effects: parameters, coefficients, and a causal operator.

    Parameters
    ----------
    coefficients : list of float
        One for each column, in the unit of the channel per unit of the column; empty where none is known yet.
    """

    name: ClassVar[str]
    state_size: ClassVar[int] = 0
    """Numbers that the operator carries from one sample to the next."""
    own: ClassVar[bool] = False
    """Whether each run has coefficients of its own by nature, so that nothing carries over to another run."""
    free_start: ClassVar[bool] = False
    """Whether the state at power-on is unknown, so that `start_columns` may be fitted beside the columns."""
    nonlinear: ClassVar[tuple[str, ...]] = ()
    """Parameters that are searched and refined."""

    needs_accel: ClassVar[bool] = False
    """Whether the specific force drives it."""
    coefficients: list[FiniteFloat] = Field(default_factory=list)

    @property
    def width(self) -> int:
        """Number of columns."""
        return 1

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the effects worth trying on such runs; none where the runs cannot show the effect."""
        raise NotImplementedError

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:
        """Return the columns (n, k) and carry the state along; a state of NaN is one at power-on."""
        raise NotImplementedError

    def columns(self, drive: Drive) -> FloatArray:
        """Return the columns (n, k) of a whole run, where an operator may look ahead as well."""
        return self.advance(np.full(self.state_size, np.nan), drive)

    def extremes(self, temperature_degc: float) -> tuple[FloatArray, ...]:  # noqa: ARG002 - for those with memory
        """Return two states at power-on, a standard deviation to either side; none without doubt."""
        return ()

    def added(self, columns: FloatArray) -> FloatArray:
        """Return columns (n, k) times coefficients, (n,), to the bit the same for any n."""
        total = np.zeros(len(columns))
        for column, coefficient in zip(columns.T, self.coefficients, strict=True):
            total += coefficient * column
        return total

    def start_columns(self, drive: Drive) -> FloatArray:
        """Return what another state at power-on would add, (n, m)."""
        return np.empty((len(drive), 0))

    def settled(self, drive: Drive) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Tell from when on the state at power-on no longer matters, (n,)."""
        return np.ones(len(drive), bool)

    def simulate(self, drive: Drive) -> FloatArray:
        """Return the bias that the effect adds, (n,), in the unit of the channel."""
        return np.asarray(self.columns(drive) @ np.asarray(self.coefficients))

    def refined(self, survey: Survey, level: int) -> list[Self]:
        """Return neighbours, closer at each level, of the nonlinear parameters."""
        changed = []
        for name in self.nonlinear:
            value = getattr(self, name)
            for step in self.spacing(survey, value) * np.array([-0.5, -0.25, 0.25, 0.5]) * 0.35**level:
                near = float(self.moved(value, step))
                if near > 0:
                    changed.append(self.model_copy(update={name: near}))
        return changed

    def spacing(self, survey: Survey, value: float) -> float:  # noqa: ARG002 - for those that need it
        """Return the distance between neighbours on the grid, as `moved` understands it."""
        return 0.3

    def moved(self, value: float, step: float) -> float:
        """Return a nonlinear parameter moved by a step; by default steps are of its logarithm."""
        return value * float(np.exp(step))

    def with_coefficients(self, coefficients: Sequence[float] | FloatArray) -> Self:
        """Return the same effect with these coefficients."""
        return self.model_copy(update={"coefficients": [float(value) for value in coefficients]})


class Carrier:
    """Carries an effect along live: the bias that it adds, and how unsure its state at power-on leaves it.

    Whatever the division into blocks; where the device restarts the state is forgotten.  The temperature may
    be missing (NaN): the last one holds, as does the specific force; before the first the bias is NaN.
    An effect of the specific force adds nothing where there is none at all.

    Parameters
    ----------
    effect : Effect
        With its coefficients.
    """

    def __init__(self, effect: Effect) -> None:
        self._effect = effect
        self._states = [np.full(effect.state_size, np.nan)]
        self._segment: int | None = None
        self._start_ns = 0
        self._last = np.full(4, np.nan)

    def process(
        self, time_ns: IntArray, segment: IntArray, temperature: FloatArray, accel: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the bias at each sample, from this sample and those before it, and its doubt.

        The doubt is the standard deviation that comes from the unknown state at power-on: it dies away.

        Parameters
        ----------
        time_ns, segment : array of shape (n,)
        temperature : array of shape (n,)
            °C.
        accel : array of shape (n, 3), or None
        """
        n = len(segment)
        bias, doubt = np.zeros(n), np.zeros(n)
        if self._effect.needs_accel and accel is None:
            return bias, doubt
        cuts = np.flatnonzero(np.diff(segment)) + 1
        for a, b in pairwise([0, *cuts.tolist(), n]):
            if b > a:
                force = None if accel is None or not self._effect.needs_accel else accel[a:b]
                self._one(time_ns[a:b], int(segment[a]), temperature[a:b], force, bias[a:b], doubt[a:b])
        return bias, doubt

    def _one(
        self,
        time_ns: IntArray,
        segment: int,
        temperature: FloatArray,
        accel: FloatArray | None,
        bias: FloatArray,
        doubt: FloatArray,
    ) -> None:
        if segment != self._segment:
            self._segment, self._start_ns = segment, int(time_ns[0])
            self._last[:] = np.nan
            self._states = [np.full(self._effect.state_size, np.nan)]
        driving = [temperature, *(accel.T if accel is not None else ())]
        held = np.array([held_values(part, self._last[at]) for at, part in enumerate(driving)])
        self._last[: len(held)] = held[:, -1]
        known = np.isfinite(held).all(axis=0)
        first = int(np.argmax(known)) if known.any() else len(bias)
        bias[:first] = np.nan
        if first == len(bias):
            return
        seconds = np.asarray((time_ns[first:] - self._start_ns) * 1e-9, np.float64)
        force = held[1:, first:].T if accel is not None else None
        drive = Drive(seconds, held[0, first:], force)
        if len(self._states) == 1 and np.isnan(self._states[0]).all():
            self._states += [*self._effect.extremes(float(drive.temperature_degc[0]))]
        found = [self._effect.added(self._effect.advance(state, drive)) for state in self._states]
        bias[first:] = found[0]
        if len(found) == 3:
            doubt[first:] = 0.5 * np.abs(found[2] - found[1])


def held_values(values: FloatArray, before: float) -> FloatArray:
    """Return the values, each missing one replaced by the last there was."""
    known = np.concatenate([[np.isfinite(before)], np.isfinite(values)])
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), 0))
    return np.asarray(np.concatenate([[before], values])[last][1:])


def logarithmic(low: float, high: float, ratio: float) -> list[float]:
    """Return values from low to at most high, each `ratio` times the last; none when high is below low."""
    if high < low:
        return []
    return [float(low * ratio**index) for index in range(int(np.log(high / low) / np.log(ratio)) + 1)]
