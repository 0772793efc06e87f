"""What a simulated or measured unit sends, as the stages take it, and the noise that its biases have."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from study import matrix

from imumon.blocks import BoolArray, ColumnArray, FloatArray, SampleBlock
from imumon.geodesy import DEG_PER_H
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.pipeline import Estimator
from imumon.simulation.unit.biases import curve_value
from imumon.simulation.unit.scenario import Scenario, load_scenario
from imumon.simulation.unit.unit import SimulatedUnit


@dataclass(frozen=True, eq=False)
class Record:
    """What a unit sent, and the truth."""

    samples: SampleBlock
    bias: FloatArray
    earth: FloatArray
    """rad/s in body axes, (n, 3); the earth rate, of the last rest where the unit is in motion, is part of
    the bias for those who do not know latitude and heading."""
    rest: BoolArray
    """(n,)."""

    @property
    def time_s(self) -> FloatArray:
        """Time of the device, (n,)."""
        return np.asarray(self.samples["device_time_ns"] * 1e-9)

    @property
    def rate_hz(self) -> float:
        """Rate of the samples."""
        return float(round(1e9 / (self.samples["device_time_ns"][1] - self.samples["device_time_ns"][0])))


def play(scenario: Scenario, seed: int, stages: Sequence[Estimator], n: int | None = None) -> Record:
    """Return what the simulated unit sends in a scenario, or its first n samples, with columns of stages."""
    samples, truth = SimulatedUnit(scenario, seed).run(n or scenario.samples)
    for stage in stages:
        samples = samples.with_columns(stage.process(samples))
    rest = truth["at_rest"] == 1
    last = np.maximum.accumulate(np.where(rest, np.arange(len(rest)), 0))
    return Record(samples, matrix(truth, "gyro_bias"), matrix(truth, "rate")[last], rest)


LOWEST_DEGC, HIGHEST_DEGC = -20.53, 48.08
"""Range of the curves of the unit crs05."""


def crs05_curves(temperature: FloatArray) -> FloatArray:
    """Return the bias of the three gyros of the unit crs05 at temperatures (n,), rad/s, (n, 3)."""
    terms = load_scenario("crs05-ramp").unit.gyro_bias_deg_per_s
    return np.radians([curve_value(getattr(terms, axis), temperature) for axis in "xyz"]).T


def crs05_slopes(temperature: FloatArray) -> FloatArray:
    """Return its derivative, rad/s/degC, (n, 3)."""
    h = 1e-3
    return np.asarray((crs05_curves(temperature + h) - crs05_curves(temperature - h)) / (2.0 * h))


def crs05_model(thermometers: Sequence[str] = ("temperature",) * 3, tilt_z_dph: float = 0.0) -> BiasModel:
    """Return the curves as a model file would hold them; z is wrong by a line of so many °/h per °C."""
    knots = np.linspace(LOWEST_DEGC, HIGHEST_DEGC, 300)
    wrong = tilt_z_dph * DEG_PER_H * np.array([0.0, 0.0, 1.0])
    values, slopes = crs05_curves(knots) + np.outer(knots, wrong), crs05_slopes(knots) + wrong
    channels = {
        f"gyro_{axis}": ChannelModel(
            unit="rad/s",
            temperature_column=thermometers[j],
            temperature_range_degc=[LOWEST_DEGC, HIGHEST_DEGC],
            residual_sd=DEG_PER_H,
            curve=SplineCurve(
                knots_degc=knots.tolist(), values=values[:, j].tolist(), slopes=slopes[:, j].tolist()
            ),
        )
        for j, axis in enumerate("xyz")
    }
    return BiasModel(made_by="the unit crs05", created="2026-01-01T00:00:00Z", channels=channels)


def sent(time_s: FloatArray, /, **sensors: FloatArray) -> SampleBlock:
    """Return the samples of a unit in one segment; a sensor is a vector, (n, 3), or a number, (n,)."""
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.rint(time_s * 1e9).astype(np.int64),
        "segment": np.zeros(len(time_s), np.int64),
    }
    for name, values in sensors.items():
        if values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}_{axis}": values[:, j].copy() for j, axis in enumerate("xyz")}
    return SampleBlock(columns)


def without(samples: SampleBlock, sensor: str) -> SampleBlock:
    """Return the samples without the columns of a sensor."""
    return SampleBlock({name: values for name, values in samples.columns.items() if sensor not in name})


def gauss_markov(rng: np.random.Generator, n: int, rate_hz: float, tau_s: float, sd: float) -> FloatArray:
    """Return three Gauss-Markov processes in equilibrium, (n, 3), of this standard deviation."""
    decay = math.exp(-1.0 / (rate_hz * tau_s))
    drive = rng.normal(size=(n, 3)) * sd * math.sqrt(1.0 - decay * decay)
    drive[0] = rng.normal(size=3) * sd
    return np.asarray(lfilter([1.0], [1.0, -decay], drive, axis=0))
