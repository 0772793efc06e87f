"""A channel over the recordings, the declared model of its bias, and a model that is known.

The latter is the start of a search: its curve is taken from the runs, its effects come first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import Effect
from imumon.errors import ImumonError, Reason
from imumon.lab.diagnosis.blocks import RunBlocks, WhiteFloor
from imumon.lab.diagnosis.candidates import Candidate, Part, Pool
from imumon.lab.diagnosis.quality import Fault
from imumon.lab.diagnosis.runs import SECOND_NS, Run, common_temperature
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

Own = Literal["", "run", "pose"]
CUBIC_DEGREE = 3
"""As what is assumed without a model: other curves keep their shape, and have a cubic added."""


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What is diagnosed: training runs, their blocks and those of the test, and what is declared of them.

    Short runs are searched in `shorter` blocks: of few blocks the one with a jump in it decides.
    `temperatures` has that of each channel, `degree` is that of the declared polynomial, and `own` says
    whether each run, or each pose of each run, has a constant of its own.  With a `model` that is known, its
    curve is off the runs already.
    """

    runs: Sequence[Run]
    blocks: Sequence[RunBlocks]
    temperatures: Mapping[str, str]
    degree: int
    test: Sequence[RunBlocks] = ()
    shorter: Sequence[RunBlocks] = ()
    own: Own = ""
    model: BiasModel | None = None


@dataclass(frozen=True, slots=True)
class Declared:
    """The declared model: a polynomial of u = (T - middle) / half span, and constants of runs or poses."""

    degree: int
    middle_degc: float
    half_span_degc: float
    own: Own = ""

    @classmethod
    def over(cls, runs: Sequence[RunBlocks], temperature: str, degree: int, own: Own) -> Self:
        """Return the model with the scale of the temperatures of these runs."""
        found = np.concatenate([run.temperature[temperature] for run in runs])
        low, high = float(found.min()), float(found.max())
        return cls(degree, 0.5 * (low + high), max(0.5 * (high - low), 1e-3), own)

    def columns(self, temperature: FloatArray, powers: int | None = None) -> FloatArray:
        """Return 1, u, ... u^degree, (n, degree + 1), or so many of these."""
        u = (temperature - self.middle_degc) / self.half_span_degc
        return np.asarray(u[:, np.newaxis] ** np.arange(powers or self.degree + 1))

    def training(self, runs: Sequence[RunBlocks], temperature: str) -> FloatArray:
        """Return the columns over all training runs, with a constant for each further run or pose where it
        has one of its own."""
        columns = self.columns(np.concatenate([run.temperature[temperature] for run in runs]))
        if not self.own:
            return columns
        which = [np.column_stack([np.full(len(run), at), self.levels(run)]) for at, run in enumerate(runs)]
        level = np.unique(np.concatenate(which), axis=0, return_inverse=True)[1].reshape(-1, 1)
        return np.column_stack([columns, level == np.arange(1, level.max() + 1)]).astype(np.float64)

    def levels(self, run: RunBlocks) -> IntArray:
        """Return which of the constants of a run each block has, (n,), from 0."""
        return run.pose if self.own == "pose" else np.zeros(len(run), np.int64)


@dataclass(frozen=True, eq=False)
class Channel:
    """A channel over the runs that it is fitted to, and those that prove what was found."""

    name: str
    unit: str
    floor: WhiteFloor
    """Of a block."""
    declared: Declared
    pool: Pool
    """Training runs, which temperature drives the channel, and the columns of effects over them."""
    test: Sequence[RunBlocks]
    faults: Sequence[Fault] = ()
    """What is wrong with its data."""
    known: tuple[Effect, ...] | None = None
    """Effects of the present model, whose curve is off the means already; None without one."""
    kept: tuple[Effect, ...] = ()
    """Those of them that stay as they are; a search begins with the others, and fits them anew."""

    @property
    def blind(self) -> float:
        """rms below which an effect may be a fault of the data."""
        return max((fault.blind for fault in self.faults), default=0.0)

    @property
    def limit(self) -> float:
        """rms that white noise and faults of the data together make of a block: no structure is below it."""
        return float(np.hypot(self.floor.sd, self.blind))

    @property
    def coarse(self) -> bool:
        """Whether faults of the data may make what matters of a smooth bias: an error of a floor."""
        return self.blind >= self.floor.sd

    @property
    def temperature(self) -> str:
        """Which temperature drives it."""
        return self.pool.temperature

    @cached_property
    def values(self) -> FloatArray:
        """Block means over all training runs less the effects that stay as they are, (n,)."""
        means = np.concatenate([run.mean[self.name] for run in self.pool.runs])
        for effect in self.kept:
            columns = self.pool.design([Candidate(effect.label, (Part(effect),))])
            means = means - columns @ np.asarray(effect.coefficients)
        return means

    @cached_property
    def base(self) -> FloatArray:
        """Columns of the declared model over all training runs, (n, p)."""
        return self.declared.training(self.pool.runs, self.temperature)

    def design(self, found: Sequence[Candidate]) -> FloatArray:
        """Return the columns of the declared model and of what was found, (n, k)."""
        return np.column_stack([self.base, self.pool.design(found)])

    def residual_rms(self, found: Sequence[Candidate]) -> float:
        """Return the rms of what ordinary least squares leave beside what was found."""
        columns = self.design(found)
        left = self.values - columns @ least_squares(columns, self.values)
        return float(np.sqrt(np.mean(left**2)))

    @property
    def refitted(self) -> bool:
        """Whether the present model is fitted anew, its curve, or effects of it."""
        return self.known is not None and bool(self.declared.degree or len(self.kept) < len(self.known))

    def as_given(self) -> Channel:
        """Return it with the present model as it is, where there is one, but for a constant."""
        if self.known is None:
            return self
        return replace(self, declared=replace(self.declared, degree=0), kept=self.known)


def least_squares(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Return the coefficients of ordinary least squares, the smallest where columns are collinear."""
    norm = np.linalg.norm(columns, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    return np.asarray(np.linalg.lstsq(columns / norm, values, rcond=1e-10)[0] / norm)


# A model that is known


def temperature_of(channel: str, model: BiasModel, runs: Sequence[Run]) -> str:
    """Return the temperature in the runs that the model's curve of a channel is over.

    Raises BAD_DATA when a run lacks it.
    """
    name = model.channels[channel].temperature_column.replace("_estimate", "")
    return common_temperature(name, runs, f"the bias model needs {name}, which not every run has")


def check_range(model: BiasModel, temperatures: Mapping[str, str], runs: Sequence[RunBlocks]) -> None:
    """Refuse a model whose curves hold at no temperature of the runs: nothing of them could be fitted anew.

    Raises BAD_CONFIG, naming both ranges.
    """
    for name, temperature in temperatures.items():
        found = np.concatenate([run.temperature[temperature] for run in runs])
        low, high = model.channels[name].temperature_range_degc
        if max(low, float(found.min())) >= min(high, float(found.max())):
            raise ImumonError(
                Reason.BAD_CONFIG,
                f"the bias model of {name} holds from {low:.2f} to {high:.2f} °C, the training data has"
                f" {found.min():.2f} to {found.max():.2f} °C: they do not overlap",
                "give a model that was calibrated at these temperatures, or none: leave --model out",
            )


def order_of(channel: ChannelModel) -> int:
    """Return the degree of the polynomial by which a curve is fitted anew: its own, or a cubic's."""
    curve = channel.curve
    return len(curve.coefficients) - 1 if isinstance(curve, PolynomialCurve) else CUBIC_DEGREE


def effects_of(channel: ChannelModel) -> tuple[Effect, ...]:
    """Return the effects of a model beside its curve, and what is part of that."""
    return tuple(effect for effect in channel.effects if effect.polynomial() is None)


def curves_of(model: BiasModel) -> BiasModel:
    """Return a model without its effects, but for those that are part of its curves."""
    channels = {
        name: channel.model_copy(
            update={"effects": [one for one in channel.effects if one.polynomial() is not None]}
        )
        for name, channel in model.channels.items()
    }
    return model.model_copy(update={"channels": channels})


def without_model(run: Run, model: BiasModel, channels: Sequence[str]) -> Run:
    """Return a run with what a model expects taken from its channels, effects integrated from power-on."""
    channels = [name for name in channels if name in run.mean]
    temperatures = [temperature_of(name, model, [run]) for name in channels]
    force = [run.mean[f"accel_{axis}"] for axis in "xyz" if f"accel_{axis}" in run.mean]
    expected = BiasPredictor(model, channels).process(
        np.round(run.time_s * SECOND_NS).astype(np.int64),
        np.zeros(len(run.time_s), np.int64),
        np.column_stack([run.mean[name] for name in temperatures]),
        np.column_stack(force) if len(force) == 3 else None,
        run.mean,
    )
    changed = {name: run.mean[name] - expected.bias[:, at] for at, name in enumerate(channels)}
    return replace(run, mean={**run.mean, **changed})
