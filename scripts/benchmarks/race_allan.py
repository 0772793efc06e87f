"""Allan deviations of one record by imumon and by allantools, at the same averaging times."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from benchmarks.measure import Table, measure
from benchmarks.peers import faster, named
from imumon.allan.analysis import octaves, variances
from imumon.allan.covariance import Kind
from imumon.allan.series import even_channels
from imumon.blocks import FloatArray

RATE_HZ, SAMPLES = 400, 400 * 3600
ROUNDS = 20
PACKAGE = "allantools"
OTHERS: dict[Kind, str] = {"allan": "oadev", "modified": "mdev", "hadamard": "ohdev"}


def table(samples: int = SAMPLES, rounds: int = ROUNDS) -> Table:
    """Measure white noise without gaps, which is all that allantools can be given."""
    result = Table(
        "Allan deviation", ["other", "deviation", "the other, s", "imumon, s", "faster", "largest difference"]
    )
    result.notes.append(
        f"{samples} samples of white noise at {RATE_HZ} Hz, averaging times in octaves, one thread. imumon "
        "computes the three deviations at once, so its time stands beside each and counts once in the sum. "
        "The difference is relative, over all averaging times that both give."
    )
    name = named(PACKAGE)
    if name is None:
        result.rows.append([PACKAGE, "not installed", "-", "-", "-", "-"])
        return result
    values = np.random.default_rng(0).normal(size=samples)
    interval_ns = 1_000_000_000 // RATE_HZ
    channels = even_channels(np.arange(samples) * interval_ns, np.zeros(samples, np.int64), {"": values})
    series, other = channels[""], import_module(PACKAGE)
    factors = octaves(series)
    functions: dict[str, Callable[[], object]] = {"imumon": partial(variances, series, factors)}
    for kind, function in OTHERS.items():
        functions[kind] = partial(_theirs, getattr(other, function), values, factors / RATE_HZ)
    times, own = measure(functions, rounds), variances(series, factors)
    mine = times["imumon"].best * 1e-9
    for kind, function in OTHERS.items():
        seconds = times[kind].best * 1e-9
        found = _theirs(getattr(other, function), values, factors / RATE_HZ)
        apart = np.abs(found / np.sqrt(own[kind][: len(found)]) - 1.0).max()
        figures = [f"{seconds:.3f}", f"{mine:.3f}", faster(seconds, mine), f"{apart:.0e}"]
        result.rows.append([name, f"{kind} ({function})", *figures])
    total = sum(times[kind].best for kind in OTHERS) * 1e-9
    result.rows.append([name, "all three", f"{total:.3f}", f"{mine:.3f}", faster(total, mine), ""])
    return result


def _theirs(function: Any, values: FloatArray, tau_s: FloatArray) -> FloatArray:
    """Return the deviations at the shortest of these times, as many as the record is long enough for."""
    return np.asarray(function(values, rate=float(RATE_HZ), data_type="freq", taus=tau_s)[1], np.float64)
