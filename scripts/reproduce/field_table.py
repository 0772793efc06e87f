"""Every estimator outside the scenarios it was built on, in one table: errors, peers, errors over sigma."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from bias_race_study import DEFAULTS, vqf
from broad import bias_errors
from field_surprises import SURPRISES, met
from handled_units import CASES, MOVING, RATE_HZ, estimated, places, simulate
from rest_scenes import (
    FULL_RATE_HZ,
    SCENES,
    SECONDS,
    SENSORS,
    TURN_RATE_HZ,
    TURNS,
    Scene,
    bias_over_sigma,
    measure_with_bias,
    percent,
    steady_turn,
    vqf_rest,
)
from scipy.signal import savgol_filter
from study import Cells, Options, Study, Table, largest, rms, worst_first
from thermometers import (
    KINDS,
    ONSET_S,
    PER_HOUR,
    SETTLED_S,
    STEADY_S,
    Kind,
    Profile,
    constant,
    drifting,
    errors,
    ramp,
)

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import DEG_PER_H

HOLD_S, RAMP_S = 300.0, 300.0
SMOOTH_S = 600.0
"""Window of the Savitzky-Golay filter, which sees what comes later."""
FIRST_WINDOW_S = 70.0
"""Of a unit that never rests; the first value comes after a minute."""
HEADS = ("part", "kind", "rms error", "others", "claimed", "error/σ rms", "max")


@dataclass(frozen=True, slots=True)
class Row:
    """A kind of data: the error and those of others, with a unit, and error over sigma."""

    part: str
    kind: str
    unit: str
    error: float
    ratios: FloatArray
    peers: dict[str, float] = field(default_factory=dict)

    def cells(self) -> list[str]:
        """Return the row as text."""
        peers = ", ".join(f"{name} {value:.3g}" for name, value in self.peers.items())
        claimed = 100.0 * float(np.mean(np.isfinite(self.ratios)))
        numbers = [f"{self.error:.3g} {self.unit}", peers, f"{claimed:.0f} %"]
        return [self.part, self.kind, *numbers, f"{rms(self.ratios):.2f}", f"{largest(self.ratios):.1f}"]


def rest_rows(seeds: range, _: Path) -> Iterator[Row]:
    """Steady turns, slow tilts, hands and cars, with six grades of sensors: motion taken for rest."""
    scenes: list[tuple[str, Callable[[int], Scene]]] = [
        (
            f"turn of {rate:g} °/s for {minutes:g} min, begun in {begun:g} s, {tilt:g}° off the vertical",
            partial(steady_turn, TURN_RATE_HZ, rate, minutes, begun, tilt),
        )
        for rate, minutes, begun, tilt in TURNS
    ]
    scenes += [(name, partial(make, FULL_RATE_HZ, 2 * SECONDS)) for name, make in SCENES.items()]
    for grade in SENSORS:
        for name, make in scenes:
            found, ratios = [], []
            for seed in seeds:
                scene = make(seed)
                samples, truth = measure_with_bias(scene, grade, seed)
                ours = samples.with_columns(RestAndBias().process(samples))
                found.append((scene.rest, ours["at_rest"] == 1, vqf_rest(samples)))
                ratios.append(bias_over_sigma(ours, truth)[:: round(TURN_RATE_HZ)].ravel())
            rest, by_us, by_vqf = (np.concatenate(of) for of in zip(*found, strict=True))
            peers = {"VQF": percent(by_vqf, ~rest), "rest found": percent(by_us, rest)}
            false = percent(by_us, ~rest)
            yield Row("rest", f"{name}, {grade.name}", "% false", false, np.concatenate(ratios), peers)


def thermometer_rows(seeds: range, _: Path) -> Iterator[Row]:
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
    """Return the rms of the rate in °C/h by a smoother."""
    found = []
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
        found.append((smooth - truth)[late] * PER_HOUR)
    return {"Savitzky-Golay": rms(np.concatenate(found))}


def bias_rows(seeds: range, _: Path) -> Iterator[Row]:
    """A unit in a hand, on a rover, in a car: the bias at rest and in motion."""
    for name, case in CASES.items():
        ratios, mistakes = [], []
        peers: dict[str, list[FloatArray]] = {peer: [] for peer in DEFAULTS}
        for seed in seeds:
            record = simulate(case, seed)
            error, sd, estimates = estimated(case, record)
            rows, motion = places(record.rest)
            ratios.append((error / sd)[rows].ravel())
            mistakes.append(error[motion].ravel())
            for peer, method in DEFAULTS.items():
                peers[peer].append((method(estimates) - record.bias - record.earth)[motion].ravel())
        others = {peer: rms(np.concatenate(parts)) / DEG_PER_H for peer, parts in peers.items()}
        found = np.concatenate(ratios)
        yield Row("bias", name, "°/h", rms(np.concatenate(mistakes)) / DEG_PER_H, found, others)


def moving_rows(seeds: range, _: Path) -> Iterator[Row]:
    """Vehicles, a boat, somebody who walks and a drone that never rest: the bias once a second."""
    later = slice(round(FIRST_WINDOW_S * RATE_HZ), None, round(RATE_HZ))
    for name, case in MOVING.items():
        found = []
        for seed in seeds:
            record = simulate(case, seed)
            error, sd, estimates = estimated(case, record)
            other = vqf()(estimates) - record.bias - record.earth
            found.append([of[later].ravel() / DEG_PER_H for of in (error, sd, other)])
        error, sd, other = (np.concatenate(parts) for parts in zip(*found, strict=True))
        peers = {"VQF, the same axes": rms(other[np.isfinite(error)]), "VQF, all axes": rms(other)}
        peers["median σ"] = float(np.nanmedian(sd))
        yield Row("moving", name, "°/h", rms(error), error / sd, peers)


def surprise_rows(seeds: range, _: Path) -> Iterator[Row]:
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


def measured_rows(seeds: range, data: Path) -> Iterator[Row]:
    """Measured hands: the bias at the end of motion against the mean of the rest that follows."""
    del seeds
    for path in sorted((data / "broad").glob("*.npz")):
        error, ratios, false_percent = bias_errors(path)
        peers = {"% of motion called rest": false_percent}
        yield Row("measured", path.stem, "°/h", rms(error) / DEG_PER_H, ratios, peers)


def study(rows: Callable[[range, Path], Iterator[Row]]) -> Study:
    """Return the study of a part: its rows, that with the largest rms of error over sigma first."""

    def tables(given: Options) -> Iterator[Table]:
        done: list[tuple[float, Cells]] = []
        for row in islice(rows(given.seeds, given.data), 1 if given.quick else None):
            print(" | ".join(row.cells()), file=sys.stderr, flush=True)
            done.append((float(np.nan_to_num(rms(row.ratios))), row.cells()))
        yield Table("", HEADS, worst_first(done))

    return Study(tables, seeds=3, first=1000)


REST, THERMOMETER = study(rest_rows), study(thermometer_rows)
BIAS, MOVING_BIAS = study(bias_rows), study(moving_rows)
SURPRISE, MEASURED = study(surprise_rows), study(measured_rows)
