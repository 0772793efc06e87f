"""Ablations of the temperature rate: kinds of thermometers, and a measured record at four step sizes."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from ablations import Change, Outcome, ablation
from study import largest, rms
from thermometers import KINDS, PER_HOUR, Profile, constant, drifting, errors, ramp, thermostat

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate import filter as filter_module
from imumon.estimation.temperature_rate import measurement, stage, thermometer
from imumon.estimation.temperature_rate.filter import (
    CODE_MODELS,
    JERK_PSDS,
    MEAN_MODELS,
    Correction,
    NoiseModels,
)
from imumon.estimation.temperature_rate.measurement import evaluate
from imumon.estimation.temperature_rate.stage import MultipleModelRate
from imumon.estimation.temperature_rate.thermometer import Thermometer

TITLE = "Rate of temperature: kinds of thermometers, and a measured record in steps of 0, 1/16, 0.5 and 1 °C."
FLOOR = 0.1
SETTLED_S, RECORD_SETTLED_S, HALF_S = 600.0, 180.0, 60.0
SCENES: list[tuple[str, str, Profile, float, float]] = [
    ("white 0.03 step", "5 °C/h", drifting, 1800.0, SETTLED_S),
    ("white 0.3 step", "5 °C/h", drifting, 1800.0, SETTLED_S),
    ("white 0.5 step, 10 Hz", "5 °C/h", drifting, 1800.0, SETTLED_S),
    ("1 °C, white 0.05 step", "5 °C/h", drifting, 1800.0, SETTLED_S),
    ("correlated 5 s, 0.5 step", "constant", constant, 1800.0, SETTLED_S),
    ("1/f, 0.5 step", "constant", constant, 1800.0, SETTLED_S),
    ("0.5 °C, 1/f, 0.3 step", "5 °C/h", drifting, 1800.0, SETTLED_S),
    ("refresh 4 s, 0.3 step", "2 °C/min", ramp(300.0), 600.0, 324.0),
    ("refresh 10 s, 0.3 step", "2 °C/min", ramp(300.0), 600.0, 330.0),
    ("refresh 60 s, 0.3 step", "2 °C/min", ramp(300.0), 600.0, 380.0),
    ("1 °C, white 0.3 step", "2 °C/min", ramp(300.0), 600.0, 320.0),
    ("hysteresis of a step, white 0.1", "5 °C/h", drifting, 1800.0, SETTLED_S),
    ("0.05 °C, 2 Hz stream, 0.3 step", "thermostat", thermostat(1.0, 900.0, 40.0), 5400.0, 1800.0),
    ("no steps, white 0.02 °C", "2 °C/min", ramp(300.0), 600.0, 320.0),
]
STEPS_DEGC = (0.0, 0.0625, 0.5, 1.0)

_, SLOW, _, WALK = range(4)
"""Fields of a noise model."""
SLOW_CODES = tuple(model for model in CODE_MODELS if model[SLOW])


def _white(sds: Iterable[float]) -> tuple[tuple[float, ...], ...]:
    """Return code models of white noise with these standard deviations, steps."""
    return tuple((sd**2, 0.0, 1e9, 0.0) for sd in sds)


def _noise(
    codes: tuple[tuple[float, ...], ...] = CODE_MODELS, means: tuple[tuple[float, ...], ...] = MEAN_MODELS
) -> Change:
    """Return what replaces the models of the noise."""
    noise = NoiseModels(*np.array([*codes, *means]).T[:, :, np.newaxis])
    rows = {"NOISE": noise, "CODE": slice(0, len(codes))}
    changes = [(module, name, each) for module in (filter_module, measurement) for name, each in rows.items()]
    return [*changes, (measurement, "MEAN", slice(len(codes), None))]


def _never(*_: Any) -> bool:
    return False


def _nothing(*_: Any) -> float:
    return 0.0


def _entering_only(*given: Any) -> tuple[Correction, Correction]:
    entering, _ = evaluate(*given)
    return entering, entering


VARIANTS: dict[str, Change] = {
    "a code that stays is no evidence on slow errors": [(measurement, "RENEWAL", 0.0)],
    "no soft edges": [(measurement, "SOFT", 0.0)],
    "no code is a surprise": [(measurement, "SURPRISE", 1e-300)],
    "a code never replaces a wide prediction": [(measurement, "WIDE", 1e9)],
    "a code that does not enter does not confine the output": [(stage, "evaluate", _entering_only)],
    "the scatter of readings is no evidence": [(measurement, "_scatter", _nothing)],
    "σ of a model exact": [(measurement, "SIGMA_ERROR", 0.0)],
    "all readings independent": [(Thermometer, "independence", property(lambda _: 1.0, lambda *_: None))],
    "no repeats known by a leap": [(Thermometer, "leaps", _never)],
    "no repeats known": [(thermometer, "MOST_REPEAT_S", 0.0)],
    "7 white sigmas, not 13": _noise((*_white((0.02, 0.06, 0.12, 0.2, 0.28, 0.36, 0.45)), *SLOW_CODES)),
    "10 white sigmas, not 13": _noise((*_white(0.02 * 25.0 ** (i / 9.0) for i in range(10)), *SLOW_CODES)),
    "no code models with a slow error": _noise(tuple(model for model in CODE_MODELS if not model[SLOW])),
    "no mean models with a slow error": _noise(means=MEAN_MODELS[:1]),
    "no 1/f models": _noise(
        tuple(model for model in CODE_MODELS if not model[WALK]),
        tuple(model for model in MEAN_MODELS if not model[WALK]),
    ),
    "5 jerk PSDs, not 9": [(filter_module, "JERK_PSDS", JERK_PSDS[::2])],
    "the jerk PSD changes once in 10,000 s, not 500": [(filter_module, "CHANGE_PER_S", 1e-4)],
    "the jerk PSD changes once in 100 s, not 500": [(filter_module, "CHANGE_PER_S", 1e-2)],
    "least probability of a filter 1e-30": [(filter_module, "LEAST_PROBABILITY", 1e-30)],
    "any acceleration at the start": [(filter_module, "LONG_S", 1e30)],
    "no walk in the output": [(filter_module, "WALK_S", 0.0)],
    "mean of a slow error known": [(filter_module, "SLOW_MEAN", 0.0)],
    "edges known from the start": [(stage, "HYSTERESIS", 0.05)],
    "no ramp that may have begun": [(stage, "RAMP_S", 1e9)],
    "no output lag": [(stage, "LAG_S", 1e-3)],
    "a code is a surprise below 10 %, not 2": [(measurement, "SURPRISE", 0.1)],
    "soft below 1 sigma, not 2": [(measurement, "SOFT", 1.0)],
    "wide beyond 3 steps, not 1.5": [(measurement, "WIDE", 3.0)],
    "renewal 0.03, not 0.1": [(measurement, "RENEWAL", 0.03)],
    "memory of 16 slots, not 32": [(thermometer, "MEMORY_SLOTS", 16)],
    "memory of 64 slots, not 32": [(thermometer, "MEMORY_SLOTS", 64)],
}


def outcomes(seeds: range, data: Path) -> Iterator[Outcome]:
    """Yield the scenes, then the measured record where its folder exists."""
    yield from simulated(seeds)
    path = data / "chamber-cycle" / "cooling-heating.csv"
    if path.exists():
        yield from measured(path)


def simulated(seeds: range) -> Iterator[Outcome]:
    """Yield the simulated scenes."""
    kinds = {kind.name: kind for kind in KINDS}
    for name, what, profile, length_s, start_s in SCENES:
        runs = [errors(kinds[name], profile, length_s, seed, MultipleModelRate) for seed in seeds]
        off, z = (
            np.concatenate([run[key][run["t"] > start_s] for run in runs]) for key in ("rate", "rate_z")
        )
        yield Outcome(f"{name}, {what}", rms(off), FLOOR, rms(z), largest(z))


def measured(path: Path) -> Iterator[Outcome]:
    """Yield the chamber record at each step size, against a local cubic of the unrounded one."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    time_ns = np.round(table["t_s"] * 1e9).astype(np.int64)
    reading: FloatArray = np.asarray(table["temperature"], np.float64)
    t = (time_ns - time_ns[0]) * 1e-9
    rate, late = local_rate(t, reading), t > RECORD_SETTLED_S
    for step in STEPS_DEGC:
        rounded = step * np.round(reading / step) if step else reading
        found = MultipleModelRate().process(time_ns, np.zeros(len(rounded), np.int64), rounded)
        off = (found.rate - rate)[late]
        z = off / found.rate_sd[late]
        yield Outcome(f"chamber, steps of {step:g} °C", rms(off) * PER_HOUR, FLOOR, rms(z), largest(z))


def local_rate(t: FloatArray, reading: FloatArray) -> FloatArray:
    """Return the rate of local cubic fits to all readings within ±`HALF_S` of times in s, (n,)."""
    rate = np.empty(len(t))
    for i, now in enumerate(t):
        middle = min(max(now, HALF_S), t[-1] - HALF_S)
        a, b = np.searchsorted(t, [middle - HALF_S, middle + HALF_S])
        fit = np.polynomial.Polynomial.fit(t[a:b], reading[a:b], 3)
        rate[i] = fit.deriv()(now)
    return rate


STUDY = ablation(TITLE, VARIANTS, outcomes)
