"""Runs of a unit at rest in means of one second, with whatever bias a test wants."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.runs import Run

DPH = np.pi / 180 / 3600
WHITE_DPH = 1.6
"""White noise of a mean of 30 s."""
SAMPLES = 100.0
Bias = Callable[[FloatArray, FloatArray], FloatArray]
"""Of time and temperature, °/h."""


def cubic(temperature: FloatArray) -> FloatArray:
    u = (temperature - 25.0) / 20.0
    return np.asarray(30 + 20 * u - 8 * u**2 + 3 * u**3)


def telegraph(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    """Return a bias that jumps to and fro at any time, which no effect explains."""
    flips = np.random.default_rng(int(time[-1]) + 5).random(len(time)) < 1 / 500
    return np.where(np.cumsum(flips) % 2 == 0, 8.0, -8.0)


def ramps(seconds: int, up: bool, rate: float = 1.5) -> tuple[FloatArray, FloatArray]:
    """Return time and temperature: ramps in °C/min between 12 and 40 °C, with soaks, from 25 °C."""
    time = np.arange(seconds, dtype=np.float64) + 0.5
    knots, values = [0.0], [25.0]
    while knots[-1] < seconds:
        for end in (40.0, 12.0) if up else (12.0, 40.0):
            knots += [knots[-1] + abs(end - values[-1]) / rate * 60]
            knots += [knots[-1] + 500]
            values += [end, end]
    return time, np.asarray(np.interp(time, knots, values))


def lagged(temperature: FloatArray, tau: float) -> FloatArray:
    """Return a temperature behind a lag, by small steps of Euler's."""
    out = np.empty_like(temperature)
    at = temperature[0]
    for i, value in enumerate(temperature):
        at += (value - at) / tau
        out[i] = at
    return out


def run(
    seed: int,
    time: FloatArray,
    temperature: FloatArray,
    bias: Bias,
    names: tuple[str, ...] = ("gyro_x",),
) -> Run:
    """Return a run whose channels have the cubic curve and a bias of their own."""
    random = np.random.default_rng(seed)
    n = len(time)
    sd = WHITE_DPH * np.sqrt(30.0) * DPH
    mean = {"temperature": np.round((temperature + 0.01 * random.standard_normal(n)) * 16) / 16}
    variance = {}
    for name in names:
        mean[name] = (cubic(temperature) + bias(time, temperature)) * DPH + sd * random.standard_normal(n)
        variance[name] = sd**2 * SAMPLES * random.chisquare(SAMPLES - 1, n) / (SAMPLES - 1)
    count = dict.fromkeys(mean, np.full(n, SAMPLES))
    return Run(f"run {seed}", time, count, mean, variance, np.ones(n))


def three(bias: Bias, seconds: int = 2400) -> tuple[list[Run], list[Run]]:
    """Return two runs for training and one for the test."""
    first, second, last = (
        run(seed, *ramps(seconds, up, rate), bias)
        for seed, up, rate in ((1, True, 1.5), (2, False, 1.5), (3, True, 1.0))
    )
    return [first, second], [last]
