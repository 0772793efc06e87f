"""Simulated records of the ramp test, and the filters of the comparison run on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from curve_slopes import curve_slope
from dense_record import dense_filter

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import EARTH_RATE, body_to_ned
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.papers.dense_zupt import DenseSettings
from imumon.papers.fir import FirRate, Params
from imumon.simulation.unit.curves import curve_value
from imumon.simulation.unit.scenario import load_scenario
from imumon.simulation.unit.unit import SimulatedUnit

DPH = math.radians(1.0) / 3600.0
"""One degree per hour, rad/s."""
RATE_HZ = 100
LATITUDE_DEG = 40.93
ZEROING = 60 * RATE_HZ
STEP = 10
"""Samples to a step of the filter: as good as one, see tests/papers/test_dense_zupt.py."""
THRESHOLD = 1.00e-5 / DPH
"""Convergence of the paper, deg/h."""
RESIDUAL = 15.0
AVERAGE_S = 30
LOWEST, HIGHEST = -20.53, 48.08
UP = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A run of the simulated unit: samples at 100 Hz and the truth, rad/s and degC, (n, 3) and (n,)."""

    block: SampleBlock
    gyro: FloatArray
    accel: FloatArray
    temperature: FloatArray
    bias: FloatArray
    earth: FloatArray

    @property
    def seconds(self) -> FloatArray:
        """Time after the zeroing, s."""
        return (np.arange(len(self.gyro)) - ZEROING + 1) / RATE_HZ


def simulate(scenario: str, seed: int) -> Record:
    """Play a scenario."""
    played = load_scenario(scenario)
    sent, truth = SimulatedUnit(played, seed).run(round(played.duration_s * played.rate_hz))
    latitude = math.radians(played.latitude_deg)
    earth = EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])
    gyro, accel, bias = sent.gyro, sent.accel, truth.vector("gyro_bias")
    assert gyro is not None
    assert accel is not None
    assert bias is not None
    return Record(
        sent.with_columns({"at_rest": truth["at_rest"]}), gyro, accel, truth["temperature"], bias,
        body_to_ned(UP, 0.0).T @ earth,
    )  # fmt: skip


def curves(temperature: FloatArray) -> FloatArray:
    """Return the true curve of the three gyros at temperatures (n,), rad/s, (n, 3)."""
    terms = load_scenario("crs05-ramp").unit.gyro_bias_deg_per_s
    return np.radians([curve_value(getattr(terms, axis), temperature) for axis in "xyz"]).T


def slopes(temperature: FloatArray) -> FloatArray:
    """Return its derivative, rad/s/degC, (n, 3)."""
    terms = load_scenario("crs05-ramp").unit.gyro_bias_deg_per_s
    return np.radians([curve_slope(getattr(terms, axis), temperature) for axis in "xyz"]).T


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a filter knows of the gyros: bias and its derivative at temperatures (n,), each (n, 3).

    rad/s and rad/s/degC, without the earth rate.
    """

    value: Callable[[FloatArray], FloatArray]
    slope: Callable[[FloatArray], FloatArray]


TRUE = Calibration(curves, slopes)


def true_model(residual_dph: float = 1.0) -> BiasModel:
    """Return the true curve as a model file would hold it."""
    knots = np.linspace(LOWEST, HIGHEST, 300)
    value, slope = curves(knots), slopes(knots)
    channels = {
        f"gyro_{axis}": ChannelModel(
            unit="rad/s",
            temperature_column="temperature",
            temperature_range_degc=[LOWEST, HIGHEST],
            residual_sd=residual_dph * DPH,
            curve=SplineCurve(
                knots_degc=knots.tolist(), values=value[:, j].tolist(), slopes=slope[:, j].tolist()
            ),
        )
        for j, axis in enumerate("xyz")
    }
    return BiasModel(made_by="scripts/reproduce/tczupt", created="2026-01-01T00:00:00Z", channels=channels)


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter of the comparison: K in deg/h/sqrt(s), p0 in deg/h.

    `thermal` is None (raw data as they are), calibrated, rate (published form), fir (the same with the rate
    from the reading) or increments.
    """

    thermal: str | None
    k: float = 0.1
    p0: float = 2.2
    temperature: str = "true"
    calibration: Calibration = TRUE


def run(record: Record, chosen: Filter, residual: float = 0.0) -> FloatArray:
    """Return the error of the bias after the zeroing, deg/h, (n, 3)."""
    temperature = record.temperature
    if chosen.temperature == "reading":
        temperature = record.block["temperature"]
    thermal = chosen.calibration.value(temperature)
    gyro = record.gyro - thermal if chosen.thermal == "calibrated" else record.gyro
    start = (gyro[:ZEROING] - record.earth).mean(0) + residual * DPH
    part = slice(ZEROING, None)
    drift = _drift(record, chosen, temperature, thermal)
    settings = replace(DenseSettings(1.0 / RATE_HZ), bias_random_walk=chosen.k * DPH, bias_sd=chosen.p0 * DPH)
    result = dense_filter(settings, gyro[part], record.accel[part], start, drift, UP, STEP)
    bias = result.bias + (thermal[part] if chosen.thermal == "calibrated" else 0.0)
    return np.asarray((bias - record.bias[part]) / DPH)


def _drift(record: Record, chosen: Filter, temperature: FloatArray, thermal: FloatArray) -> FloatArray | None:
    """Return what the thermal term adds at each sample after the zeroing, (n, 3)."""
    if chosen.thermal == "increments":
        return np.diff(thermal, axis=0)[ZEROING - 1 :]
    if chosen.thermal in ("rate", "fir"):
        rate = fir_rate(record) if chosen.thermal == "fir" else np.gradient(record.temperature) * RATE_HZ
        return (chosen.calibration.slope(temperature) * rate[:, np.newaxis] / RATE_HZ)[ZEROING:]
    return None


def fir_rate(record: Record) -> FloatArray:
    """Return the rate by the published estimator (window 300 s, constant 180 s, 90 measurements), degC/s."""
    time_ns, segment = record.block["device_time_ns"], record.block["segment"]
    result = FirRate(Params(0.05)).process(time_ns, segment, record.block["temperature"])
    return np.nan_to_num(result.rate)


def moving_average(record: Record) -> FloatArray:
    """Return the paper's reference: centred 30 s means of the raw rate less the earth's, rad/s, (n, 3)."""
    width = AVERAGE_S * RATE_HZ
    total = np.cumsum(np.vstack([np.zeros(3), record.gyro - record.earth]), axis=0)
    n = len(record.gyro)
    low = np.clip(np.arange(n) - width // 2, 0, n)
    high = np.clip(np.arange(n) + width // 2, 0, n)
    return np.asarray((total[high] - total[low]) / (high - low)[:, np.newaxis])


def convergence_s(error: FloatArray) -> FloatArray:
    """Return when each axis is within 1.00e-5 rad/s for the first time for 5 s, s, (3,)."""
    held = 5 * RATE_HZ
    times = np.full(3, np.nan)
    for j in range(3):
        inside = np.concatenate([[0], np.cumsum(np.abs(error[:, j]) < THRESHOLD)])
        whole = np.flatnonzero(inside[held:] - inside[:-held] == held)
        if len(whole):
            times[j] = (whole[0] + 1) / RATE_HZ
    return times
