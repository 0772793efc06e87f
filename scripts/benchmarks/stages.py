"""Time of a sample in the gyro bias, the published filters and the Allan analysis.

What the other stages cost is in the section `replay`, a row each.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from dense_record import dense_filter
from samples import sent
from study import Table
from vqf import VQF

from benchmarks.measure import Bar, Result, measure
from imumon.allan.analysis import analyse, variances
from imumon.allan.live import StreamingAllan
from imumon.allan.series import even_channels, octaves
from imumon.blocks import SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.papers.dense_zupt import DenseSettings
from imumon.papers.random_error import RandomErrorMethods
from imumon.papers.shi_filters import LinearFilter, Model, SigmaPointFilter
from imumon.run.setup import RandomErrorParameters

RATE_HZ = 100
BLOCK = 10 * RATE_HZ
Cases = Mapping[str, tuple[Callable[[], object], float]]
"""What is timed, and how many samples are in it."""


def microseconds(cases: Cases) -> dict[str, float]:
    """Return the time of a sample, µs."""
    times = measure({name: call for name, (call, _) in cases.items()})
    return {name: 1e-3 * times[name] / count for name, (_, count) in cases.items()}


def over(make: Callable[[], Any], record: SampleBlock, size: int = BLOCK) -> None:
    """Run a new stage over a record in blocks of so many samples."""
    stage = make()
    for start in range(0, len(record), size):
        stage.process(record.rows(start, start + size))


def zupt() -> Result:
    """White noise at rest: the stage beside VQF with its bias, and the filter of 12 states."""
    n, rng = 300 * RATE_HZ, np.random.default_rng(0)
    gyro = rng.standard_normal((n, 3)) * 8e-5 * math.sqrt(RATE_HZ)
    accel = rng.standard_normal((n, 3)) * 1e-3 * math.sqrt(RATE_HZ) + [0.0, 0.0, -9.8]
    constants = {"at_rest": np.ones(n), "temperature": np.full(n, 25.0)}
    record = sent(np.arange(n) / RATE_HZ, gyro=gyro, accel=accel, **constants)
    dense = partial(dense_filter, DenseSettings(1.0 / RATE_HZ), gyro, accel, np.zeros(3), every=10)
    given = GyroBiasParameters(assume_at_rest=True)
    cost = microseconds(
        {
            "stage, standard": (partial(over, partial(RestAndBias, given), record), n),
            "stage, learned": (partial(over, partial(RestAndBias, given, mode="learned"), record), n),
            "VQF with its bias, for comparison": (lambda: VQF(1.0 / RATE_HZ).updateBatch(gyro, accel), n),
            "12 states, dense, ten samples to a step": (dense, n),
        }
    )
    note = "300 s at 100 Hz in blocks of 10 s, from the start on: the first minute is filtered twice."
    table = Table("## Gyro bias", ["", "µs per sample of three axes"], [*cost.items()], note, ("", ".3f"))
    return [table], []


def random_error() -> Result:
    """The published filters on white noise, φ uncertain, and their stage in blocks of a second."""
    n, noise, delta = 10_000, 0.1103, 0.01
    reading = math.sqrt(noise) * np.random.default_rng(0).standard_normal(n)
    vector = np.repeat(np.radians(reading)[:, np.newaxis], 3, axis=1)
    record = sent(np.arange(n) / RATE_HZ, gyro=vector, at_rest=np.ones(n))
    linear = Model((0.0, 0.0, 0.0, delta, 0.0), (1e-3, 1e-3, 0.0, 0.0, 0.0), noise)
    model = Model((0.0, 0.0, 0.0, delta, 0.0), (1e-3, 1e-3, 0.01, 1e-6, 1e-6), noise)
    risk = 0.5 / (2 * (noise + delta**2))
    stage = partial(RandomErrorMethods, ("sr_rsukf",), RandomErrorParameters(learn_s=10.0))
    cost = microseconds(
        {
            "Kalman filter, model L": (lambda: LinearFilter(linear).process(reading), n),
            "strong-tracking filter, model L": (lambda: LinearFilter(linear, 1.0).process(reading), n),
            "SR-UKF, 5 states": (lambda: SigmaPointFilter(model).process(reading), n),
            "SR-RSUKF, 5 states": (lambda: SigmaPointFilter(model, risk).process(reading), n),
            "stage, SR-RSUKF": (partial(over, stage, record, RATE_HZ), 3 * n),
        }
    )
    note = "The stage in blocks of a second, all that it shows beside included."
    table = Table("## Random error", ["", "µs per sample and axis"], [*cost.items()], note, ("", ".3f"))
    return [table], [Bar("SR-RSUKF, us per sample", 2.0, cost["SR-RSUKF, 5 states"], at_most=True)]


def allan() -> Result:
    """Six channels of white noise for an hour: deviations alone, with intervals and terms, and live."""
    rate, live_samples, block = 400, 40_000, 40
    n, rng = rate * 3600, np.random.default_rng(0)
    time_ns, segment = np.arange(n) * (1_000_000_000 // rate), np.zeros(n, np.int64)
    channels = {str(row): rng.normal(size=n) for row in range(6)}
    series = even_channels(time_ns, segment, channels)

    def live() -> None:
        channel = StreamingAllan()
        for start in range(0, live_samples, block):
            part = slice(start, start + block)
            channel.process(time_ns[part], segment[part], channels["0"][part])

    names: dict[str, Callable[[], object]] = {
        "gaps found, even grid": lambda: even_channels(time_ns, segment, channels),
        "overlapping Allan, modified, Hadamard": lambda: [variances(c, octaves(c)) for c in series.values()],
        "the same with intervals and terms": lambda: analyse(series),
    }
    seconds = {name: time * 1e-9 for name, time in measure(names, rounds=5).items()}
    live_ns = measure({"live": live})["live"] / live_samples
    note = f"live, in blocks of {block}: {live_ns:.0f} ns per sample and channel, 18 kB a channel"
    title = "## Allan deviation, one hour at 400 Hz, six channels, octaves"
    table = Table(title, ["step", "s"], [*seconds.items()], note, ("", ".3f"))
    grid, _, whole = seconds.values()
    return [table], [
        Bar("Allan analysis of an hour at 400 Hz, six channels, s", 1.0, grid + whole, at_most=True),
        Bar("live Allan curve, ns per sample and channel", 200.0, live_ns, at_most=True),
    ]
