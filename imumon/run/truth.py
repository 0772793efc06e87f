"""Errors of estimates against the truth that is kept beside a simulated session."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.columns import TEMPERATURES
from imumon.errors import ImumonError, Reason
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor
from imumon.pipeline import Estimator
from imumon.protocols.device import DeviceFile
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.recordings.reader import open_recording
from imumon.recordings.table import read_columns, read_table
from imumon.simulation.recording import TRUTH_NAME

GYROS = ("gyro_bias_x", "gyro_bias_y", "gyro_bias_z")
ESTIMATED = tuple(name.replace("temperature", "temperature_estimate") for name in TEMPERATURES)
RATES = ("rate_x", "rate_y", "rate_z")
NEEDED = ("device_time_ns", *GYROS, *RATES, *TEMPERATURES, "at_rest")
Estimate = tuple[FloatArray, FloatArray | None]
"""Values and their standard deviations, (n,) each."""


@dataclass(slots=True)
class Errors:
    """Errors of one quantity so far, in its unit."""

    count: int = 0
    squares: float = 0.0
    largest: float = 0.0
    normalized_count: int = 0
    normalized_squares: float = 0.0

    def take(self, error: FloatArray, sigma: FloatArray | None) -> None:
        """Add errors, (n,); those that are NaN are left out."""
        known = np.isfinite(error)
        if not known.any():
            return
        self.count += int(known.sum())
        self.squares += float(np.sum(error[known] ** 2))
        self.largest = max(self.largest, float(np.max(np.abs(error[known]))))
        if sigma is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = error / sigma
            ratio = ratio[np.isfinite(ratio)]
            self.normalized_count += len(ratio)
            self.normalized_squares += float(ratio @ ratio)

    @property
    def rms(self) -> float:
        """Root mean square of the error; NaN without samples."""
        return math.sqrt(self.squares / self.count) if self.count else math.nan

    @property
    def normalized_rms(self) -> float:
        """Root mean square of error / sigma, 1 where sigma is right; NaN without a sigma."""
        count = self.normalized_count
        return math.sqrt(self.normalized_squares / count) if count else math.nan


@dataclass(slots=True, eq=False)
class Truth:
    """The truth of a simulated session, and the errors of what was compared with it.

    A gyro at rest cannot separate its bias from the earth's rotation.  Where the estimate does not have the
    earth's rotation removed, it is compared with the sum of both, at the attitude of the last rest.
    """

    time_ns: IntArray
    """Device time of each row, increasing."""
    bias: FloatArray
    """What the bias estimates are compared with, rad/s, (n, 3)."""
    temperature: Mapping[str, FloatArray]
    """°C, (n,), by the columns of the truth."""
    at_rest: IntArray
    errors: dict[str, Errors] = field(default_factory=dict)

    def take(self, block: SampleBlock, estimates: Mapping[str, Estimate], *, at_rest: bool = False) -> None:
        """Compare estimates at the samples of a block.

        Parameters
        ----------
        estimates : mapping of str to Estimate
            By gyro_bias_{x,y,z} (rad/s), and by recorded or estimated temperatures (°C).
        at_rest : bool
            Only where the unit is at rest.
        """
        row, matched = self._rows(block["device_time_ns"])
        if at_rest:
            matched = matched & (self.at_rest[row] == 1)
        for name, (values, sigma) in estimates.items():
            true = self._true(name)[row]
            errors = self.errors.setdefault(name, Errors())
            errors.take(np.where(matched, values - true, np.nan), sigma)

    def through(self, blocks: Iterator[SampleBlock]) -> Iterator[SampleBlock]:
        """Pass blocks of a replay on, and compare the estimates in them."""
        for block in blocks:
            pairs = {name: name.replace("bias", "bias_sd") for name in GYROS}
            pairs |= {name: name.replace("estimate", "estimate_sd") for name in ESTIMATED}
            self.take(
                block,
                {
                    name: (block[name], block.columns.get(sigma))
                    for name, sigma in pairs.items()
                    if name in block
                },
            )
            yield block

    def _true(self, name: str) -> FloatArray:
        """Return what an estimate is compared with, (n,)."""
        if name in GYROS:
            return self.bias[:, GYROS.index(name)]
        return self.temperature[name.replace("_estimate", "")]

    def _rows(self, time_ns: IntArray) -> tuple[IntArray, BoolArray]:
        """Return the row of each sample, and whether the truth has its time."""
        row = np.minimum(np.searchsorted(self.time_ns, time_ns), len(self.time_ns) - 1)
        return row, self.time_ns[row] == time_ns

    def as_data(self) -> dict[str, dict[str, float | int | str]]:
        """Return the errors for ``--json``, rates in °/h."""
        return {
            name: {
                "unit": _unit(name)[0],
                "samples": one.count,
                "rms": one.rms * _unit(name)[1],
                "rms_over_sigma": one.normalized_rms,
                "largest": one.largest * _unit(name)[1],
            }
            for name, one in self.errors.items()
        }

    def rows(self) -> dict[str, str]:
        """Return the errors as lines for a person."""
        return {f"error of {name}": _described(name, one) for name, one in self.errors.items()}


def check_truth(sessions: Iterable[Path]) -> None:
    """Raise BAD_DATA for the first session that has no truth."""
    for session in sessions:
        if not (session / TRUTH_NAME).is_file():
            raise ImumonError(
                Reason.BAD_DATA,
                f"{session}: there is no {TRUTH_NAME} in this session, so its errors are unknown",
                "only a session of `imumon simulate` has true values; leave --truth away",
            )


def read_truth(session: Path, *, earth_removed: bool) -> Truth:
    """Read the truth of a simulated session; raises BAD_DATA where there is none.

    Parameters
    ----------
    earth_removed : bool
        Whether the estimates are without the earth's rotation.
    """
    check_truth([session])
    path = session / TRUTH_NAME
    if lacking := [name for name in NEEDED if name not in read_columns(path)]:
        raise ImumonError(
            Reason.BAD_DATA, f"{path}: has no {', '.join(lacking)}", "simulate the session anew"
        )
    table, _ = read_table(path)
    if not len(table):
        raise ImumonError(Reason.BAD_DATA, f"{path}: has no rows", "simulate the session anew")
    bias = np.column_stack([table[name] for name in GYROS])
    at_rest = table["at_rest"].astype(np.int64)
    if not earth_removed:
        bias = bias + _at_last_rest(np.column_stack([table[name] for name in RATES]), at_rest)
    return Truth(
        table["device_time_ns"].astype(np.int64), bias, {name: table[name] for name in TEMPERATURES}, at_rest
    )


def errors_of_model(session: Path, model: BiasModel) -> Truth:
    """Compare the curves of a bias model, and the recorded temperature, with the truth of a session at rest.

    Raises BAD_DATA where the session has no truth.
    """
    truth = read_truth(session, earth_removed=model.earth_rate == "removed")
    names = [f"gyro_{axis}" for axis in "xyz" if f"gyro_{axis}" in model.channels]
    predictor = BiasPredictor(model, names)
    for block in open_recording(session, _stages).blocks():
        nothing = np.full(len(block), np.nan)

        def column(name: str, of: SampleBlock = block, instead: FloatArray = nothing) -> FloatArray:
            return of.columns.get(name, instead)

        predicted = predictor.process(
            block["device_time_ns"],
            block["segment"],
            np.column_stack([column(name) for name in predictor.temperature_columns]),
            np.column_stack([column(f"accel_{axis}") for axis in "xyz"]),
            {name: block[name] for name in predictor.drivers if name in block},
        ).bias
        found: dict[str, Estimate] = {}
        for at, name in enumerate(names):
            sigma = np.full(len(block), model.channels[name].residual_sd)
            found[name.replace("gyro", "gyro_bias")] = predicted[:, at], sigma
        found |= {name: (block[name], None) for name in TEMPERATURES if name in block}
        truth.take(block, found, at_rest=True)
    return truth


def _stages(device: DeviceFile | None) -> Sequence[Estimator]:
    """Return what estimates the temperatures that the curves are over."""
    given = device.temperature if device is not None else TemperatureRateParameters()
    return [TemperatureRate(parameters=given)]


def _at_last_rest(rate: FloatArray, at_rest: IntArray) -> FloatArray:
    """Return the rate at the last rest, rad/s, (n, 3): the earth's; NaN before the first rest."""
    last = np.maximum.accumulate(np.where(at_rest == 1, np.arange(len(at_rest)), -1))
    return np.where((last >= 0)[:, np.newaxis], rate[np.maximum(last, 0)], np.nan)


def _unit(name: str) -> tuple[str, float]:
    return ("°/h", 1.0 / DEG_PER_H) if name in GYROS else ("°C", 1.0)


def _described(name: str, errors: Errors) -> str:
    unit, factor = _unit(name)
    if not errors.count:
        return "no estimate"
    ratio = errors.normalized_rms
    sigma = f", {ratio:.2f} σ rms" if ratio == ratio else ""
    return f"{errors.rms * factor:.3g} {unit} rms{sigma}, at most {errors.largest * factor:.3g} {unit}"
