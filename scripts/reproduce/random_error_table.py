"""What the methods of Shi Gang et al. do to noise, drift and rotation, whatever "compensated" means."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import allantools
import numpy as np
from random_error_figures import draw
from random_error_methods import (
    DELTAS,
    PRETENDED,
    PUBLISHED,
    Output,
    default,
    exponential,
    fit_record,
    published,
    slow,
)
from random_error_records import RATE_HZ, Record, measured, simulate, without_temperature
from study import Options, Study, Table, rms

from imumon.blocks import FloatArray

HOUR = 3600.0
MINUTE_SEEDS, HOUR_SEEDS, JOURNEY_SEEDS = 48, 8, 24
HOUR_FIRST, JOURNEY_FIRST = 100, 300
"""First seeds of the records of an hour and of a journey."""
TAUS_S = (0.02, 0.1, 1.0, 10.0)
TURN, TURN_FROM, TURN_TO = 0.5, 20, 40
"""deg/s, and s: a true rotation by 10 deg."""


def tables(given: Options) -> Iterator[Table]:
    """Yield all tables."""
    if given.quick:
        yield compensated([simulate(60.0, 0)])
        return
    minutes = [simulate(60.0, seed) for seed in range(MINUTE_SEEDS)]
    yield compensated(minutes)
    yield against_truth([simulate(HOUR, HOUR_FIRST + seed) for seed in range(HOUR_SEEDS)])
    yield rotation(minutes[:4])
    yield journey([simulate(660.0, JOURNEY_FIRST + seed) for seed in range(JOURNEY_SEEDS)])
    yield on_measured(measured(given.data))


def allan(values: FloatArray, rate: float, taus: Sequence[float]) -> FloatArray:
    """Return overlapping Allan deviations at these averaging times in °/h."""
    _, deviations, _, _ = allantools.oadev(values, rate=rate, data_type="freq", taus=list(taus))
    return np.asarray(deviations) * HOUR


def compensated(records: Sequence[Record]) -> Table:
    """Allan deviations and the angle after a minute, of (a) raw less x_k|k-1 and (b) x_k|k."""
    n = len(PRETENDED)
    rows = [["raw", *[_cell([r.reading for r in records])] * n]]
    for meaning in "ab":
        for name in PUBLISHED:
            cells = []
            for delta in PRETENDED:
                outputs = [(r.reading, published(name, r.reading, delta)) for r in records]
                less = [reading - output.predicted for reading, output in outputs]
                cells.append(_cell(less if meaning == "a" else [output.estimate for _, output in outputs]))
            rows.append([f"{name} ({meaning})", *cells])
    rows.append(["exponential 1 s (b)", *[_cell([exponential(r.reading, 1.0) for r in records])] * n])
    title = "Compensated, 60 s: oadev at 0.02/0.1/1/10 s in °/h; rms angle after 60 s in deg"
    return Table(title, ["", *(f"δ¹ {delta:g}" for delta in PRETENDED)], rows)


def _cell(series: Sequence[FloatArray]) -> str:
    deviations = np.mean([allan(values, RATE_HZ, TAUS_S) for values in series], axis=0)
    angle = rms([float(np.sum(values)) / RATE_HZ for values in series])
    return "/".join(f"{value:.3g}" for value in deviations) + f", {angle:.3f}"


def against_truth(records: Sequence[Record]) -> Table:
    """Errors against the true drift over an hour, and whether the standard deviations are true."""
    methods: dict[str, Callable[[Record], Output]] = {
        f"{name}, δ¹ {delta:g}": partial(_published, name, delta)
        for delta in DELTAS
        for name in ("KF", *PUBLISHED)
    }
    methods |= {
        name: partial(slow, name) for name in ("drift", "exponential 85 s", "exponential 200 s", "hold 60 s")
    }
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


def _published(name: str, delta: float, record: Record) -> Output:
    return published(name, record.reading, delta)


def rotation(records: Sequence[Record]) -> Table:
    """What is lost of a turn by 10 deg in 20 s under (a), and the gain of slow sines under (b)."""
    rows = []
    n = len(records[0].reading)
    t = np.arange(n) / RATE_HZ
    turn = np.where((t >= TURN_FROM) & (t < TURN_TO), TURN, 0.0)
    for delta in DELTAS:
        for name in PUBLISHED:
            lost, after, gains = [], [], []
            for record in records:
                still = published(name, record.reading, delta)
                moved = published(name, record.reading + turn, delta)
                taken = moved.predicted - still.predicted
                lost.append(np.sum(taken[TURN_FROM * RATE_HZ : TURN_TO * RATE_HZ]) / RATE_HZ)
                after.append(-taken[TURN_TO * RATE_HZ + 1])
                gains.append([_gain(name, record, delta, f, still.estimate) for f in (0.1, 1.0)])
            low, high = np.mean(gains, axis=0)
            cells = [f"{np.mean(lost):.2f}", f"{np.mean(after):.2f}", f"{low:.3f}", f"{high:.3f}"]
            rows.append([f"{name}, δ¹ {delta:g}", *cells])
    lost = []
    for record in records:
        moving = Record(record.name, record.rate_hz, record.reading + turn, record.drift, record.temperature)
        rest = np.where(turn == 0.0, 1.0, 0.0)
        taken = slow("drift", moving, rest).estimate - slow("drift", record, rest).estimate
        lost.append(np.nansum(taken[TURN_FROM * RATE_HZ : TURN_TO * RATE_HZ]) / RATE_HZ)
    rows.append(["drift, told when it is at rest", f"{np.mean(lost):.2f}", "0.00", "-", "-"])
    title = "True rotation: 0.5 deg/s for 20 s, lost under (a); gain of a sine under (b)"
    heads = ["method", "lost, deg", "false rate after, deg/s", "gain at 0.1 Hz", "gain at 1 Hz"]
    return Table(title, heads, rows)


def _gain(name: str, record: Record, delta: float, hertz: float, still: FloatArray) -> float:
    t = np.arange(len(still)) / RATE_HZ
    wave = TURN * np.sin(2 * np.pi * hertz * t)
    answer = published(name, record.reading + wave, delta).estimate - still
    late = t >= 20.0
    basis = np.column_stack([np.sin(2 * np.pi * hertz * t), np.cos(2 * np.pi * hertz * t)])[late]
    return float(np.hypot(*np.linalg.lstsq(basis, answer[late], rcond=None)[0]) / TURN)


def journey(records: Sequence[Record]) -> Table:
    """What the angle errs by after a minute of motion that follows ten minutes at rest."""
    rows = []
    still = np.repeat([1.0, 0.0], [600 * RATE_HZ, 60 * RATE_HZ])
    moving = slice(600 * RATE_HZ, None)
    for name in ("nothing", "drift", "exponential 85 s", "hold 60 s", "the truth"):
        whole, slowly = [], []
        for record in records:
            known = record.drift if name == "the truth" else np.zeros(len(record.drift))
            if name not in ("nothing", "the truth"):
                known = slow(name, record, still).estimate
            whole.append(np.sum((record.reading - known)[moving]) / RATE_HZ)
            slowly.append(np.sum((record.drift - known)[moving]) / RATE_HZ)
        rows.append([name, f"{rms(whole):.3f}", f"{rms(slowly):.3f}"])
    title = f"Angle error after 60 s in motion, 600 s at rest before, {len(records)} seeds, deg"
    return Table(title, ["subtracted", "rms", "of which drift"], rows)


def on_measured(records: Sequence[Record]) -> Table:
    """Allan deviations of measured recordings: raw, without temperature, and compensated."""
    rows = []
    for record in records:
        reading = without_temperature(record)
        delta, noise = fit_record(record, reading)
        still = Record(record.name, record.rate_hz, reading, record.drift, record.temperature)
        series = [record.reading, reading, reading - np.nan_to_num(slow("drift", still).estimate)]
        outputs = [published(name, reading, delta, noise) for name in PUBLISHED]
        series += [reading - output.predicted for output in outputs]
        series += [output.estimate for output in outputs]
        taus = [m / record.rate_hz for m in (2, 10, 100)]
        cells = ["/".join(f"{v:.3g}" for v in allan(values, record.rate_hz, taus)) for values in series]
        innovations = rms(default(still)["zupt_innovation_x"])
        rows.append([record.name, f"{innovations:.2f}", f"{delta:.1e}", *cells])
    names = ["raw", "less cubic in T", "less drift", *(f"{n} {m}" for m in "ab" for n in PUBLISHED)]
    title = (
        "Measured, static: oadev at 2, 10, 100 intervals, °/h; δ¹ and R fitted to the record less the cubic"
    )
    return Table(title, ["record", "rms innovation / sd", "δ¹ deg/s", *names], rows)


STUDY = Study(tables, draw=draw)
