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
    exponential,
    published,
    slow,
)
from random_error_records import RATE_HZ, Record, simulate
from study import Options, Study, Table, rms

from imumon.blocks import FloatArray

HOUR = 3600.0
MINUTE_SEEDS, HOUR_SEEDS, JOURNEY_SEEDS = 48, 8, 24
HOUR_FIRST, JOURNEY_FIRST = 100, 300
"""First seeds of the records of an hour and of a journey."""
TAUS_S = (0.02, 0.1, 1.0, 10.0)


def tables(given: Options) -> Iterator[Table]:
    """Yield all tables."""
    if given.quick:
        yield compensated([simulate(60.0, 0)])
        return
    minutes = [simulate(60.0, seed) for seed in range(MINUTE_SEEDS)]
    yield compensated(minutes)
    yield against_truth([simulate(HOUR, HOUR_FIRST + seed) for seed in range(HOUR_SEEDS)])
    yield journey([simulate(660.0, JOURNEY_FIRST + seed) for seed in range(JOURNEY_SEEDS)])


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
        rows.append([name, rms(whole), rms(slowly)])
    title = f"Angle error after 60 s in motion, 600 s at rest before, {len(records)} seeds, deg"
    return Table(title, ["subtracted", "rms", "of which drift"], rows, formats=("", ".3f", ".3f"))


STUDY = Study(tables, draw=draw)
