"""Every estimator outside the scenarios it was built on, in one table: errors, peers, errors over sigma."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, product
from pathlib import Path

import numpy as np
import rest_scenes
import thermometers
from bias_race_study import DEFAULTS, vqf
from broad import bias_errors
from field_surprises import SURPRISES, met
from handled_units import CASES, MOVING, RATE_HZ, estimated, places, simulate
from scipy.signal import savgol_filter
from study import Cells, Options, Study, Table, largest, matrix, rms, worst_first

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import DEG_PER_H

HOLD_S, RAMP_S = 300.0, 300.0
SMOOTH_S = 600.0
"""Window of the Savitzky-Golay filter, which uses what comes later."""
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
    rate_hz = rest_scenes.TURN_RATE_HZ
    scenes: dict[str, Callable[[int], rest_scenes.Scene]] = {}
    for rate, minutes, begun, tilt in rest_scenes.TURNS:
        name = f"turn of {rate:g} °/s for {minutes:g} min, begun in {begun:g} s, {tilt:g}° off the vertical"
        scenes[name] = partial(rest_scenes.steady_turn, rate_hz, rate, minutes, begun, tilt)
    for name, moving in rest_scenes.SCENES.items():
        scenes[name] = partial(moving, rest_scenes.FULL_RATE_HZ, 2 * rest_scenes.SECONDS)
    for grade, (name, make) in product(rest_scenes.SENSORS, scenes.items()):
        found, ratios = [], []
        for seed in seeds:
            scene = make(seed)
            samples, truth = rest_scenes.measure_with_bias(scene, grade, seed)
            ours = samples.with_columns(RestAndBias().process(samples))
            found.append((scene.rest, ours["at_rest"] == 1, rest_scenes.vqf_rest(samples)))
            ratio = (matrix(ours, "gyro_bias") - truth) / matrix(ours, "gyro_bias_sd")
            ratios.append(ratio[:: round(rate_hz)].ravel())
        rest, by_us, by_vqf = (np.concatenate(of) for of in zip(*found, strict=True))
        peers = {"VQF": rest_scenes.percent(by_vqf, ~rest), "rest found": rest_scenes.percent(by_us, rest)}
        false = rest_scenes.percent(by_us, ~rest)
        yield Row("rest", f"{name}, {grade.name}", "% false", false, np.concatenate(ratios), peers)


def thermometer_rows(seeds: range, _: Path) -> Iterator[Row]:
    """Every kind of thermometer, at constant, drifting and ramping temperature: the rate of temperature."""
    steady = (thermometers.STEADY_S, thermometers.SETTLED_S)
    for kind in thermometers.KINDS:
        for name, profile, length, start in (
            ("constant", thermometers.constant, *steady),
            ("5 °C/h", thermometers.drifting, *steady),
            (
                "2 °C/min after 300 s",
                thermometers.ramp(HOLD_S),
                HOLD_S + RAMP_S,
                HOLD_S + thermometers.ONSET_S + kind.refresh_s,
            ),
        ):
            runs = [thermometers.errors(kind, profile, length, seed) for seed in seeds]
            late = [run["t"] > start for run in runs]
            off, ratios = (
                np.concatenate([run[what][where] for run, where in zip(runs, late, strict=True)])
                for what in ("rate", "rate_z")
            )
            played = (thermometers.play(kind, profile, length, seed) for seed in seeds)
            smooth = [smoother_errors(kind.rate_hz, start, *one) for one in played]
            peers = {"Savitzky-Golay": rms(np.concatenate(smooth))}
            yield Row("thermometer", f"{kind.name}, {name}", "°C/h", rms(off), ratios, peers)


def smoother_errors(
    rate_hz: float, start_s: float, t: FloatArray, _: FloatArray, rate: FloatArray, reading: FloatArray
) -> FloatArray:
    """Return errors of the rate, °C/h, by a smoother of means of a second, from a time on."""
    each = max(round(rate_hz), 1)
    dt = each / rate_hz
    seconds = reading[: len(t) // each * each].reshape(-1, each).mean(1)
    window = min(round(SMOOTH_S / dt), len(seconds)) // 2 * 2 - 1
    off = savgol_filter(seconds, window, 2, deriv=1, delta=dt) - rate[each - 1 :: each][: len(seconds)]
    return np.asarray(off[(np.arange(len(seconds)) + 1) * dt > start_s] * thermometers.PER_HOUR)


def bias_rows(seeds: range, _: Path) -> Iterator[Row]:
    """A unit in a hand, on a rover, in a car: the bias at rest and in motion."""
    for name, case in CASES.items():
        ratios, errors = [], []
        for seed in seeds:
            record = simulate(case, seed)
            error, sd, estimates = estimated(case, record)
            rows, motion = places(record.rest)
            ratios.append((error / sd)[rows].ravel())
            others = (method(estimates) - record.bias - record.earth for method in DEFAULTS.values())
            errors.append([of[motion].ravel() for of in (error, *others)])
        ours, *peers = (rms(np.concatenate(parts)) / DEG_PER_H for parts in zip(*errors, strict=True))
        yield Row("bias", name, "°/h", ours, np.concatenate(ratios), dict(zip(DEFAULTS, peers, strict=True)))


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
