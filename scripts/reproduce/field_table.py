"""Every estimator outside the scenarios it was built on, in one table: errors, peers, errors over sigma."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from alignment_site import AT_S, outcome
from alignment_site_scenes import SCENES as SITES
from bias_race_runners import DEFAULTS, Run
from bias_sigma_records import RATE_HZ, simulate
from bias_sigma_table import CASES, estimated, places
from field_comparison import load, save, show_beside
from field_measured import measured_motion
from field_surprises import SURPRISES, met
from rest_detector_scenes import SCENES, SENSORS, Scene, measure_with_bias, steady_turn
from rest_detector_table import (
    FIELD,
    FULL_RATE_HZ,
    SECONDS,
    TURN_RATE_HZ,
    TURNS,
    Tally,
    bias_over_sigma,
    the_same,
    vqf_rest,
)
from scipy.signal import savgol_filter
from study import largest, matrix, rms
from thermometer_kinds import KINDS, PER_HOUR, Kind, Profile, constant, drifting, ramp
from thermometers_table import ONSET_S, SETTLED_S, STEADY_S, errors

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.recordings.table import read_table
from imumon.simulation.unit.scenario import load_scenario

PARTS = ("rest", "thermometer", "north", "bias", "surprises", "measured")
HOLD_S, RAMP_S = 300.0, 300.0
SMOOTH_S = 600.0
"""Window of the Savitzky-Golay filter, which sees what comes later."""


@dataclass(frozen=True, slots=True)
class Row:
    """A kind of data: the error and those of others, with a unit, and error over sigma."""

    part: str
    kind: str
    unit: str
    error: float
    ratios: FloatArray
    peers: dict[str, float] = field(default_factory=dict)

    @property
    def rms(self) -> float:
        """Root mean square of error over sigma; NaN where nothing was claimed."""
        return rms(self.ratios)

    @property
    def largest(self) -> float:
        """Largest error over sigma."""
        return largest(self.ratios)

    def saved(self, cpu_s: float) -> dict[str, Any]:
        """Return what `--out` writes of the row; `cpu_s` is what it cost, peers and simulation included."""
        known = self.ratios[np.isfinite(self.ratios)]
        return {
            "part": self.part,
            "kind": self.kind,
            "unit": self.unit,
            "error": self.error,
            "z": self.rms,
            "zmax": self.largest,
            "beyond5": float(np.mean(np.abs(known) > 5.0)) if len(known) else None,
            "claimed": float(np.mean(np.isfinite(self.ratios))),
            "peers": self.peers,
            "cpu": cpu_s,
        }

    def cells(self) -> list[str]:
        """Return the row as text."""
        peers = ", ".join(f"{name} {value:.3g}" for name, value in self.peers.items())
        claimed = 100.0 * float(np.mean(np.isfinite(self.ratios)))
        numbers = [f"{self.error:.3g} {self.unit}", peers, f"{claimed:.0f} %"]
        return [self.part, self.kind, *numbers, f"{self.rms:.2f}", f"{self.largest:.1f}"]


def rest_rows(seeds: range) -> Iterator[Row]:
    """Steady turns, slow tilts, hands and cars, with six grades of sensors: motion taken for rest."""
    scenes: list[tuple[str, Callable[[int], Scene]]] = [
        (
            f"turn of {rate:g} °/s for {minutes:g} min, begun in {begun:g} s, {tilt:g}° off the vertical",
            partial(the_same, steady_turn(TURN_RATE_HZ, rate, minutes, begun, tilt)),
        )
        for rate, minutes, begun, tilt in TURNS
    ]
    scenes += [(name, partial(SCENES[name], FULL_RATE_HZ, 2 * SECONDS)) for name in FIELD]
    for grade in SENSORS:
        for name, make in scenes:
            ours, theirs, ratios = Tally(), Tally(), []
            for seed in seeds:
                scene = make(seed)
                samples, truth = measure_with_bias(scene, grade, seed)
                found = samples.with_columns(RestAndBias().process(samples))
                ours.add(scene.t, scene.rest, found["at_rest"] == 1)
                theirs.add(scene.t, scene.rest, vqf_rest(samples))
                ratios.append(bias_over_sigma(found, truth)[:: round(TURN_RATE_HZ)].ravel())
            peers = {"VQF": theirs.percent()[0], "rest found": ours.percent()[1]}
            yield Row(
                "rest", f"{name}, {grade.name}", "% false", ours.percent()[0], np.concatenate(ratios), peers
            )


def thermometer_rows(seeds: range) -> Iterator[Row]:
    """Every kind of thermometer, at constant, drifting and ramping temperature: the rate of temperature."""
    for kind in KINDS:
        for name, profile, length, start in (
            ("constant", constant, STEADY_S, SETTLED_S),
            ("5 °C/h", drifting, STEADY_S, SETTLED_S),
            ("2 °C/min after 300 s", ramp(HOLD_S), HOLD_S + RAMP_S, HOLD_S + ONSET_S + kind.refresh_s),
        ):
            runs = [errors(kind, profile, length, seed) for seed in seeds]
            late = [run["t"] > start for run in runs]
            off, ratios = (
                np.concatenate([run[what][where] for run, where in zip(runs, late, strict=True)])
                for what in ("rate", "rate_z")
            )
            peers = thermometer_peers(kind, profile, length, start, seeds)
            yield Row("thermometer", f"{kind.name}, {name}", "°C/h", rms(off), ratios, peers)


def thermometer_peers(
    kind: Kind, profile: Profile, length: float, start: float, seeds: range
) -> dict[str, float]:
    """Return the rms of others' rates in °C/h: of a smoother and of a Kalman filter of two states."""
    found: dict[str, list[FloatArray]] = {"Savitzky-Golay": [], "Kalman": []}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        t = np.arange(int(length * kind.rate_hz)) / kind.rate_hz
        temperature, rate = profile(t, 25.0 + rng.uniform(-0.5, 0.5))
        each = max(round(kind.rate_hz), 1)
        seconds = kind.read(temperature, rng)[: len(t) // each * each].reshape(-1, each).mean(1)
        truth = rate[each - 1 :: each][: len(seconds)]
        dt = each / kind.rate_hz
        window = min(round(SMOOTH_S / dt), len(seconds)) // 2 * 2 - 1
        smooth = savgol_filter(seconds, window, 2, deriv=1, delta=dt)
        late = (np.arange(len(seconds)) + 1) * dt > start
        found["Savitzky-Golay"].append((smooth - truth)[late] * PER_HOUR)
        found["Kalman"].append((two_states(seconds, dt, kind) - truth)[late] * PER_HOUR)
    return {name: rms(np.concatenate(parts)) for name, parts in found.items()}


def two_states(readings: FloatArray, dt: float, kind: Kind) -> FloatArray:
    """Return the rate by a Kalman filter of temperature and rate, which walks by 1e-5 °C/s in √s."""
    noise = max(kind.step**2 / 12.0, 1e-8) + float(np.var(np.diff(readings)) / 2.0)
    x, p = np.array([readings[0], 0.0]), np.diag([noise, 1e-2])
    step, walk = np.array([[1.0, dt], [0.0, 1.0]]), np.diag([0.0, 1e-10 * dt])
    rates = np.empty(len(readings))
    for k, reading in enumerate(readings):
        x, p = step @ x, step @ p @ step.T + walk
        gain = p[:, 0] / (p[0, 0] + noise)
        x, p = x + gain * (reading - x[0]), p - np.outer(gain, p[0])
        rates[k] = x[1]
    return rates


def north_rows(seeds: range) -> Iterator[Row]:
    """Sites that sway, are walked upon and settle: the heading after 20, 60 and 600 s."""
    for scene in SITES:
        found = np.array([outcome(scene, seed)[0] for seed in seeds])
        for k, second in enumerate(AT_S):
            error, sd, plain, hann = found[:, k].T
            peers = {"plain mean": rms(plain), "Hann mean": rms(hann)}
            yield Row("north", f"{scene.name}, {second} s", "°", rms(error), error / sd, peers)


def bias_rows(seeds: range) -> Iterator[Row]:
    """A unit in a hand, on a rover, in a car: the bias at rest and in motion."""
    scenario = load_scenario("warm-up").model_copy(update={"rate_hz": RATE_HZ})
    for name, case in CASES.items():
        ratios, mistakes = [], []
        peers: dict[str, list[FloatArray]] = {peer: [] for peer in DEFAULTS}
        for seed in seeds:
            record = simulate(case, seed)
            error, sd, estimates = estimated(case, record)
            where = places(record.rest)
            rows = np.concatenate([where.ends, where.before, where.motion[:: round(RATE_HZ)]])
            ratios.append((error / sd)[rows].ravel())
            mistakes.append(error[where.motion].ravel())
            time_s = estimates.samples["device_time_ns"] * 1e-9
            run = Run(scenario, estimates.samples, record.bias, record.earth, time_s, record.rest)
            for peer, method in DEFAULTS.items():
                peers[peer].append((method(run) - record.bias - record.earth)[where.motion].ravel())
        others = {peer: rms(np.concatenate(parts)) / DEG_PER_H for peer, parts in peers.items()}
        found = np.concatenate(ratios)
        yield Row("bias", name, "°/h", rms(np.concatenate(mistakes)) / DEG_PER_H, found, others)


def surprise_rows(seeds: range) -> Iterator[Row]:
    """Gaps, corners, broken thermometers, bias that jumps: the bias, the temperature and its rate."""
    for name, make in SURPRISES.items():
        found = [met(make, seed) for seed in seeds]
        for what, unit in (("bias", "°/h"), ("temperature", "°C"), ("rate", "°C/h")):
            error, ratios = (
                np.concatenate([getattr(one, of)[what].ravel() for one in found]) for of in ("error", "ratio")
            )
            beyond = {"beyond 5 σ, %": 100.0 * float(np.mean(np.abs(ratios[np.isfinite(ratios)]) > 5.0))}
            after_s = np.concatenate([one.after_s(what, 5.0) for one in found])
            if len(after_s):
                beyond["nine in ten of it within s of a corner"] = float(np.quantile(after_s, 0.9))
            yield Row("surprises", f"{name}: {what}", unit, rms(error), ratios, beyond)


def measured_rows(folder: Path) -> Iterator[Row]:
    """Tables in the units of imumon with the true bias in columns true_gyro_bias_{x,y,z}."""
    for path in sorted([*folder.glob("*.parquet"), *folder.glob("*.csv")]):
        samples, _ = read_table(path)
        if "true_gyro_bias_x" not in samples:
            print(f"{path.name}: no column true_gyro_bias_x, so it is left out", file=sys.stderr)
            continue
        for stage in (TemperatureRate(), RestAndBias()):
            samples = samples.with_columns(stage.process(samples))
        error = matrix(samples, "gyro_bias") - matrix(samples, "true_gyro_bias")
        ratios = error / matrix(samples, "gyro_bias_sd")
        yield Row("measured", path.stem, "°/h", rms(error) / DEG_PER_H, ratios.ravel())


def motion_rows(_: range) -> Iterator[Row]:
    """Measured hands: the bias at the end of motion against the mean of the rest that follows."""
    for name, error, ratios, false_percent in measured_motion():
        yield Row("measured", name, "°/h", error, ratios, {"% of motion called rest": false_percent})


MAKERS: dict[str, Callable[[range], Iterator[Row]]] = {
    "rest": rest_rows,
    "thermometer": thermometer_rows,
    "north": north_rows,
    "bias": bias_rows,
    "surprises": surprise_rows,
    "measured": motion_rows,
}


def show(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Print the table, the row with the largest rms of error over sigma first; return what is saved of it."""
    done, saved = [], []
    begun_s = time.process_time()
    for row in rows:
        print(" | ".join(row.cells()), file=sys.stderr, flush=True)
        done.append(row)
        saved.append(row.saved(time.process_time() - begun_s))
        begun_s = time.process_time()
    heads = ["part", "kind", "rms error", "others", "claimed", "error/σ rms", "max"]
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in sorted(done, key=lambda row: -np.nan_to_num(row.rms)):
        print("| " + " | ".join(row.cells()) + " |")
    return saved


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce/field", description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="runs of each kind (default: %(default)s)")
    parser.add_argument("--first", type=int, default=1000, help="first seed (default: %(default)s)")
    parser.add_argument("--part", choices=PARTS, action="append", help="only this part")
    parser.add_argument("--data", type=Path, help="folder of tables with the true bias")
    parser.add_argument("--out", type=Path, help="write the rows as JSON, one a line")
    parser.add_argument("--beside", type=Path, action="append", help="compare with rows that --out wrote")
    parser.add_argument("--quick", action="store_true", help="one seed, and the first kind of each part")
    given = parser.parse_args()
    seeds = range(given.first, given.first + (1 if given.quick else given.seeds))
    parts = given.part or PARTS
    others = [row for path in given.beside or () for row in load(path)]

    def rows() -> Iterator[Row]:
        for part in parts:
            yield from islice(MAKERS[part](seeds), 1 if given.quick else None)
        if given.data:
            yield from measured_rows(given.data)

    done = show(rows())
    if given.out:
        save(done, given.out)
    if others:
        show_beside(done, others)


if __name__ == "__main__":
    main()
