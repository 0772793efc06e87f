"""What all effects share: what drives them, and the small protocol that makes each usable in three ways.

An effect is a set of parameters and a causal operator: from time since power-on, temperature and specific
force it makes k columns; the bias that it adds is columns times coefficients.

- simulate: ``effect.added(memory, drive)``, chunk by chunk, or ``effect.simulate(drive)`` of a whole run;
- regress: ``effect.columns(drive)`` for each parameter of ``type(effect).grid(survey)``;
- live: `imumon.models.predictor.Carrier`, fed block by block, with the same numbers however they are divided.

What the diagnosis has to know of an effect beyond that are its class attributes: no other code tests for an
effect by its name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.polynomial import Polynomial
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import BoolArray, FloatArray
from imumon.config import StrictModel

Positive = Annotated[FiniteFloat, Field(gt=0.0)]
NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]

Scope = Literal["shared", "either", "run", "event"]
"""Whose the coefficients are: shared by all runs; shared, or else each run's own; each run's own by nature;
or those of something that happens once in a run, at a time of its own.  Own ones do not carry over."""

TEMPERATURE = "temperature"
"""The driver that the declared curve is over; in a model file, what `temperature_column` names."""
ACCEL = "accel"
"""The three components of the specific force, where an effect names what drives it."""
LEAST_SPAN_DEGC = 3.0
"""With less the curve itself is not determined, let alone what it lacks."""
RATIO = 1.3
"""Of neighbours in a grid of times or widths: half way between two, before they are refined, lags, delays and
warm-ups of 40 to 1500 s and loops of up to 4 °C leave at most 7 % of their rms, in ramps of 1.5 °C/min."""
FORGOTTEN = np.exp(-3.0)
"""Share of what an unknown state at power-on adds that no longer matters: three time constants of a lag."""


@dataclass(frozen=True)
class Drive:
    """What drives the effects in one run from power-on."""

    time_s: FloatArray  # time since power-on, increasing, (n,)
    temperature_degc: FloatArray  # finite, (n,)
    accel: FloatArray | None = None  # specific force in m/s², body axes, (n, 3)
    others: Mapping[str, FloatArray] = field(default_factory=dict)  # each in its own unit; finite, (n,)

    def of(self, driver: str) -> FloatArray:
        """Return what drives an effect, (n,), or the specific force, (n, 3).

        Raises ValueError or KeyError where that is not recorded.
        """
        if driver == ACCEL:
            if self.accel is None:
                raise ValueError("an effect of the specific force needs it")
            return self.accel
        return self.temperature_degc if driver == TEMPERATURE else self.others[driver]

    def __len__(self) -> int:
        return len(self.time_s)


class Scale(NamedTuple):
    """Middle and half of the span of a driver in the training runs, in its unit."""

    middle: float
    half_span: float


class Survey(NamedTuple):
    """What the training runs can show: it decides which parameters of an effect are worth trying."""

    durations_s: Sequence[float]  # length of each run
    span_degc: float  # from the lowest to the highest temperature
    reversals: int  # turns of the temperature by more than a fifth of the span, summed over the runs
    accel_range: float  # largest range of any component of the specific force within a run, m/s²
    block_s: float  # length of the blocks whose means are regressed
    degree: int  # degree of the declared polynomial
    scale: Scale  # that of the temperature
    others: Mapping[str, Scale] = {}  # further drivers that were recorded and that vary

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
        """Whether the temperature moves enough for an effect of temperature to show."""
        return self.span_degc >= LEAST_SPAN_DEGC


@dataclass
class Memory:
    """What an effect carries from one block to the next; NaN at power-on."""

    time_s: float = np.nan  # that of the last sample
    driver: float = np.nan  # that of the last sample; of a smooth loop, behind its slack
    follower: float = np.nan  # where the one stands that follows the driver: lagged, or dragged along
    ahead: float = np.nan  # how far the driver of a smooth loop is ahead of what it drags
    past: FloatArray = field(default_factory=lambda: np.empty((0, 2)))  # of a delay: times and drivers


class Effect(StrictModel):
    """Base of the effects: parameters, coefficients, and a causal operator."""

    name: ClassVar[str]
    """That of its kind in a model file."""
    sensors: ClassVar[tuple[str, ...]] = ("gyro", "accel")
    """Whose channels may have it."""
    scope: ClassVar[Scope] = "shared"
    nonlinear: ClassVar[tuple[str, ...]] = ()
    """Parameters that are searched and refined."""
    free_start: ClassVar[bool] = False
    """Whether an unknown state at power-on may be fitted as well."""
    start_share: ClassVar[float] = 1.0
    """Standard deviation of the state at power-on; 1 is half the way between those of `starts`."""
    one_sign: ClassVar[bool] = False
    """Whether coefficients of both signs are none of it."""
    suspected_by: ClassVar[tuple[str, ...]] = ()
    """What the innovations of a bias filter follow when the model lacks it, see `imumon.estimation.watch`."""

    coefficients: list[FiniteFloat] = Field(default_factory=list)
    """One for each column, in the unit of the channel per unit of the column; empty where none is known."""

    @model_validator(mode="before")
    @classmethod
    def _as_of_temperature(cls, given: Any) -> Any:
        """Take the keys of the first format, when temperature was all that drove an effect."""
        if not isinstance(given, dict):
            return given
        own = cls.model_fields
        return {key if key in own else str(key).removesuffix("_degc"): value for key, value in given.items()}

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        if "kind" in cls.model_fields:
            cls.name = cls.model_fields["kind"].default

    @property
    def width(self) -> int:
        """Number of columns."""
        return 1

    @property
    def label(self) -> str:
        """What it is called: that of its kind, and what drives it where that is not the temperature."""
        return self.name

    @property
    def inputs(self) -> tuple[str, ...]:
        """What drives it besides time and temperature."""
        return ()

    def scale_of(self, driver: str) -> Scale | None:  # noqa: ARG002 - for those that have one
        """Return where one of `inputs` went in training; None where its place does not matter."""
        return None

    # What there is to try

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - for those with parameters
        """Return the effects worth trying on such runs, here one; none where they cannot show the effect."""
        return [cls()]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:  # noqa: ARG003 - for those that can be
        """Return the effects of another driver that are worth trying."""
        return []

    @classmethod
    def of_curve(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - for those that can be
        """Return the effects worth trying where the whole curve is late."""
        return []

    def fits_in(self, duration_s: float, survey: Survey) -> bool:  # noqa: ARG002 - for events
        """Return whether it can happen in a run of this length."""
        return True

    def refined(self, survey: Survey, level: int) -> list[Self]:
        """Return neighbours, closer at each level, of the nonlinear parameters."""
        moved = [
            (name, float(self.moved(name, step, survey)))
            for name in self.nonlinear
            for step in np.array([-0.5, -0.25, 0.25, 0.5]) * 0.35**level
        ]
        return [self.model_copy(update={name: value}) for name, value in moved if value > 0]

    def moved(self, name: str, step: float, survey: Survey) -> float:  # noqa: ARG002 - for those that need it
        """Return a parameter moved by a step; by default, its logarithm by 0.3 of it."""
        return float(getattr(self, name) * np.exp(0.3 * step))

    # What it adds

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the columns (n, k) of the next samples, and carry the memory along."""
        raise NotImplementedError

    def columns(self, drive: Drive) -> FloatArray:
        """Return the columns (n, k) of a whole run from power-on."""
        return self.advance(Memory(), drive)

    def added(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the bias that it adds to the next samples, (n,), to the bit the same for any n."""
        columns, total = self.advance(memory, drive), np.zeros(len(drive))
        for column, coefficient in zip(columns.T, self.coefficients, strict=True):
            total += coefficient * column
        return total

    def simulate(self, drive: Drive) -> FloatArray:
        """Return the bias that it adds to a whole run, (n,), in the unit of the channel."""
        return np.asarray(self.columns(drive) @ np.asarray(self.coefficients))

    def with_coefficients(self, coefficients: Sequence[float] | FloatArray) -> Self:
        """Return the same effect with these coefficients."""
        return self.model_copy(update={"coefficients": [float(value) for value in coefficients]})

    # The state at power-on

    def starts(self, drive: Drive) -> tuple[Memory, Memory] | None:  # noqa: ARG002 - for those with memory
        """Return a low and a high state at power-on, or None where it is known."""
        return None

    def start_columns(self, drive: Drive) -> FloatArray:
        """Return half of what the first columns of both `starts` differ by, (n, m)."""
        ends = self.starts(drive) if len(drive) else None
        if ends is None:
            return np.empty((len(drive), 0))
        low, high = (self.advance(memory, drive)[:, :1] for memory in ends)
        return 0.5 * (high - low)

    def settled(self, drive: Drive) -> BoolArray:
        """Return from when on the state at power-on no longer matters, (n,)."""
        start = np.abs(self.start_columns(drive)).max(axis=1, initial=0.0)
        return np.asarray(start <= FORGOTTEN * start[:1])

    # Once it is fitted

    def with_start(self, start: FloatArray) -> Self:  # noqa: ARG002 - for those with memory
        """Return it with the sd of its start that the coefficients of `start_columns` in each run show."""
        return self

    def polynomial(self) -> Polynomial | None:
        """Return it as a polynomial of the temperature for a curve to take in; None when it is not one."""
        return None


class DrivenEffect(Effect):
    """An effect of the temperature, or of whatever else was recorded."""

    operator: ClassVar[str] = ""
    """What it does with its driver, in a word for the name of an effect of another driver; else its name."""

    driver: Annotated[str, Field(min_length=1)] = TEMPERATURE
    """The temperature that the channel's curve is over, or another recorded column.  Parameters that are
    not times are in its unit."""

    @property
    def label(self) -> str:
        """That of its kind, or for instance ``lag(supply_voltage)``."""
        return self.name if self.of_temperature else f"{self.operator or self.name}({self.driver})"

    @property
    def of_temperature(self) -> bool:
        """Whether it is one of the temperature that the curve is over."""
        return self.driver == TEMPERATURE

    @property
    def inputs(self) -> tuple[str, ...]:
        """The driver, where it is another."""
        return () if self.of_temperature else (self.driver,)

    def moved(self, name: str, step: float, survey: Survey) -> float:
        """Return a parameter moved: of another driver twice as far, whose grid is as much coarser."""
        return super().moved(name, step if self.of_temperature else 2.0 * step, survey)


class ScaledEffect(DrivenEffect):
    """An effect of u = (driver - middle) / half span."""

    middle: FiniteFloat
    half_span: Positive

    def scale_of(self, driver: str) -> Scale | None:
        """Return that of its driver."""
        return Scale(self.middle, self.half_span) if driver == self.driver else None


def logarithmic(low: float, high: float, ratio: float = RATIO) -> list[float]:
    """Return values from low to at most high, each `ratio` times the last; none when high is below low."""
    count = int(np.log(high / low) / np.log(ratio)) + 1 if high >= low else 0
    return [low * ratio**index for index in range(count)]
