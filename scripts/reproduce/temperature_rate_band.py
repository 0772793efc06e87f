"""Whether the 2σ band of the temperature rate is honest, and whether it can hold 90 to 99 % of each record.

Three tables over ensembles of records: the band against the exact posterior of one who knows the shape of the
temperature; the band on temperatures drawn from the hypotheses of the filter; and on records of other slopes,
steps, noises and sampling rates.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.special import ndtr
from temperature_rate_records import PER_HOUR, SHAPES, Record

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.temperature_rate.method import MultipleModelRate

SETTLED_S = 1200.0
RECORDS = 12
EVERY_S = 30.0
SPREAD = 0.2
FORGETTING_S = 1800.0
"""Time after which a drawn acceleration is forgotten, s."""

Shape = tuple[FloatArray, FloatArray]
"""Temperature in °C and rate in °C/s."""


def read(
    temperature: FloatArray, rate: FloatArray, noise: float, step: float, hz: float, seed: int
) -> Record:
    """Return what a noisy sensor with steps reads of a temperature given at its samples."""
    n = len(temperature)
    noisy = temperature + noise * np.random.default_rng(seed).standard_normal(n)
    time_ns: IntArray = np.round(np.arange(n) * (1e9 / hz)).astype(np.int64)
    return Record("", time_ns, np.asarray(step * np.round(noisy / step), np.float64), temperature, rate)


def varied(shape: str, noise: float, seed: int, step: float = 0.05, hz: float = 10.0) -> tuple[Record, Shape]:
    """Return a record of a shape times a random factor plus a random offset, and the shape itself."""
    rng = np.random.default_rng(1000 + seed)
    t = np.arange(int(3 * PER_HOUR * hz)) / hz
    temperature, rate = SHAPES[shape](t)
    scale, offset = rng.uniform(1 - SPREAD, 1 + SPREAD), rng.uniform(0.0, 1.0)
    record = read(offset + scale * temperature, scale * rate, noise, step, hz, seed)
    return record, (temperature, rate)


def drawn(jerk: float, noise: float, seed: int) -> Record:
    """Return a record whose temperature is drawn from a hypothesis of the filter: 11.3 °C/h at the start."""
    rng = np.random.default_rng(2000 + seed)
    seconds = int(3 * PER_HOUR)
    keep = np.exp(-1.0 / FORGETTING_S)
    acceleration = rng.standard_normal() * np.sqrt(jerk * FORGETTING_S / 2)
    kicks = np.sqrt(jerk) * rng.standard_normal(seconds + 1)
    path = np.empty((seconds + 1, 2))
    path[0] = rng.uniform(20.0, 30.0), 11.3 / PER_HOUR
    for i in range(seconds):
        path[i + 1] = path[i, 0] + path[i, 1] + acceleration / 2, path[i, 1] + acceleration
        acceleration = keep * acceleration + kicks[i]
    t = np.arange(seconds * 10) / 10.0
    temperature, rate = (np.interp(t, np.arange(seconds + 1), column) for column in path.T)
    return read(temperature, rate, noise, 0.05, 10.0, seed)


def known_shape(record: Record, form: Shape, noise: float, step: float) -> tuple[IntArray, FloatArray]:
    """Return samples and there (n, 2) rate and its standard deviation for one who knows the shape.

    The temperature is offset + factor · shape; the posterior of both, with a flat prior, is exact without
    noise (the polygon that all readings allow) and Laplace's approximation with noise.
    """
    shape, rate = form
    span = np.ptp(shape)
    x = (shape - shape.mean()) / span
    y = (record.reading - record.reading.mean()) / step
    hz = 1e9 / (record.time_ns[1] - record.time_ns[0])
    at = np.arange(int(SETTLED_S * hz), len(x), int(EVERY_S * hz))
    moments = _polygon(x, y, at) if noise == 0.0 else _probit(x, y, noise / step, at)
    # The factor is that of `x`, in steps.
    slope = rate[at] / span * step
    return at, moments * np.column_stack([slope, np.abs(slope)])


def _polygon(x: FloatArray, y: FloatArray, at: IntArray) -> FloatArray:
    """Return mean and standard deviation of b where |a + b x - y| < 1/2 for samples up to each of `at`."""
    big = 1e4
    corners = np.array([[-big, -big], [big, -big], [big, big], [-big, big]])
    changes = np.flatnonzero(np.diff(y))
    events = np.union1d(np.union1d(changes, changes + 1), np.union1d(at, [0]))
    found = {}
    for i in events:
        for sign in (1.0, -1.0):
            corners = _cut(corners, np.array([sign, sign * x[i]]), sign * y[i] + 0.5)
        found[int(i)] = corners
    return np.array([_moments(found[int(i)]) for i in at])


def _cut(corners: FloatArray, normal: FloatArray, most: float) -> FloatArray:
    """Return the part of a convex polygon, (n, 2), where normal · corner ≤ most."""
    inside = most - corners @ normal
    if (inside >= 0).all():
        return corners
    kept = []
    for i in range(len(corners)):
        j = (i + 1) % len(corners)
        if inside[i] >= 0:
            kept.append(corners[i])
        if (inside[i] >= 0) != (inside[j] >= 0):
            share = inside[i] / (inside[i] - inside[j])
            kept.append(corners[i] + share * (corners[j] - corners[i]))
    return np.array(kept)


def _moments(corners: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation of the second coordinate over a convex polygon."""
    middle = corners.mean(0)
    p = corners - middle
    q = np.roll(p, -1, axis=0)
    area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
    total = area.sum()
    mean = (area * (p[:, 1] + q[:, 1])).sum() / (3 * total)
    square = (area * (p[:, 1] ** 2 + p[:, 1] * q[:, 1] + q[:, 1] ** 2)).sum() / (6 * total)
    return float(middle[1] + mean), float(np.sqrt(square - mean**2))


def _probit(x: FloatArray, y: FloatArray, sigma: float, at: IntArray) -> FloatArray:
    """Return mean and standard deviation of b after the samples up to each of `at`, by Newton's iteration."""
    second = np.arange(len(x)) // 10
    levels, first, count = np.unique(
        np.column_stack([second, y]), axis=0, return_index=True, return_counts=True
    )
    place = np.bincount(second, x) / np.bincount(second)
    u, level, weight = place[levels[:, 0].astype(int)], levels[:, 1], count.astype(np.float64)
    theta = np.linalg.lstsq(np.column_stack([np.ones_like(u), u]), level, rcond=None)[0]
    result = []
    for stop in at:
        used = first <= stop
        h = np.column_stack([np.ones(used.sum()), u[used]])
        for _ in range(4):
            upper = (level[used] + 0.5 - h @ theta) / sigma
            lower = (level[used] - 0.5 - h @ theta) / sigma
            mass = np.maximum(ndtr(upper) - ndtr(lower), 1e-300)
            at_upper, at_lower = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) for z in (upper, lower))
            first_derivative = (at_lower - at_upper) / mass
            second_derivative = (upper * at_upper - lower * at_lower) / mass + first_derivative**2
            information = h.T @ (h * (weight[used] * second_derivative)[:, np.newaxis]) / sigma**2
            theta = theta + np.linalg.solve(information, h.T @ (weight[used] * first_derivative) / sigma)
        result.append((theta[1], np.sqrt(np.linalg.inv(information)[1, 1])))
    return np.array(result)


def filtered(record: Record) -> tuple[IntArray, FloatArray]:
    """Return samples and there (n, 2) rate and its standard deviation of the default method."""
    result = MultipleModelRate().process(
        record.time_ns, np.zeros(len(record.reading), np.int64), record.reading
    )
    at = np.flatnonzero(record.seconds > SETTLED_S)
    return at, np.column_stack([result.rate, result.rate_sd])[at]


def summary(cases: Iterable[tuple[Record, tuple[IntArray, FloatArray]]]) -> str:
    """Return cells: rms °C/h, rms of error over sd, share within 2σ, its range, records with 90 to 99 %."""
    errors, ratios, shares = [], [], []
    for record, (at, found) in cases:
        error = found[:, 0] - record.rate[at]
        errors.append(np.mean(error**2))
        ratios.append(np.mean((error / found[:, 1]) ** 2))
        shares.append(100 * np.mean(np.abs(error) < 2 * found[:, 1]))
    rms, ratio = PER_HOUR * np.sqrt(np.mean(errors)), np.sqrt(np.mean(ratios))
    good = sum(90 <= share <= 99 for share in shares)
    spread = f"{min(shares):.0f} to {max(shares):.0f}"
    return f"{rms:.2g} | {ratio:.2f} | {np.mean(shares):.1f} % | {spread} % | {good} of {len(shares)}"


HEAD = "rms °C/h | error/sd | within 2σ | single records | records with 90 to 99 %"
RULE = "---|---|---|---|---"


def bound() -> None:
    """Print the band of the default method and that of the posterior which knows the shape, in Markdown."""
    print(f"| shape | noise °C | method | {HEAD} |\n|---|---|---|{RULE}|")
    for shape in ("heating", "wobble", "steady"):
        for noise in (0.0, 0.005):
            records = [varied(shape, noise, seed) for seed in range(RECORDS)]
            live = summary((record, filtered(record)) for record, _ in records)
            knowing = summary((record, known_shape(record, form, noise, 0.05)) for record, form in records)
            print(f"| {shape} | {noise:g} | multiple models | {live} |")
            print(f"| {shape} | {noise:g} | knows the shape | {knowing} |", flush=True)


def consistency() -> None:
    """Print the band on temperatures drawn from hypotheses of the filter, in Markdown."""
    print(f"| jerk density °C²/s⁵ | noise °C | {HEAD} |\n|---|---|{RULE}|")
    for jerk in (1e-21, 1e-18, 1e-15, 1e-12):
        for noise in (0.0, 0.005):
            records = [drawn(jerk, noise, seed) for seed in range(RECORDS // 2)]
            cells = summary((record, filtered(record)) for record in records)
            print(f"| {jerk:g} | {noise:g} | {cells} |", flush=True)


def elsewhere() -> None:
    """Print the band on records of other slopes, steps and sampling rates, in Markdown."""
    print(f"| record | step °C | noise °C | Hz | {HEAD} |\n|---|---|---|---|{RULE}|")
    for hz, step, noise in ((1.0, 0.05, 0.005), (10.0, 0.01, 0.002), (10.0, 0.2, 0.02), (100.0, 0.1, 0.01)):
        count = RECORDS // 2 if hz <= 10.0 else 3
        for shape in ("heating", "wobble"):
            records = [varied(shape, noise, seed, step, hz)[0] for seed in range(count)]
            cells = summary((record, filtered(record)) for record in records)
            print(f"| {shape} | {step:g} | {noise:g} | {hz:g} | {cells} |", flush=True)
    t = np.arange(int(3 * PER_HOUR * 10)) / 10.0
    for slope in (0.1, 3.0, 30.0):
        rate = np.full(len(t), slope / PER_HOUR)
        records = [
            read(30.0 + 0.007 * seed + rate * t, rate, 0.005, 0.05, 10.0, seed)
            for seed in range(RECORDS // 2)
        ]
        cells = summary((record, filtered(record)) for record in records)
        print(f"| steady {slope:g} °C/h | 0.05 | 0.005 | 10 | {cells} |", flush=True)
