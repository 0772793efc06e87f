"""What the methods of Shi Gang et al. do to noise, drift and rotation, whatever "compensated" means."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import allantools
import numpy as np
from samples import sent
from scipy.signal import butter, lfilter
from study import Options, Study, Table, rms

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.filters.slots import SlotGatherer
from imumon.papers.local_level import SLOT_S, ExponentialMean, RestMean, RestMeans
from imumon.papers.shi_filters import LinearFilter, Model, SigmaPointFilter

RATE_HZ = 100
WHITE_HZ, LOW_PASS_HZ = 1000, 40.0
WHITE = 0.05
"""deg/s/√Hz, one-sided."""
FLICKER, FLICKER_TAUS_S = 12.0 / 3600.0, (1.0, 10.0, 100.0, 1e3, 1e4)
"""deg/s of each Gauss-Markov process, and their time constants."""
VARIANCE = 0.1103
"""(deg/s)² of a sample."""
HOUR = 3600.0
DELTAS = (3.9e-5, 1e-3, 1e-2)
"""δ¹ in deg/s: the first is that of a local level fitted to hours, the others are pretended."""
PRETENDED = (*DELTAS, 0.1)
PUBLISHED = ("STF", "SR-UKF", "SR-RSUKF 0.5", "SR-RSUKF 0.95")
MINUTE_SEEDS, HOUR_SEEDS, JOURNEY_SEEDS = range(48), range(100, 108), range(300, 324)
TAUS_S = (0.02, 0.1, 1.0, 10.0)
REST_S, MOTION_S = 600, 60
"""Of a journey."""


def means_of(time_ns: IntArray, reading: FloatArray) -> list[RestMean]:
    """Return the means of a recording at rest, reading (n,) in rad/s, NaN where it is not."""
    gatherer = SlotGatherer(1, round(SLOT_S * 1e9))
    slots = gatherer.process(time_ns, np.zeros(len(time_ns), np.int64), reading[:, np.newaxis])
    return [row[0] for row in RestMeans().process(slots)]


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Readings and the true drift in them, (n,), deg/s."""

    reading: FloatArray
    drift: FloatArray


class Output(NamedTuple):
    """What a method predicts and estimates, and its standard deviation, (n,) each, deg/s."""

    predicted: FloatArray
    estimate: FloatArray
    sd: FloatArray


def simulate(seconds: float, seed: int) -> Record:
    """Return MTi-28A noise at rest: white noise through a low-pass, and flicker that starts at zero."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE_HZ)
    every = WHITE_HZ // RATE_HZ
    b, a = butter(2, LOW_PASS_HZ, fs=WHITE_HZ)
    lead = 100 * every
    fast = WHITE * np.sqrt(WHITE_HZ / 2) * rng.standard_normal(n * every + lead)
    drift = np.zeros(n)
    for tau_s in FLICKER_TAUS_S:
        decay = np.exp(-1.0 / (tau_s * RATE_HZ))
        drive = FLICKER * np.sqrt(1 - decay**2) * rng.standard_normal(n)
        drift += lfilter([1.0], [1.0, -decay], drive)
    return Record(lfilter(b, a, fast)[lead::every][:n] + drift, drift)


def published(name: str, delta: float, record: Record) -> Output:
    """Run a method of the paper, or the plain Kalman filter on model L as "KF"."""
    reading = record.reading
    start, spread = float(np.mean(reading[:RATE_HZ])), (0.1 * delta) ** 2
    variances = (VARIANCE / 100, VARIANCE / 100, 0.01, spread, spread)
    model = Model((start, start, 0.0, delta, 0.0), variances, VARIANCE)
    if name in ("STF", "KF"):
        found = LinearFilter(model, 1.0 if name == "STF" else np.inf).process(reading)
        return Output(found.predicted, found.estimate, found.sd)
    risk = float(name.split()[1]) if " " in name else 0.0
    mu = risk / (2 * (VARIANCE + delta**2))
    result = SigmaPointFilter(model, mu).process(reading)
    return Output(result.predicted, result.estimate, result.sd)


def slow(name: str, rest: FloatArray, record: Record) -> Output:
    """Run "drift" (the default estimate of the bias), "exponential 85 s" and the like, or "hold 60 s".

    rest (n,) is 1 where the unit rests.
    """
    n = len(record.reading)
    time_s = np.arange(n) / RATE_HZ
    if name == "drift":
        gyro = np.repeat(np.radians(record.reading)[:, np.newaxis], 3, axis=1)
        added = RestAndBias(GyroBiasParameters(assume_at_rest=True)).process(
            sent(time_s, at_rest=rest, gyro=gyro)
        )
        values, sd = (np.degrees(added[f"gyro_random_error{part}_x"]) for part in ("", "_sd"))
        return Output(values, values, sd)
    time_ns = np.rint(time_s * 1e9).astype(np.int64)
    means = means_of(time_ns, np.where(rest > 0, record.reading, np.nan))
    kind, seconds, _ = name.split()
    mean = ExponentialMean(np.inf, float(seconds)) if kind == "hold" else ExponentialMean(float(seconds))
    values = np.array([mean.step(new) for new in means])
    shown = np.append(np.nan, values)[np.minimum(time_ns // 1_000_000_000, len(values))]
    return Output(shown, shown, np.full(n, np.nan))


def compensated(records: Sequence[Record]) -> Table:
    """Allan deviations and the angle after a minute, of (a) raw less x_k|k-1 and (b) x_k|k."""
    n = len(PRETENDED)
    rows = [["raw", *[_cell([r.reading for r in records])] * n]]
    for meaning in "ab":
        for name in PUBLISHED:
            cells = []
            for delta in PRETENDED:
                outputs = [published(name, delta, r) for r in records]
                less = [r.reading - output.predicted for r, output in zip(records, outputs, strict=True)]
                cells.append(_cell(less if meaning == "a" else [output.estimate for output in outputs]))
            rows.append([f"{name} ({meaning})", *cells])
    smooth = []
    for r in records:
        start = float(np.mean(r.reading[:RATE_HZ]))
        smooth.append(lfilter([1.0 / RATE_HZ], [1.0, 1.0 / RATE_HZ - 1.0], r.reading - start) + start)
    rows.append(["exponential 1 s (b)", *[_cell(smooth)] * n])
    title = "Compensated, 60 s: oadev at 0.02/0.1/1/10 s in °/h; rms angle after 60 s in deg"
    return Table(title, ["", *(f"δ¹ {delta:g}" for delta in PRETENDED)], rows)


def _cell(series: Sequence[FloatArray]) -> str:
    found = [allantools.oadev(values, RATE_HZ, "freq", list(TAUS_S))[1] for values in series]
    angle = rms([float(np.sum(values)) / RATE_HZ for values in series])
    return "/".join(f"{value:.3g}" for value in np.mean(found, axis=0) * HOUR) + f", {angle:.3f}"


def against_truth(records: Sequence[Record]) -> Table:
    """Errors against the true drift over an hour, and whether the standard deviations are true."""
    methods: dict[str, Callable[[Record], Output]] = {
        f"{name}, δ¹ {delta:g}": partial(published, name, delta)
        for delta in DELTAS
        for name in ("KF", *PUBLISHED)
    }
    for name in ("drift", "exponential 85 s", "exponential 200 s", "hold 60 s"):
        methods[name] = partial(slow, name, np.ones(len(records[0].reading)))
    rows = []
    late = slice(60 * RATE_HZ, None)
    for name, method in methods.items():
        outputs = [(method(record), record.drift) for record in records]
        errors = [rms((output.estimate - drift)[late]) * HOUR for output, drift in outputs]
        normalised = rms(np.concatenate([((o.estimate - drift) / o.sd)[late] for o, drift in outputs]))
        sd = "-" if np.isnan(normalised) else f"{normalised:.2f}"
        rows.append([name, f"{rms(errors):.1f}", f"{min(errors):.0f} to {max(errors):.0f}", sd])
    title = f"Against the true drift, 1 h after the first minute, {len(records)} seeds"
    return Table(title, ["method", "rms °/h", "of seeds", "rms error / sd"], rows)


def journey(records: Sequence[Record]) -> Table:
    """What the angle errs by after a minute of motion that follows ten minutes at rest."""
    rows = []
    still = np.repeat([1.0, 0.0], [REST_S * RATE_HZ, MOTION_S * RATE_HZ])
    moving = slice(REST_S * RATE_HZ, None)
    for name in ("nothing", "drift", "exponential 85 s", "hold 60 s", "the truth"):
        whole, slowly = [], []
        for record in records:
            known = record.drift if name == "the truth" else np.zeros(len(record.drift))
            if name not in ("nothing", "the truth"):
                known = slow(name, still, record).estimate
            whole.append(np.sum((record.reading - known)[moving]) / RATE_HZ)
            slowly.append(np.sum((record.drift - known)[moving]) / RATE_HZ)
        rows.append([name, rms(whole), rms(slowly)])
    title = f"Angle error after 60 s in motion, 600 s at rest before, {len(records)} seeds, deg"
    return Table(title, ["subtracted", "rms", "of which drift"], rows, formats=("", ".3f", ".3f"))


def tables(given: Options) -> Iterator[Table]:
    """Yield all tables."""
    if given.quick:
        yield compensated([simulate(60.0, 0)])
        return
    yield compensated([simulate(60.0, seed) for seed in MINUTE_SEEDS])
    yield against_truth([simulate(HOUR, seed) for seed in HOUR_SEEDS])
    yield journey([simulate(float(REST_S + MOTION_S), seed) for seed in JOURNEY_SEEDS])


STUDY = Study(tables)
