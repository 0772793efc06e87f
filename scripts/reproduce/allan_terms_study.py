"""Noise terms fitted to simulated records of 20 minutes at 50 Hz: errors in standard deviations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from study import Cells, Options, Study, Table, rms

from imumon.allan.analysis import analyse
from imumon.allan.series import even_channels
from tests.allan.simulated import noise

RATE_HZ, SAMPLES = 50, 60_000
TERMS = {
    "N": ("angle_random_walk", "white"),
    "B": ("bias_instability", "instability"),
    "K": ("rate_random_walk", "walk"),
    "Q": ("quantization", "quantization"),
    "R": ("rate_ramp", "ramp"),
}
"""Name of a term in the fit, and of the argument that simulates it."""
CASES: tuple[Mapping[str, float], ...] = (
    {"N": 1e-3},
    {"N": 1e-3, "K": 2e-4},
    {"N": 1e-3, "B": 7e-4},
    {"N": 1e-3, "B": 7e-4, "Q": 3e-4},
    {"N": 1e-3, "R": 5e-6},
    {"N": 1e-3, "B": 7e-4, "K": 1e-4},
    {"N": 1e-3, "B": 3e-4, "K": 1e-4},
    {"N": 1e-3, "B": 3e-4, "K": 3e-5},
)
HEADS = ("noise", "term", "shown", "value / truth", "mean", "rms", "within 1 sd", "within 2 sd", "others")
FORMATS = ("", "", ".0%", ".3f", ".2f", ".2f", ".0%", ".0%", ".1%")


def rows(truth: Mapping[str, float], seeds: range) -> Iterator[Cells]:
    """Yield a row for each term of a noise: how often it is shown, and its errors where it is."""
    arguments = {TERMS[letter][1]: value for letter, value in truth.items()}
    channels = {str(seed): noise(seed, SAMPLES, 1 / RATE_HZ, **arguments) for seed in seeds}
    time_ns = np.arange(SAMPLES) * (1_000_000_000 // RATE_HZ)
    results = analyse(even_channels(time_ns, np.zeros(SAMPLES, np.int64), channels)).values()
    fits = [result.fit.terms for result in results if result.fit is not None]
    others = [TERMS[letter][0] for letter in TERMS.keys() - truth.keys()]
    false = sum(terms[name] is not None for terms in fits for name in others) / len(fits)
    text = ", ".join(f"{letter} {value:g}" for letter, value in truth.items())
    for letter, value in truth.items():
        shown = [found for terms in fits if (found := terms[TERMS[letter][0]]) is not None]
        error = np.array([(found.value - value) / found.sd for found in shown])
        ratio = np.array([found.value for found in shown]) / value
        within = [float(np.mean(np.abs(error) < limit)) if shown else np.nan for limit in (1, 2)]
        means = [float(of.mean()) if shown else np.nan for of in (ratio, error)]
        yield [text, letter, len(shown) / len(fits), *means, rms(error), *within, false]


def tables(given: Options) -> Iterator[Table]:
    """Yield the fits of noise terms."""
    chosen = CASES[: 1 if given.quick else None]
    yield Table("", HEADS, [row for truth in chosen for row in rows(truth, given.seeds)], formats=FORMATS)


STUDY = Study(tables, seeds=150, first=2000)
