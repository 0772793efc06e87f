"""Time of a sample in the estimators' stages and the published filters, by sampling rate."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from dense_record import dense_filter
from samples import sent
from vqf import VQF

from benchmarks.measure import Bar, Result, Table, measure
from imumon.allan.analysis import analyse, octaves, variances
from imumon.allan.series import even_channels
from imumon.allan.streaming import StreamingAllan
from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.alignment.stage import Alignment
from imumon.estimation.gyro_bias.parameters import GyroBiasParameters
from imumon.estimation.gyro_bias.stage import GyroBias, RestDetector
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.estimation.temperature_rate.output import RateMethod
from imumon.geodesy import EARTH_RATE
from imumon.papers.dense_zupt import DenseSettings
from imumon.papers.fir import FirRate, Params
from imumon.papers.linear import LinearFilter, ModelL
from imumon.papers.random_error import RandomErrorMethods
from imumon.papers.sigma_points import ModelNL, SigmaPointFilter
from imumon.run.paper_parameters import RandomErrorParameters

BLOCK_S = 10.0


@dataclass(frozen=True)
class Case:
    """What is timed, how many samples, slots or seconds are in it, and what one may cost, µs, as a bar."""

    call: Callable[[], object]
    count: float
    at_most_us: float | None = None


def section(
    title: str, unit: str, rates_hz: Sequence[int], cases: Callable[[int], Mapping[str, Case]], note: str
) -> Result:
    """Measure cases at each rate: a row a case, a column a rate, µs of one `unit`."""
    table = Table(f"{title}, us per {unit}", ["", *(f"{rate} Hz" for rate in rates_hz)], notes=[note])
    rows: dict[str, list[str]] = {}
    bars = []
    for rate in rates_hz:
        at_rate = cases(rate)
        times = measure({name: case.call for name, case in at_rate.items()})
        for name, case in at_rate.items():
            cost = times[name] / case.count / 1000
            rows.setdefault(name, []).append(f"{cost:.3f}")
            if case.at_most_us is not None:
                text = f"{title} at {rate} Hz, {name}, us per {unit}"
                bars.append(Bar(text, case.at_most_us, cost, at_most=True))
    table.rows = [[name, *cells] for name, cells in rows.items()]
    return [table], bars


def over(make: Callable[[], Any], record: SampleBlock, size: int) -> None:
    """Run a new stage over a record in blocks of so many samples."""
    stage = make()
    for start in range(0, len(record), size):
        stage.process(record.rows(start, start + size))


def resting(rate_hz: int, seconds: float, gyro: float, accel: float, **more: Any) -> SampleBlock:
    """Return a unit at rest with white noise, rad/√s and m/s/√s, and the constants and vectors beside."""
    n, rng = round(seconds * rate_hz), np.random.default_rng(0)
    turn = rng.standard_normal((n, 3)) * gyro * np.sqrt(rate_hz) + more.pop("rate", 0.0)
    force = rng.standard_normal((n, 3)) * accel * np.sqrt(rate_hz) + [0.0, 0.0, -9.8]
    columns = {name: np.full(n, value) for name, value in more.items()}
    return sent(np.arange(n) / rate_hz, gyro=turn, accel=force, **columns)


def alignment() -> Result:
    """A navigation-grade unit at rest, in long blocks and in those of a live run."""
    latitude, seconds = math.radians(36.0), 120
    north, down = EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude)

    def cases(rate: int) -> dict[str, Case]:
        record = resting(rate, seconds, 7e-8, 5e-5, rate=[north, 0.0, -down])
        make = partial(Alignment, None, 36.0, "FRD")
        return {
            f"blocks of {length:g} s": Case(
                partial(over, make, record, round(length * rate)), len(record), bar
            )
            for length, bar in ((BLOCK_S, 1.0), (0.05, None))
        }

    note = f"{seconds} s from the start on; all estimators, renewed once a second"
    return section("alignment", "sample", (100, 1000), cases, note)


def rest() -> Result:
    """A unit at rest, carried about, or turned steadily after a rest."""
    samples, slot_s = 50_000, 0.25

    def cases(rate: int) -> dict[str, Case]:
        found = {}
        t = np.arange(samples) / rate
        for name in ("at rest", "in motion", "turning"):
            values = np.random.default_rng(0).normal(0.0, 0.01, (samples, 6)) - [0, 0, 0, 0, 0, 9.8]
            if name == "turning":
                values[samples // 4 :, 2] += 0.02
            if name == "in motion":
                values += np.sin(t[:, np.newaxis] * np.arange(1, 7))
            record = sent(t, gyro=values[:, :3], accel=values[:, 3:])
            call = partial(over, RestDetector, record, round(BLOCK_S * rate))
            # 0.35 ms of the 2.5 ms that a second of data may take in a replay at 400 times real time.
            found[name] = Case(call, samples / rate / slot_s, 88.0)
        return found

    return section("rest detector", "slot", (25, 100, 1000), cases, "blocks of 10 s; 4 slots a second")


def zupt() -> Result:
    """White noise at rest, and the same marked as motion, beside the filter of 12 states."""
    seconds = 300
    known = GyroBiasParameters(angle_random_walk_rad_per_sqrt_s=8e-5, bias_instability_rad_per_s=1e-5)

    def dense(rate: int, gyro: FloatArray, accel: FloatArray) -> None:
        for _ in range(seconds // 10):
            dense_filter(DenseSettings(1.0 / rate), gyro, accel, np.zeros(3), every=rate // 10)

    def cases(rate: int) -> dict[str, Case]:
        size, n = round(BLOCK_S * rate), seconds * rate
        record = resting(rate, seconds, 8e-5, 1e-3, at_rest=1, temperature=25.0)
        moving = resting(rate, seconds, 8e-5, 1e-3, at_rest=0, temperature=25.0)
        gyro, accel = record.rows(0, 10 * rate).gyro, record.rows(0, 10 * rate).accel
        assert gyro is not None
        assert accel is not None
        return {
            "stage, standard": Case(partial(over, GyroBias, record, size), n, 0.2),
            "stage, noise known": Case(partial(over, partial(GyroBias, known), record, size), n, 0.2),
            "stage, learned": Case(partial(over, partial(GyroBias, mode="learned"), record, size), n),
            "stage, in motion": Case(partial(over, GyroBias, moving, size), n),
            "VQF with its bias, for comparison": Case(
                lambda: VQF(1.0 / rate).updateBatch(gyro, accel), 10 * rate
            ),
            "12 states, dense, ten samples to a step": Case(partial(dense, rate, gyro, accel), n),
        }

    note = f"{seconds} s in blocks of 10 s, from the start on: the first minute is filtered twice"
    return section("gyro bias", "sample of three axes", (100, 1000), cases, note)


def temperature() -> Result:
    """A sensor that warms up by 6 degC/h, with noise, read in steps of 0.05 degC; and one that stays."""
    seconds, warm_s, quiet_s = 300, 1200, 60

    def reading(rate: int, seconds: int, hours: float) -> FloatArray:
        t = np.arange(seconds * rate) / rate
        noise = np.random.default_rng(0).normal(0.0, 0.005, len(t))
        return np.asarray(np.round((25 + t / (3600 * hours) + noise) / 0.05) * 0.05)

    def run(method: RateMethod, values: FloatArray, rate: int, first: int = 0) -> None:
        time_ns = (first + np.arange(len(values))) * (1_000_000_000 // rate)
        size = round(BLOCK_S * rate)
        for start in range(0, len(values), size):
            part = slice(start, start + size)
            method.process(time_ns[part], np.zeros(len(time_ns[part]), np.int64), values[part])

    def cases(rate: int) -> dict[str, Case]:
        warming, before = reading(rate, seconds, 1 / 6), reading(rate, warm_s, 1.0)
        method = MultipleModelRate()
        run(method, before, rate)
        level = np.full(quiet_s * rate, before[-1])
        # As a stage may cost that thinks eight times a second for 150 us.
        return {
            "multiple models": Case(lambda: run(MultipleModelRate(), warming, rate), seconds, 1200.0),
            "multiple models, level unchanged": Case(
                lambda: run(deepcopy(method), level, rate, len(before)), quiet_s, 1200.0
            ),
            "FIR 300/180": Case(
                lambda: run(FirRate(Params(0.05, 300.0, 180.0, 1000)), warming, rate), seconds
            ),
        }

    note = "blocks of 10 s; the bank works once a second whatever the rate"
    return section("temperature rate", "second and channel", (10, 100, 1000), cases, note)


def random_error() -> Result:
    """The published filters on white noise, φ uncertain, and their stage in blocks of a second."""
    n, noise, delta = 10_000, 0.1103, 0.01

    def cases(rate: int) -> dict[str, Case]:
        reading = math.sqrt(noise) * np.random.default_rng(0).standard_normal(n)
        vector = np.repeat(np.radians(reading)[:, np.newaxis], 3, axis=1)
        record = sent(np.arange(n) / rate, gyro=vector, at_rest=np.ones(n))
        linear = ModelL(0.0, delta, 0.0, (0.0, 0.0), (1e-3, 1e-3), noise)
        model = ModelNL((0.0, 0.0, 0.0, delta, 0.0), (1e-3, 1e-3, 0.01, 1e-6, 1e-6), noise)
        mu = 0.5 / (2 * (noise + delta**2))
        stage = partial(RandomErrorMethods, ("sr_rsukf",), RandomErrorParameters(learn_s=10.0))
        filters: dict[str, Callable[[], Any]] = {
            "Kalman filter, model L": partial(LinearFilter, linear, None),
            "strong-tracking filter, model L": partial(LinearFilter, linear, 1.0),
            "SR-UKF, 5 states": partial(SigmaPointFilter, model, (0.0,) * 5),
            "SR-RSUKF, 5 states": partial(SigmaPointFilter, model, (mu, 0.0, 0.0, 0.0, 0.0)),
        }
        found = {name: Case(partial(_filtered, make, reading), n, 2.0) for name, make in filters.items()}
        return found | {"stage, SR-RSUKF": Case(partial(over, stage, record, rate), 3 * n)}

    note = "the stage in blocks of a second, all that it shows beside included"
    return section("random error", "sample and axis", (100,), cases, note)


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
    table = Table("Allan deviation, one hour at 400 Hz, six channels, octaves", ["step", "s"])
    table.rows = [[name, f"{time:.3f}"] for name, time in seconds.items()]
    live_ns = measure({"live": live})["live"] / live_samples
    table.notes = [f"live, in blocks of {block}: {live_ns:.0f} ns per sample and channel, 18 kB a channel"]
    grid, _, whole = seconds.values()
    return [table], [
        Bar("Allan analysis of an hour at 400 Hz, six channels, s", 1.0, grid + whole, at_most=True),
        Bar("live Allan curve, ns per sample and channel", 200.0, live_ns, at_most=True),
    ]


def _filtered(make: Callable[[], Any], reading: FloatArray) -> None:
    make().process(reading)
