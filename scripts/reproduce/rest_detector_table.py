"""Rest and motion on the bench, in swings and in turns: what is detected, how soon, and the bias over sigma.

Rows are of all sensors together.  Turns after a rest and what is outside the bench, sensor by sensor, are
`scripts/reproduce/field --part rest`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from rest_detector_scenes import (
    BIAS,
    SCENES,
    SENSORS,
    Scene,
    averaged,
    measure_with_bias,
    rest_after_turn,
    swing,
    turn_from_start,
)
from study import Options, Study, Table, largest, matrix, rms, worst_first
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias

RATES_HZ = (100.0, 10.0, 2.0)
FULL_RATE_HZ = RATES_HZ[0]
SECONDS = 200.0
TURNS = (
    (0.05, 10.0, 0.5, 0.0), (0.1, 10.0, 10.0, 0.0), (0.5, 10.0, 0.5, 0.0), (0.5, 10.0, 120.0, 0.0),
    (0.5, 60.0, 120.0, 0.0), (0.5, 10.0, 120.0, 45.0), (0.5, 10.0, 120.0, 90.0), (5.0, 12.0, 5.0, 0.0),
    (30.0, 30.0, 120.0, 0.0), (300.0, 10.0, 20.0, 0.0),
)  # fmt: skip
"""deg/s, minutes, seconds in which it begins and ends, and degrees from the vertical to the axis."""
FIELD = ("tilted slowly, 1 deg in 60 s", "breathing, 0.1 deg/s", "idling engine", "driving in town",
         "driving on a smooth road", "held in a hand", "fan")  # fmt: skip
TURN_RATE_HZ = 25.0
SWINGS = {
    "hangs on a cable, 3 deg in 2 s": (0, 3.0, 2.0, 1.0),
    "hangs on a cable, 0.3 deg in 2 s": (0, 0.3, 2.0, 1.0),
    "torsion of a cable, 1 deg in 20 s": (2, 1.0, 20.0, 0.0),
    "torsion of a cable, 30 deg in 60 s": (2, 30.0, 60.0, 0.0),
    "rocks, 1 deg in 10 s": (0, 1.0, 10.0, 0.0),
    "rocks, 1 deg in 60 s": (0, 1.0, 60.0, 0.0),
    "rocks, 5 deg in 300 s": (0, 5.0, 300.0, 0.0),
}
"""Axis of the unit, degrees, seconds, and the arm in m."""
FROM_START_DPS = (0.5, 5.0, 30.0)
AMBIGUOUS = ((0.05, 10.0), (0.2, 60.0))
"""deg/s, and seconds in which it begins and ends: within what a consumer gyro wanders."""
HEADS = (
    "scene", "Hz", "motion missed %", "by VQF %", "rest found %", "by VQF %", "motion after s",
    "rest after s", "z rms", "max z",
)  # fmt: skip


@dataclass
class Tally:
    """Sums over runs: seconds of rest and of motion, those found, and delays in s."""

    rest: float = 0.0
    rest_found: float = 0.0
    motion: float = 0.0
    motion_missed: float = 0.0
    to_motion: list[float] = field(default_factory=list)
    to_rest: list[float] = field(default_factory=list)

    def add(self, t: FloatArray, rest: BoolArray, found: BoolArray) -> None:
        """Add a run: times, truth, and what was found."""
        dt = t[1] - t[0]
        self.rest += rest.sum() * dt
        self.rest_found += (rest & found).sum() * dt
        self.motion += (~rest).sum() * dt
        self.motion_missed += (~rest & found).sum() * dt
        edges = np.flatnonzero(np.diff(rest.astype(int))) + 1
        ends = np.append(edges, len(t))[1:]
        for begin, end in zip(edges, ends, strict=True):
            part = found[begin:end]
            other = part if rest[begin] else ~part
            after = float(t[begin + np.argmax(other)] - t[begin]) if other.any() else np.inf
            if rest[begin]:
                self.to_rest.append(after)
            elif found[begin - 3]:
                self.to_motion.append(after)

    def percent(self) -> tuple[float, float]:
        """Return the shares of motion taken for rest, and of rest found, NaN without any."""
        missed = 100.0 * self.motion_missed / self.motion if self.motion else np.nan
        return missed, 100.0 * self.rest_found / self.rest if self.rest else np.nan


def delays(values: list[float]) -> str:
    """Return median and longest, s."""
    if not values:
        return "-"
    texts = ["not" if np.isinf(value) else f"{value:.2f}" for value in (np.median(values), max(values))]
    return " / ".join(texts)


def vqf_rest(samples: SampleBlock) -> BoolArray:
    """Return what the rest detection of the PyPI package vqf says, with its default settings.

    It is given gyros without their bias at the start, for it takes more than 2 deg/s for motion.
    """
    t = samples["device_time_ns"] * 1e-9
    gyro, accel = matrix(samples, "gyro"), matrix(samples, "accel")
    found = VQF(float(t[1] - t[0])).updateBatch(
        np.ascontiguousarray(gyro - BIAS), np.ascontiguousarray(accel)
    )
    return np.asarray(found["restDetected"], np.bool_)


def bias_over_sigma(samples: SampleBlock, truth: FloatArray) -> FloatArray:
    """Return the error of the bias over its sigma, (n, 3), NaN where there is no estimate.

    The hypothesis of a turn is part of the sigma that the estimator gives.
    """
    return (matrix(samples, "gyro_bias") - truth) / matrix(samples, "gyro_bias_sd")


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """A kind of scene: how it is made for a seed, and how many of its samples are one for the detector."""

    name: str
    make: Callable[[int], Scene]
    count: int = 1


def row(kind: Kind, seeds: range) -> tuple[float, list[str]]:
    """Return how bad a row is, and the row: all seeds of a kind of scene with all sensors."""
    ours, theirs, ratios = Tally(), Tally(), []
    for seed in seeds:
        scene = kind.make(seed)
        last = slice(kind.count - 1, len(scene.t) // kind.count * kind.count, kind.count)
        t, rest = scene.t[last], scene.rest[last]
        for grade in SENSORS:
            read, truth = measure_with_bias(scene, grade, seed)
            samples = averaged(read, kind.count)
            samples = samples.with_columns(RestAndBias().process(samples))
            ours.add(t, rest, samples["at_rest"] == 1)
            theirs.add(t, rest, vqf_rest(samples))
            ratios.append(bias_over_sigma(samples, truth[last]).ravel())
    found, other, over = ours.percent(), theirs.percent(), np.concatenate(ratios)
    cells = [kind.name, f"{1.0 / (t[1] - t[0]):.0f}", f"{found[0]:.2f}", f"{other[0]:.2f}"]
    cells += [f"{found[1]:.1f}", f"{other[1]:.1f}", delays(ours.to_motion), delays(ours.to_rest)]
    bad = np.nan_to_num(found[0]) + np.nan_to_num(100.0 - found[1])
    return bad, [*cells, f"{rms(over):.2f}", f"{largest(over):.1f}"]


def kinds() -> Iterator[Kind]:
    """Yield scenes on the bench at three rates, turns from the start, swings, and rest after a turn."""
    for rate_hz in RATES_HZ:
        for name, make in SCENES.items():
            yield Kind(name, partial(make, FULL_RATE_HZ, SECONDS), round(FULL_RATE_HZ / rate_hz))
    for rate_dps in FROM_START_DPS:
        turn = turn_from_start(TURN_RATE_HZ, rate_dps)
        yield Kind(f"begins in a turn of {rate_dps:g} deg/s", partial(the_same, turn))
    for name, (axis, degrees, period_s, arm_m) in SWINGS.items():
        yield Kind(name, partial(the_same, swing(2 * TURN_RATE_HZ, axis, degrees, period_s, arm_m)))
    for rate_dps, ramp_s in AMBIGUOUS:
        hour = rest_after_turn(TURN_RATE_HZ, rate_dps, ramp_s)
        name = f"an hour of rest after 5 min of {rate_dps:g} deg/s, begun in {ramp_s:g} s"
        yield Kind(name, partial(the_same, hour))


def the_same(scene: Scene, seed: int) -> Scene:
    """Return a scene that is the same for every seed."""
    del seed
    return scene


def tables(given: Options) -> Iterator[Table]:
    """Yield one table, the worst row first."""
    chosen = [kind for kind in kinds() if given.only in kind.name][: 1 if given.quick else None]
    title = f"Seeds {given.seeds[0]} to {given.seeds[-1]}, six sensors, the worst first."
    yield Table(title, HEADS, worst_first(row(kind, given.seeds) for kind in chosen))


STUDY = Study(tables, seeds=2, page="appendix/rest-detector-results.md")
