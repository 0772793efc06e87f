"""How soon can anybody know that a turn about the vertical has begun slowly, by gyros alone?

The best filter is told the white noise and the flicker of each gyro and which way is up, and no more than the
detector otherwise: a turn may have begun at any time, in any time, at any rate, or all axes may creep.  It
finds a turn from the probability on that the detector takes.  Its priors are those of the detector, so that
noise alone is between the two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from rest_detector_scenes import FLICKER_TAUS_S, FLOOR_PER_MARKOV, Grade, Scene, measure

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestDetector

LIKELY = 0.75
"""Probability from which on it is no rest."""
TURN_EVERY_S = 600.0
"""A turn is expected every ten minutes."""
RATES = 20.0
"""2 ln of the ratio of the largest and the smallest rate: 0.01 °/s is as likely as 300 °/s."""
OBLIQUE = 0.3
"""Share of a difference across the vertical that no misalignment or tilt of a turntable explains (17°)."""
CREEP = 2e-5
"""rad/s²: 70 °/h/°C at 2 °C/min is 1.1e-5; more than this, about the vertical alone, is a turn."""

BEFORE_S, FIRST_S, LAST_S = 150, 4, 60
"""Rest before the turn, and when a turn is looked for since it began, s."""
BEGUN_S = (*range(2, 20, 2), *range(20, 60, 4), 80, 100, 140)
GROWN_S = (0, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96)
"""Ages at which a turn may have begun, and since which its rate is constant."""
AT_S = (10, 20, 30)
HEADER = """\
| sensors | after 10 s | 20 s | 30 s | best filter, s | detector, s | best filter, of 12 min | detector |
|---|---|---|---|---|---|---|---|"""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Changes as columns, whitened and normalised, (n, h), what they were, (h,), and the whitening, (n, n).

    `growing` is for how long they grew, s, (h,), `prior` the logarithm of their probability.
    """

    columns: FloatArray
    size: FloatArray
    whiten: FloatArray
    growing: FloatArray
    prior: FloatArray


def covariance(grade: Grade, seconds: int) -> FloatArray:
    """Return that of means of a second, (rad/s)², of a gyro at rest that is on since ever."""
    lag = np.abs(np.subtract.outer(np.arange(seconds), np.arange(seconds))).astype(np.float64)
    result = np.eye(seconds) * (grade.gyro_sd**2 / 100.0 + grade.gyro_step**2 / 12.0 / 25.0)
    for tau_s in FLICKER_TAUS_S:
        decay = np.exp(-1.0 / tau_s)
        mean = 2.0 * tau_s**2 * (1.0 / tau_s + np.expm1(-1.0 / tau_s))
        between = tau_s**2 * (1.0 - decay) ** 2 * np.exp(-(np.maximum(lag, 1.0) - 1.0) / tau_s)
        result += (grade.gyro_flicker / FLOOR_PER_MARKOV) ** 2 * np.where(lag == 0.0, mean, between)
    return result


@lru_cache(LAST_S)
def shapes(grade: Grade, since_s: int) -> Shapes:
    """Return what may have happened until a time since the turn began, of a gyro with any bias."""
    n = BEFORE_S + since_s
    cover = covariance(grade, n)
    whiten = np.linalg.inv(np.linalg.cholesky(cover + 100.0 * cover[0, 0]))
    pairs = [(s, end) for s in BEGUN_S for end in (*GROWN_S, s - 1) if end < s]
    begun, grown = np.array(pairs, np.float64).T
    rate = np.clip((begun - np.arange(n, -1, -1.0)[:, np.newaxis]) / (begun - grown), 0.0, 1.0)
    columns = whiten @ (0.5 * (rate[1:] + rate[:-1]))
    size = np.sqrt((columns * columns).sum(0))
    ages, which, alike = np.unique(begun, return_inverse=True, return_counts=True)
    prior = np.log((np.gradient(ages) / alike)[which] / TURN_EVERY_S)
    return Shapes(columns / size, size, whiten, begun - grown, prior)


def turns(rate: FloatArray, grade: Grade) -> bool:
    """Tell whether it turns likelier than the detector asks, by means of 1 s, (n, 3), the vertical last."""
    known = shapes(grade, len(rate) - BEFORE_S)
    square = np.square(known.columns.T @ (known.whiten @ rate))
    up = square[:, 2]
    turn = known.prior - np.log(RATES / 2.5066) + 0.5 * (up - np.log(np.maximum(up, 1.0)))
    tilted = np.square(0.5 * OBLIQUE) * up[:, np.newaxis]
    turn += 0.5 * (square[:, :2] * tilted / (1.0 + tilted) - np.log1p(tilted)).sum(1)
    crept = np.square(CREEP * known.growing * known.size)[:, np.newaxis]
    creep = known.prior + 0.5 * (square * crept / (1.0 + crept) - np.log1p(crept)).sum(1)
    other = np.logaddexp(0.0, np.logaddexp.reduce(creep))
    return bool(np.logaddexp.reduce(turn) - other > np.log(LIKELY / (1.0 - LIKELY)))


def found_after(samples: SampleBlock, grade: Grade, rate_hz: int) -> tuple[float, float]:
    """Return when the best filter and the detector have found a turn that begins after `BEFORE_S`, s."""
    n = (BEFORE_S + LAST_S) * rate_hz
    part = SampleBlock({name: values[:n] for name, values in samples.columns.items()})
    gyro = part.gyro
    assert gyro is not None
    assert part.accel is not None
    up = part.accel[: BEFORE_S * rate_hz].mean(0)
    axes, _ = np.linalg.qr(np.column_stack([up, np.eye(3)]))
    means = gyro.reshape(-1, rate_hz, 3).mean(1) @ axes[:, [1, 2, 0]]
    times = range(FIRST_S, LAST_S)
    best = next((t for t in times if turns(means[: BEFORE_S + t], grade)), LAST_S)
    at_rest = RestDetector().process(part)["at_rest"][BEFORE_S * rate_hz :] == 1
    return float(best), float(at_rest.sum()) / rate_hz


def rows(scene: Scene, grades: tuple[Grade, ...], seeds: range, rate_dps_per_s: float) -> Iterator[str]:
    """Yield a row for each grade of sensors, of a scene with a turn about the vertical that begins evenly."""
    rate_hz = round(1.0 / float(scene.t[1] - scene.t[0]))
    moving_s = float((~scene.rest).sum()) / rate_hz
    for grade in grades:
        sigmas = []
        for since_s in AT_S:
            n = BEFORE_S + since_s
            ramp = np.radians(rate_dps_per_s) * np.maximum(np.arange(n) + 0.5 - BEFORE_S, 0.0)
            known = shapes(grade, since_s).whiten @ ramp
            sigmas.append(f"{np.sqrt(known @ known):.1f}")
        found = np.array([found_after(measure(scene, grade, seed), grade, rate_hz) for seed in seeds]).mean(0)
        share = 100.0 * found / moving_s
        cells = [
            grade.name,
            *sigmas,
            *(f"{value:.1f}" for value in found),
            *(f"{value:.1f} %" for value in share),
        ]
        yield f"| {' | '.join(cells)} |"
