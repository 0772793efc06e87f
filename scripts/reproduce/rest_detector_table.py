"""Detection and false-alarm rates of the rest detector, and its delays, as tables in Markdown."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product

import numpy as np
import rest_detector_limit as limit
from rest_detector_scenes import (
    BIAS,
    GRADES,
    SCENES,
    SENSORS,
    Grade,
    Scene,
    averaged,
    measure,
    measure_with_bias,
    rest_after_turn,
    steady_turn,
    swing,
    turn_from_start,
)
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias, RestDetector
from imumon.estimation.rest.parameters import RestParameters

RATES_HZ = (100.0, 10.0, 2.0)
FULL_RATE_HZ = RATES_HZ[0]
SECONDS, LONG_S = 200.0, 1800.0
HEADER = """\
| scene | sensors | rest found % | motion missed % | motion after s | rest after s | left per h |
|---|---|---|---|---|---|---|"""


@dataclass
class Tally:
    """Sums over runs: seconds of rest and of motion, those found, delays in s, and rests left wrongly."""

    rest: float = 0.0
    rest_found: float = 0.0
    motion: float = 0.0
    motion_missed: float = 0.0
    to_motion: list[float] = field(default_factory=list)
    to_rest: list[float] = field(default_factory=list)
    left: int = 0

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
        leaves = np.flatnonzero(found[:-1] & ~found[1:]) + 1
        self.left += int((rest[leaves] & rest[np.minimum(leaves + 2, len(t) - 1)]).sum())

    def percent(self) -> tuple[float, float]:
        """Return the shares of motion taken for rest, and of rest found, NaN without any."""
        missed = 100.0 * self.motion_missed / self.motion if self.motion else np.nan
        return missed, 100.0 * self.rest_found / self.rest if self.rest else np.nan

    def row(self) -> str:
        """Return the cells of a table."""
        found = f"{100 * self.rest_found / self.rest:.1f}" if self.rest else "-"
        missed = f"{100 * self.motion_missed / self.motion:.1f}" if self.motion else "-"
        per_hour = f"{3600 * self.left / self.rest:.1f}" if self.rest else "-"
        return f"{found} | {missed} | {_delays(self.to_motion)} | {_delays(self.to_rest)} | {per_hour}"


def _delays(values: list[float]) -> str:
    if not values:
        return "-"
    median, worst = np.median(values), max(values)
    texts = ["not" if np.isinf(value) else f"{value:.2f}" for value in (median, worst)]
    return " / ".join(texts)


def tally(name: str, grades: Sequence[Grade], rate_hz: float, seconds: float, seeds: int) -> Tally:
    """Run a scene with some grades of sensors, over seeds; lower rates are means of samples at 100 Hz."""
    result, count = Tally(), round(FULL_RATE_HZ / rate_hz)
    for grade, seed in product(grades, range(seeds)):
        scene = SCENES[name](FULL_RATE_HZ, seconds, seed)
        samples = averaged(measure(scene, grade, seed), count)
        found = RestDetector().process(samples)["at_rest"] == 1
        last = slice(count - 1, len(scene.t) // count * count, count)
        result.add(scene.t[last], scene.rest[last], found)
    return result


TURNS = (
    (0.05, 10.0, 0.5, 0.0), (0.1, 10.0, 10.0, 0.0), (0.5, 10.0, 0.5, 0.0), (0.5, 10.0, 120.0, 0.0),
    (0.5, 60.0, 120.0, 0.0), (0.5, 10.0, 120.0, 45.0), (0.5, 10.0, 120.0, 90.0), (5.0, 12.0, 5.0, 0.0),
    (30.0, 30.0, 120.0, 0.0), (300.0, 10.0, 20.0, 0.0),
)  # fmt: skip
"""deg/s, minutes, seconds in which it begins and ends, and degrees from the vertical to the axis."""
SLOWLY = TURNS[3]
FIELD = ("tilted slowly, 1 deg in 60 s", "breathing, 0.1 deg/s", "idling engine", "driving in town",
         "driving on a smooth road", "held in a hand", "fan")  # fmt: skip
FIELD_HEADER = """\
| scene | sensors | motion missed % | by VQF % | rest found % | by VQF % | rest after s | z > 5 % | max z |
|---|---|---|---|---|---|---|---|---|"""
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
FROM_START = (0.5, 5.0, 30.0)
AMBIGUOUS = ((0.05, 10.0), (0.2, 60.0))
"""deg/s, and seconds in which it begins and ends: within what a consumer gyro wanders."""
TITLE = """\
# Rest detector: tables

Made by `scripts/reproduce/rest_detector`, each with `--only` and `--seeds` as its heading says.
"""
LONG_MIN = 20.0
"""Of longer scenes there are fewer seeds, so that a row of an hour costs no more than another."""


def vqf_rest(samples: SampleBlock) -> BoolArray:
    """Return what the rest detection of the PyPI package vqf says, with its default settings.

    It is given gyros without their bias at the start, for it takes more than 2 deg/s for motion.
    """
    t = samples["device_time_ns"] * 1e-9
    gyro, accel = samples.gyro, samples.accel
    assert gyro is not None
    assert accel is not None
    found = VQF(float(t[1] - t[0])).updateBatch(
        np.ascontiguousarray(gyro - BIAS), np.ascontiguousarray(accel)
    )
    return np.asarray(found["restDetected"], np.bool_)


def matrix(samples: SampleBlock, name: str) -> FloatArray:
    """Return three columns, (n, 3)."""
    return np.column_stack([samples[f"{name}_{axis}"] for axis in "xyz"])


def bias_over_sigma(samples: SampleBlock, truth: FloatArray) -> FloatArray:
    """Return the error of the bias over its sigma, (n, 3), NaN where there is no estimate.

    The hypothesis of a turn is part of the sigma that the estimator gives.
    """
    return (matrix(samples, "gyro_bias") - truth) / matrix(samples, "gyro_bias_sd")


@dataclass(frozen=True, slots=True, eq=False)
class Kind:
    """A kind of scene: how it is made for a seed, and the detector's parameters."""

    name: str
    make: Callable[[int], Scene]
    told: RestParameters | None = None


def field_row(kind: Kind, grade: Grade, scenes: Sequence[tuple[int, Scene]]) -> tuple[float, str]:
    """Return how bad a row is, and the row: all seeds of a kind of scene with sensors of a grade."""
    ours, theirs, z = Tally(), Tally(), []
    for seed, scene in scenes:
        samples, truth = measure_with_bias(scene, grade, seed)
        columns = RestAndBias(rest=kind.told).process(samples)
        ours.add(scene.t, scene.rest, columns["at_rest"] == 1)
        theirs.add(scene.t, scene.rest, vqf_rest(samples))
        z.append(np.abs(bias_over_sigma(samples.with_columns(columns), truth)).max(1))
    over = np.concatenate(z)
    over = over[np.isfinite(over)]
    false, share = ours.percent(), 100.0 * float(np.mean(over > 5.0)) if len(over) else 0.0
    cells = [
        kind.name, grade.name, *(f"{value:.2f}" for value in (false[0], theirs.percent()[0])),
        *(f"{value:.1f}" for value in (false[1], theirs.percent()[1])), _delays(ours.to_rest),
        f"{share:.2f}", f"{over.max():.1f}" if len(over) else "-",
    ]  # fmt: skip
    return np.nan_to_num(false[0]) + share + np.nan_to_num(100.0 - false[1]), f"| {' | '.join(cells)} |"


def field_kinds() -> Iterator[Kind]:
    """Yield turns after a rest, and what else is outside the bench."""
    for rate_dps, minutes, ramp_s, tilt_deg in TURNS:
        tilted = f", {tilt_deg:g}° from the vertical" if tilt_deg else ""
        turn = steady_turn(TURN_RATE_HZ, rate_dps, minutes, ramp_s, tilt_deg)
        name = f"turn of {rate_dps:g} deg/s, {minutes:g} min, begun in {ramp_s:g} s{tilted}"
        yield Kind(name, partial(_same, turn))
    for name in FIELD:
        yield Kind(name, partial(SCENES[name], FULL_RATE_HZ, 2 * SECONDS))


def doubtful_kinds() -> Iterator[Kind]:
    """Yield turns from the start, swings, and an hour of rest after a turn that may be wander."""
    for rate_dps in FROM_START:
        name = f"begins in a turn of {rate_dps:g} deg/s"
        make = partial(_same, turn_from_start(TURN_RATE_HZ, rate_dps))
        yield Kind(name, make)
    for name, (axis, degrees, period_s, arm_m) in SWINGS.items():
        yield Kind(name, partial(_same, swing(2 * TURN_RATE_HZ, axis, degrees, period_s, arm_m)))
    for rate_dps, ramp_s in AMBIGUOUS:
        hour = rest_after_turn(TURN_RATE_HZ, rate_dps, ramp_s)
        name = f"an hour of rest after 5 min of {rate_dps:g} deg/s, begun in {ramp_s:g} s"
        yield Kind(name, partial(_same, hour))


def _same(scene: Scene, seed: int) -> Scene:
    """Return a scene that is the same for every seed."""
    del seed
    return scene


def outside(title: str, kinds: Iterable[Kind], seeds: int, first: int) -> None:
    """Print kinds of scenes in which a sigma is easily wrong, the worst row first."""
    rows = []
    for kind in kinds:
        scenes: list[tuple[int, Scene]] = []
        for seed in range(first, first + seeds):
            scene = kind.make(seed)
            if len(scenes) * scene.t[-1] < 60.0 * LONG_MIN * seeds:
                scenes.append((seed, scene))
        for grade in SENSORS:
            rows.append(field_row(kind, grade, scenes))
            print(rows[-1][1], file=sys.stderr, flush=True)
    print(f"### {title}, {seeds} seeds (above {LONG_MIN:g} min fewer), the worst first\n\n{FIELD_HEADER}")
    print("\n".join(row for _, row in sorted(rows, reverse=True)) + "\n")


def main() -> None:
    """Print the scenes of the field, a table for each rate, and one of long rests."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce/rest_detector", description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each scene (default: %(default)s)")
    parser.add_argument("--only", choices=["field", "doubtful", "bench", "limit"], help="one kind of scenes")
    parser.add_argument("--first", type=int, default=0, help="number of the first seed (default: 0)")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    given = parser.parse_args()
    if given.quick:
        kind = Kind(FIELD[0], partial(SCENES[FIELD[0]], FULL_RATE_HZ, SECONDS))
        scenes = [(given.first, kind.make(given.first))]
        print(f"{FIELD_HEADER}\n{field_row(kind, SENSORS[0], scenes)[1]}")
        return
    print(TITLE)
    if given.only in (None, "field"):
        outside("Outside the bench", field_kinds(), given.seeds, given.first)
    if given.only in (None, "doubtful"):
        outside("Turns from the start, swings, rest after a turn", doubtful_kinds(), given.seeds, given.first)
    if given.only in (None, "bench"):
        bench(given.seeds)
    if given.only in (None, "limit"):
        rate_dps, minutes, ramp_s, tilt_deg = SLOWLY
        what = f"a turn of {rate_dps:g} deg/s that begins in {ramp_s:g} s"
        print(f"### When {what} can be known, {given.seeds} seeds\n\n{limit.HEADER}")
        scene = steady_turn(TURN_RATE_HZ, rate_dps, minutes, ramp_s, tilt_deg)
        seeds = range(given.first, given.first + given.seeds)
        print("\n".join(limit.rows(scene, SENSORS, seeds, rate_dps / ramp_s)))


def bench(seeds: int) -> None:
    """Print a table for each rate, and one of long rests."""
    single = {grade.name: (grade,) for grade in GRADES}
    for rate_hz in RATES_HZ:
        print(f"### {rate_hz:g} Hz, {seeds} seeds of {SECONDS:.0f} s\n\n{HEADER}")
        groups = single if rate_hz == FULL_RATE_HZ else {"all five grades": GRADES}
        for name, (sensors, grades) in product(SCENES, groups.items()):
            print(
                f"| {name} | {sensors} | {tally(name, grades, rate_hz, SECONDS, seeds).row()} |", flush=True
            )
        print()
    print(f"### {FULL_RATE_HZ:g} Hz, {seeds} seeds of {LONG_S:.0f} s\n\n{HEADER}")
    for name, (sensors, grades) in product(("still", "temperature ramp"), single.items()):
        print(
            f"| {name} | {sensors} | {tally(name, grades, FULL_RATE_HZ, LONG_S, seeds).row()} |", flush=True
        )


if __name__ == "__main__":
    main()
