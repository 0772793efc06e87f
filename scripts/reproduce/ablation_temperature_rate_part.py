"""Ablations of the temperature rate: kinds of thermometers, and a measured record at four step sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from ablation_outcome import Outcome
from temperature_rate_records import PER_HOUR, centred
from thermometer_kinds import KINDS, Profile, constant, drifting, ramp, thermostat
from thermometers_table import errors, largest, rms

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate import thermometer
from imumon.estimation.temperature_rate.model import CODE_MODELS, MEAN_MODELS, Params, code_model
from imumon.estimation.temperature_rate.stage import MultipleModelRate

TITLE = (
    "Rate of temperature: kinds of thermometers, and a measured record in steps of 0, 1/16, 0.5 and 1 °C."
    "  The outlier rule is for none of these scenes: without it a thermometer that reads 85 °C for 10 s from"
    " power-on has a rate that errs by 502 °C/h instead of 4.6 (`field --part surprises`)."
)
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
    ("0.05 °C, 2 Hz stream, 0.3 step", "thermostat", thermostat(1.0, 900.0, 40.0), 5400.0, 1800.0),
    ("no steps, white 0.02 °C", "2 °C/min", ramp(300.0), 600.0, 320.0),
]
STEPS_DEGC = (0.0, 0.0625, 0.5, 1.0)

PARAMS = Params()
VARIANTS: dict[str, Params | dict[str, float]] = {
    "a code that stays is no evidence on slow errors": replace(PARAMS, renewal=0.0),
    "no soft edges": replace(PARAMS, soft=0.0),
    "no code is a surprise": replace(PARAMS, surprise=1e-300),
    "a code never replaces a wide prediction": replace(PARAMS, wide=1e9),
    "σ of a model exact": replace(PARAMS, spacing=0.0),
    "7 white sigmas, not 13": replace(
        PARAMS,
        code_models=(
            *(code_model(w) for w in (0.02, 0.06, 0.12, 0.2, 0.28, 0.36, 0.45)),
            *(model for model in CODE_MODELS if model.slow_variance),
        ),
    ),
    "no code models with a slow error": replace(
        PARAMS, code_models=tuple(model for model in CODE_MODELS if not model.slow_variance)
    ),
    "no mean models with a slow error": replace(PARAMS, mean_models=MEAN_MODELS[:1]),
    "no 1/f models": replace(
        PARAMS,
        code_models=tuple(model for model in CODE_MODELS if not model.walk_per_s),
        mean_models=tuple(model for model in MEAN_MODELS if not model.walk_per_s),
    ),
    "5 jerk PSDs, not 9": replace(PARAMS, jerk_psds=PARAMS.jerk_psds[::2]),
    "the jerk PSD changes once in 10,000 s, not 500": replace(PARAMS, change_per_s=1e-4),
    "the jerk PSD changes once in 100 s, not 500": replace(PARAMS, change_per_s=1e-2),
    "no ramp that may have begun": replace(PARAMS, memory_s=1e9),
    "no output lag": replace(PARAMS, output_lag_s=1e-3),
    "10 white sigmas, not 13": replace(
        PARAMS,
        code_models=(
            *(code_model(0.02 * 25.0 ** (i / 9.0)) for i in range(10)),
            *(model for model in CODE_MODELS if model.slow_variance),
        ),
    ),
    "a code is a surprise below 10 %, not 2": replace(PARAMS, surprise=0.1),
    "soft below 1 sigma, not 2": replace(PARAMS, soft=1.0),
    "wide beyond 3 steps, not 1.5": replace(PARAMS, wide=3.0),
    "renewal 0.03, not 0.1": replace(PARAMS, renewal=0.03),
    "no outlier rule for ρ and the scatter": {"OUTLIER": 1e9},
    "memory of 16 slots, not 32": {"MEMORY": 1.0 / 16.0},
    "memory of 64 slots, not 32": {"MEMORY": 1.0 / 64.0},
}
CONSTANTS = {"OUTLIER": thermometer.OUTLIER, "MEMORY": thermometer.MEMORY}
"""Of the module `thermometer`; a variant may change them."""


def outcomes(change: object, seeds: range, data: Path) -> Iterator[Outcome]:
    """Yield the scenes, then the measured record where its folder exists."""
    params = change if isinstance(change, Params) else PARAMS
    for name, value in CONSTANTS.items():
        setattr(thermometer, name, change.get(name, value) if isinstance(change, dict) else value)
    kinds = {kind.name: kind for kind in KINDS}
    for name, what, profile, length_s, start_s in SCENES:
        runs = [
            errors(kinds[name], profile, length_s, seed, lambda: MultipleModelRate(params=params))
            for seed in seeds
        ]
        off, z = (
            np.concatenate([run[key][run["t"] > start_s] for run in runs]) for key in ("rate", "rate_z")
        )
        yield Outcome(f"{name}, {what}", rms(off), FLOOR, rms(z), largest(z))
    path = data / "chamber-cycle" / "cooling-heating.csv"
    if path.exists():
        yield from measured(params, path)


def measured(params: Params, path: Path) -> Iterator[Outcome]:
    """Yield the chamber record at each step size, against a local cubic of the unrounded one."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    time_ns = np.round(table["t_s"] * 1e9).astype(np.int64)
    reading: FloatArray = np.asarray(table["temperature"], np.float64)
    _, rate = centred(time_ns, reading, HALF_S)
    late = (time_ns - time_ns[0]) * 1e-9 > RECORD_SETTLED_S
    for step in STEPS_DEGC:
        rounded = step * np.round(reading / step) if step else reading
        method = MultipleModelRate(params=params)
        found = method.process(time_ns, np.zeros(len(rounded), np.int64), rounded)
        off = (found.rate - rate)[late]
        z = off / found.rate_sd[late]
        yield Outcome(f"chamber, steps of {step:g} °C", rms(off) * PER_HOUR, FLOOR, rms(z), largest(z))
