"""Noise terms fitted to simulated records of 20 minutes at 50 Hz: errors in standard deviations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import butter, lfilter
from study import Options, Study, Table

from imumon.allan.analysis import analyse
from imumon.allan.fit import TERMS, Fit
from imumon.allan.series import even_channels
from imumon.blocks import FloatArray
from tests.allan.simulated import noise

RATE_HZ, SAMPLES = 50, 60_000


def first_order(time_constant_s: float) -> tuple[FloatArray, FloatArray]:
    """Return numerator and denominator of a first-order low-pass filter."""
    kept = float(np.exp(-1.0 / (RATE_HZ * time_constant_s)))
    return np.array([1.0 - kept]), np.array([1.0, -kept])


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
FILTERED = (CASES[0], CASES[-1])
"""What stands behind a filter."""
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
SETTLED = 4000
"""Samples after which a filter has forgotten where it began."""
FILTERS: dict[str, tuple[FloatArray, FloatArray]] = {
    "mean of 2 samples": (np.full(2, 0.5), np.ones(1)),
    "mean of 4 samples": (np.full(4, 0.25), np.ones(1)),
    "mean of 8 samples": (np.full(8, 0.125), np.ones(1)),
    "mean of 32 samples": (np.full(32, 1 / 32), np.ones(1)),
    "first order, 0.02 s": first_order(0.02),
    "first order, 0.1 s": first_order(0.1),
    "Butterworth, 5 Hz": butter(2, 5.0, fs=RATE_HZ),
    "Butterworth, 2 Hz": butter(2, 2.0, fs=RATE_HZ),
}
"""Numerator and denominator of low-pass filters of the device."""
FILTER_SEEDS = 24


HEADS = (
    "noise", "term", "shown", "value / truth", "mean", "rms", "within 1 sd", "within 2 sd", "others shown",
)  # fmt: skip
FILTER_HEADS = ("filter", "noise", "N reported", "value / truth", "median sd / value", "rms", "largest")
SINE_HEADS = ("Hz", "rad/s", "N reported", "value / truth", "median sd / truth", "other terms reported")


def tables(given: Options) -> Iterator[Table]:
    """Yield the fits of noise terms, and those of white noise beside a sine."""
    rows = []
    for truth in CASES[: 1 if given.quick else None]:
        fits = _fits(truth, len(given.seeds))
        false = sum(fit.terms[term] is not None for fit in fits for term in TERMS if term not in truth)
        for name, value in truth.items():
            rows.append([_text(truth), LETTERS[name], *_row(fits, name, value), f"{false / len(fits):.1%}"])
    yield Table("", HEADS, rows)
    seeds = min(len(given.seeds), SINE_SEEDS)
    yield Table("", SINE_HEADS, [_sine(*sine, seeds) for sine in SINES[: 1 if given.quick else None]])
    seeds = min(len(given.seeds), FILTER_SEEDS)
    names = list(FILTERS)[: 1 if given.quick else None]
    yield Table("", FILTER_HEADS, [_filtered(name, truth, seeds) for name in names for truth in FILTERED])


def _filtered(name: str, truth: dict[str, float], seeds: int) -> list[str]:
    """Return what is reported of the angle random walk behind a low-pass filter."""
    arguments = {ARGUMENTS[term]: value for term, value in truth.items()}
    records = [noise(FIRST_SEED + s, SETTLED + SAMPLES, 1 / RATE_HZ, **arguments) for s in range(seeds)]
    fits = _fits_of([np.asarray(lfilter(*FILTERS[name], record))[SETTLED:] for record in records])
    found = [estimate for fit in fits if (estimate := fit.terms["angle_random_walk"]) is not None]
    errors = np.array([(estimate.value - WHITE) / estimate.sd for estimate in found])
    return [
        name,
        _text(truth),
        f"{len(found)} of {len(fits)}",
        f"{np.mean([estimate.value for estimate in found]) / WHITE:.3f}",
        f"{np.median([estimate.sd / estimate.value for estimate in found]):.1%}",
        f"{np.sqrt(np.mean(errors**2)):.1f}",
        f"{np.abs(errors).max():.1f}",
    ]


def _sine(hertz: float, size: float, seeds: int) -> list[str]:
    """Return what is reported of white noise beside a sine."""
    t = np.arange(SAMPLES) / RATE_HZ
    fits = _fits_of(
        [
            noise(seed, SAMPLES, 1 / RATE_HZ, white=WHITE) + size * np.sin(2 * np.pi * hertz * t + seed)
            for seed in range(seeds)
        ]
    )
    found = [estimate for fit in fits if (estimate := fit.terms["angle_random_walk"]) is not None]
    others = sum(value is not None for fit in fits for value in fit.terms.values()) - len(found)
    ratios = [estimate.value / WHITE for estimate in found]
    spread = f"{np.median([estimate.sd for estimate in found]) / WHITE:.3f}" if found else "-"
    span = f"{min(ratios):.3f} to {max(ratios):.3f}" if found else "-"
    return [f"{hertz:.3g}", f"{size:g}", f"{len(found)} of {len(fits)}", span, spread, str(others)]


def _fits(truth: dict[str, float], seeds: int) -> list[Fit]:
    arguments = {ARGUMENTS[name]: value for name, value in truth.items()}
    return _fits_of([noise(FIRST_SEED + s, SAMPLES, 1 / RATE_HZ, **arguments) for s in range(seeds)])


def _fits_of(records: list[FloatArray]) -> list[Fit]:
    time_ns = np.arange(SAMPLES) * (1_000_000_000 // RATE_HZ)
    channels = {str(row): values for row, values in enumerate(records)}
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
