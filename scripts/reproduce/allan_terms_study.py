"""Noise terms fitted to simulated records of 20 minutes at 50 Hz: errors in standard deviations."""

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.signal import butter, lfilter
from study import Cells, Options, Study, Table, rms

from imumon.allan.analysis import analyse
from imumon.allan.fit import Fit
from imumon.allan.series import even_channels
from imumon.blocks import FloatArray
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
FILTERED = (CASES[0], CASES[-1])
"""What stands behind a filter."""
WHITE = 1e-3
SETTLED = 4000
"""Samples after which a filter has forgotten where it began."""
MOST_SEEDS, SINE_SEEDS = 24, 6


def first_order(time_constant_s: float) -> tuple[FloatArray, FloatArray]:
    """Return numerator and denominator of a first-order low-pass filter."""
    kept = float(np.exp(-1.0 / (RATE_HZ * time_constant_s)))
    return np.array([1.0 - kept]), np.array([1.0, -kept])


FILTERS: dict[str, tuple[FloatArray, FloatArray]] = {
    **{f"mean of {n} samples": (np.full(n, 1.0 / n), np.ones(1)) for n in (2, 4, 8, 32)},
    **{f"first order, {tau:g} s": first_order(tau) for tau in (0.02, 0.1)},
    **{f"Butterworth, {hz:g} Hz": butter(2, hz, fs=RATE_HZ) for hz in (5.0, 2.0)},
}
"""Numerator and denominator of low-pass filters of the device."""
SINES = (
    (0.05, 3e-3), (0.05, 3e-2), (0.5, 1e-3), (0.5, 1e-2), (0.5, 1e-1),
    (5.0, 1e-3), (5.0, 1e-2), (5.0, 1e-1), (1 / 300, 1e-3), (1 / 300, 1e-2),
)  # fmt: skip
"""Hz and rad/s of what is no noise, beside white noise."""
HEADS = ("noise", "term", "shown", "value / truth", "mean", "rms", "within 1 sd", "within 2 sd", "others")
FORMATS = ("", "", ".0%", ".3f", ".2f", ".2f", ".0%", ".0%", ".1%")


DISTURBED_HEADS = ("disturbance", "noise", "N shown", "value / truth", "sd / value", "rms", "max", "others")
DISTURBED_FORMATS = ("", "", ".0%", ".3f", ".1%", ".1f", ".1f", ".0f")


def fitted(records: list[FloatArray]) -> list[Fit]:
    """Return the fit of each record."""
    time_ns = np.arange(SAMPLES) * (1_000_000_000 // RATE_HZ)
    channels = {str(row): values for row, values in enumerate(records)}
    results = analyse(even_channels(time_ns, np.zeros(SAMPLES, np.int64), channels)).values()
    return [result.fit for result in results if result.fit is not None]


def disturbed(name: str, text: str, fits: list[Fit]) -> Cells:
    """Return what is reported of the angle random walk, and how many other terms."""
    found = [term for fit in fits if (term := fit.terms["angle_random_walk"]) is not None]
    others = sum(term is not None for fit in fits for term in fit.terms.values()) - len(found)
    if not found:
        return [name, text, 0.0, *[np.nan] * 4, others]
    value, sd = (np.array([getattr(term, key) for term in found]) for key in ("value", "sd"))
    z = (value - WHITE) / sd
    share = len(found) / len(fits)
    return [name, text, share, value.mean() / WHITE, np.median(sd / value), rms(z), np.abs(z).max(), others]


def behind_filters(seeds: range) -> Iterator[Cells]:
    """Yield a row for each low-pass filter and noise."""
    for name, kernel in FILTERS.items():
        for truth in FILTERED:
            arguments = {TERMS[letter][1]: value for letter, value in truth.items()}
            records = [noise(seed, SETTLED + SAMPLES, 1 / RATE_HZ, **arguments) for seed in seeds]
            fits = fitted([np.asarray(lfilter(*kernel, record))[SETTLED:] for record in records])
            yield disturbed(name, ", ".join(f"{letter} {value:g}" for letter, value in truth.items()), fits)


def beside_sines(seeds: range) -> Iterator[Cells]:
    """Yield a row for each sine that is added to white noise."""
    t = np.arange(SAMPLES) / RATE_HZ
    for hz, size in SINES:
        waves = [size * np.sin(2 * np.pi * hz * t + seed) for seed in seeds]
        records = [noise(seed, SAMPLES, 1 / RATE_HZ, white=WHITE) for seed in seeds]
        fits = fitted([record + wave for record, wave in zip(records, waves, strict=True)])
        yield disturbed(f"sine, {hz:.3g} Hz, {size:g} rad/s", f"N {WHITE:g}", fits)


def rows(truth: Mapping[str, float], seeds: range) -> Iterator[Cells]:
    """Yield a row for each term of a noise: how often it is shown, and its errors where it is."""
    arguments = {TERMS[letter][1]: value for letter, value in truth.items()}
    fits = [fit.terms for fit in fitted([noise(seed, SAMPLES, 1 / RATE_HZ, **arguments) for seed in seeds])]
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
    if not given.quick:
        more = [*behind_filters(given.seeds[:MOST_SEEDS]), *beside_sines(range(SINE_SEEDS))]
        yield Table("", DISTURBED_HEADS, more, formats=DISTURBED_FORMATS)


STUDY = Study(tables, seeds=150, first=2000)
