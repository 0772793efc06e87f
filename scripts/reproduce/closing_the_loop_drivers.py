"""Cases with further recorded columns: ten that have nothing to do with the bias, or one that drives it.

The physics is again not that of the regressors: a supply acts through tanh, a chamber's pressure through two
lags, a field through Bouc and Wen's loop, a second thermometer sits where the heat comes later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from closing_the_loop_cases import Case, Setting, bouc_wen, make_case

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.runs import Run

Generator = np.random.Generator
Column = Callable[[Generator, Run], FloatArray]


def behind(values: FloatArray, tau: float) -> FloatArray:
    """Return values behind a first-order lag, from equilibrium."""
    from scipy.signal import lfilter

    decay = np.exp(-1 / tau)
    return np.asarray(lfilter([1 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0])


def walk(rng: Generator, run: Run) -> FloatArray:
    """Return a random walk."""
    return np.asarray(np.cumsum(rng.standard_normal(len(run.time_s))))


def ramp(rng: Generator, run: Run) -> FloatArray:
    """Return a battery that runs down, or a tank."""
    return np.asarray(rng.normal() + run.time_s / 7200 * rng.uniform(0.7, 1.3))


def swing(rng: Generator, run: Run) -> FloatArray:
    """Return a swing of its own phase and nearly its own period in each run."""
    period = 10 ** rng.uniform(2.4, 3.7)
    return np.asarray(np.sin(2 * np.pi * (run.time_s / period + rng.random())))


def near_temperature(rng: Generator, run: Run) -> FloatArray:
    """Return what goes with temperature: a supply with a temperature coefficient, and noise of its own."""
    return np.asarray(0.02 * run.mean["temperature"] + 0.02 * rng.standard_normal(len(run.time_s)))


def late_temperature(rng: Generator, run: Run) -> FloatArray:
    """Return a second thermometer, on the housing."""
    late = behind(run.mean["temperature"], rng.uniform(200, 900))
    return np.asarray(np.round((late + 0.02 * rng.standard_normal(len(late))) * 16) / 16)


def noise(rng: Generator, run: Run) -> FloatArray:
    """Return a constant with noise."""
    return np.asarray(5.0 + 0.01 * rng.standard_normal(len(run.time_s)))


def switched(rng: Generator, run: Run) -> FloatArray:
    """Return what is switched between levels at odd times and follows within a minute or three."""
    level = np.cumsum(rng.random(len(run.time_s)) < 1 / 500)
    values = rng.normal(size=int(level[-1]) + 1)[level]
    return behind(values, rng.uniform(60, 200))


IRRELEVANT: dict[str, Column] = {
    "walk_1": walk,
    "walk_2": walk,
    "walk_3": walk,
    "ramp_1": ramp,
    "swing_1": swing,
    "swing_2": swing,
    "load_current": near_temperature,
    "temperature_2": late_temperature,
    "reference_voltage": noise,
    "supply_voltage": switched,
}


@dataclass(frozen=True, slots=True)
class Driving:
    """A column that drives the bias, and what it does."""

    column: str
    made: Column
    does: Callable[[Generator, FloatArray, Run], FloatArray]
    truth: str


DRIVING: dict[str, Driving] = {
    "supply, curved": Driving(
        "supply_voltage", switched, lambda _, v, __: np.tanh(v / 1.5) + 0.2 * v, "curve(supply_voltage)"
    ),
    "pressure, straight": Driving("pressure", walk, lambda _, v, __: v, "curve(pressure)"),
    "load, late": Driving(
        "load_current",
        switched,
        lambda rng, v, __: behind(behind(v, rng.uniform(150, 300)), 40.0),
        "lag(load_current)",
    ),
    "field, loop": Driving(
        "mag_x",
        lambda rng, run: 20.0 * behind(swing(rng, run) + 0.3 * switched(rng, run), 30.0),
        lambda rng, v, __: bouc_wen(rng, v),
        "loop(mag_x)",
    ),
    "pressure, rate": Driving(
        "pressure", switched, lambda _, v, __: behind(np.gradient(v), 10.0), "rate(pressure)"
    ),
    "gradient": Driving(
        "temperature_2",
        lambda rng, run: late_temperature(rng, run) + 2.0 * behind(switched(rng, run), 100.0),
        lambda _, v, run: v - behind(run.mean["temperature"], 20.0),
        "curve(temperature_2)",
    ),
    "vibration": Driving(
        "vibration",
        lambda rng, run: np.asarray(np.exp(switched(rng, run)) * rng.chisquare(297, len(run.time_s)) / 297),
        lambda _, v, __: behind(v, 2.0),
        "curve(vibration)",
    ),
    "supply, with temperature": Driving(
        "supply_voltage",
        switched,
        lambda _, v, run: v * (run.mean["temperature"] - 25.0) / 15.0,
        "product(temperature, supply_voltage)",
    ),
}


def make(setting: Setting, seed: int) -> Case:
    """Return a case with ten further columns; its label says which of them drives the bias, if any does."""
    rng = np.random.default_rng([seed, 77])
    driving = DRIVING.get(setting.driver)
    case = make_case(setting, seed)
    added: list[list[FloatArray]] = []
    runs = []
    for run in case.runs:
        mean = dict(run.mean)
        for name, column in IRRELEVANT.items():
            mean[name] = column(rng, run)
        if driving is not None:
            mean[driving.column] = driving.made(rng, run)
            # The physics of an axis is the same in every run.
            added.append(
                [
                    driving.does(np.random.default_rng([seed, axis]), mean[driving.column], run)
                    for axis in range(3)
                ]
            )
        runs.append(replace(run, mean=mean))
    if driving is not None:
        add(case, runs, added, setting)
        case = replace(case, truth=[{*truth, driving.truth} for truth in case.truth])
    return replace(case, runs=runs)


def add(case: Case, runs: list[Run], added: list[list[FloatArray]], setting: Setting) -> None:
    """Add the bias, scaled so that the declared model leaves `size` times the noise in training."""
    temperature = np.concatenate([_means(run.mean["temperature"]) for run in runs[:2]])
    columns = ((temperature - 25) / 20)[:, np.newaxis] ** np.arange(4)
    for axis, letter in enumerate("xyz"):
        left = np.concatenate([_means(parts[axis]) for parts in added[:2]])
        left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
        factor = (-1) ** axis * setting.size * case.floor / float(np.sqrt(np.mean(left**2)))
        for run, parts in zip(runs, added, strict=True):
            run.mean[f"gyro_{letter}"] = run.mean[f"gyro_{letter}"] + factor * parts[axis]


def _means(values: FloatArray) -> FloatArray:
    return np.asarray(values.reshape(-1, 30).mean(axis=1))
