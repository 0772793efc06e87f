"""Noise terms fitted to simulated records of 20 minutes at 50 Hz: errors in standard deviations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from study import Options, Study, Table

from imumon.allan.analysis import analyse
from imumon.allan.fit import TERMS, Fit
from imumon.allan.series import even_channels
from tests.allan.simulated import noise

RATE_HZ, SAMPLES = 50, 60_000
ARGUMENTS = {
    "angle_random_walk": "white",
    "bias_instability": "instability",
    "rate_random_walk": "walk",
    "quantization": "quantization",
    "rate_ramp": "ramp",
}
CASES = (
    {"angle_random_walk": 1e-3},
    {"angle_random_walk": 1e-3, "rate_random_walk": 2e-4},
    {"angle_random_walk": 1e-3, "bias_instability": 7e-4},
    {"angle_random_walk": 1e-3, "bias_instability": 7e-4, "quantization": 3e-4},
    {"angle_random_walk": 1e-3, "rate_ramp": 5e-6},
    {"angle_random_walk": 1e-3, "bias_instability": 7e-4, "rate_random_walk": 1e-4},
    {"angle_random_walk": 1e-3, "bias_instability": 3e-4, "rate_random_walk": 1e-4},
    {"angle_random_walk": 1e-3, "bias_instability": 3e-4, "rate_random_walk": 3e-5},
)
LETTERS = dict(zip(ARGUMENTS, "NBKQR", strict=True))
FIRST_SEED = 2000
WHITE = 1e-3
SINES = (
    (0.05, 3e-3),
    (0.05, 3e-2),
    (0.5, 1e-3),
    (0.5, 1e-2),
    (0.5, 0.1),
    (5.03, 1e-3),
    (5.03, 1e-2),
    (5.03, 0.1),
    (1 / 300, 1e-3),
    (1 / 300, 1e-2),
)
"""Hz and rad/s of what is no noise, beside white noise."""
SINE_SEEDS = 6


HEADS = (
    "noise", "term", "shown", "value / truth", "mean", "rms", "within 1 sd", "within 2 sd", "others shown",
)  # fmt: skip
SINE_HEADS = ("Hz", "rad/s", "N reported", "value / truth", "median sd / truth", "other terms reported")


def tables(given: Options) -> Iterator[Table]:
    """Yield the fits of noise terms, and those of white noise beside a sine."""
    rows = []
    for truth in CASES[: 1 if given.quick else None]:
        fits = _fits(truth, len(given.seeds))
        false = sum(
            fit.terms[term] is not None for fit in fits for term in TERMS if term not in truth
        )
        for name, value in truth.items():
            rows.append([_text(truth), LETTERS[name], *_row(fits, name, value), f"{false / len(fits):.1%}"])
    yield Table("", HEADS, rows)
    seeds = min(len(given.seeds), SINE_SEEDS)
    yield Table("", SINE_HEADS, [_sine(*sine, seeds) for sine in SINES[: 1 if given.quick else None]])


def _sine(hertz: float, size: float, seeds: int) -> list[str]:
    """Return what is reported of white noise beside a sine."""
    t = np.arange(SAMPLES) / RATE_HZ
    channels = {
        str(seed): noise(seed, SAMPLES, 1 / RATE_HZ, white=WHITE)
        + size * np.sin(2 * np.pi * hertz * t + seed)
        for seed in range(seeds)
    }
    time_ns = np.arange(SAMPLES) * (1_000_000_000 // RATE_HZ)
    series = even_channels(time_ns, np.zeros(SAMPLES, np.int64), channels)
    fits = [result.fit for result in analyse(series).values() if result.fit is not None]
    found = [estimate for fit in fits if (estimate := fit.terms["angle_random_walk"]) is not None]
    others = sum(value is not None for fit in fits for value in fit.terms.values()) - len(found)
    ratios = [estimate.value / WHITE for estimate in found]
    spread = f"{np.median([estimate.sd for estimate in found]) / WHITE:.3f}" if found else "-"
    span = f"{min(ratios):.3f} to {max(ratios):.3f}" if found else "-"
    return [f"{hertz:.3g}", f"{size:g}", f"{len(found)} of {len(fits)}", span, spread, str(others)]


def _fits(truth: dict[str, float], seeds: int) -> list[Fit]:
    arguments = {ARGUMENTS[name]: value for name, value in truth.items()}
    time_ns = np.arange(SAMPLES) * (1_000_000_000 // RATE_HZ)
    channels = {
        str(seed): noise(FIRST_SEED + seed, SAMPLES, 1 / RATE_HZ, **arguments) for seed in range(seeds)
    }
    results = analyse(even_channels(time_ns, np.zeros(SAMPLES, np.int64), channels))
    return [result.fit for result in results.values() if result.fit is not None]


def _row(fits: list[Fit], name: str, value: float) -> list[str]:
    shown = [estimate for fit in fits if (estimate := fit.terms[name]) is not None]
    if not shown:
        return ["0", *["-"] * 5]
    errors = np.array([(estimate.value - value) / estimate.sd for estimate in shown])
    ratio = np.mean([estimate.value for estimate in shown]) / value
    return [
        f"{len(shown) / len(fits):.0%}",
        f"{ratio:.3f}",
        f"{errors.mean():.2f}",
        f"{np.sqrt(np.mean(errors**2)):.2f}",
        f"{np.mean(np.abs(errors) < 1):.0%}",
        f"{np.mean(np.abs(errors) < 2):.0%}",
    ]


def _text(truth: dict[str, float]) -> str:
    return ", ".join(f"{LETTERS[name]} {value:g}" for name, value in truth.items())


STUDY = Study(tables, seeds=150)
