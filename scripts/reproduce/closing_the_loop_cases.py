"""Runs of a unit whose bias has something that its declared model lacks.

Everything is in means of one second, as `imumon.lab.diagnosis.runs` makes them, and fixed by the seed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from closing_the_loop_physics import DRIVING, IRRELEVANT, NAMED, PHYSICS, SECONDS, Generator, Thermal
from study import rms

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.runs import Run

DPH = np.pi / 180 / 3600
BLOCK = 30
SAMPLES = 100.0
WHITE_DPH = 1.6
"""White noise of a mean of 30 s."""
FLICKER_DPH = 1.0
"""1/f noise between 1/7200 and 1/60 Hz, rms of means of 30 s."""
CURVES = ((30.0, 20.0, -8.0, 3.0), (-10.0, -30.0, 5.0, 2.0), (5.0, 12.0, 10.0, -4.0))
SIGNS = (1.0, -1.0, 1.0)
EARTH_DPH = 15.04
GRAVITY = 9.81


@dataclass(frozen=True, slots=True)
class Setting:
    """What a case has beside its effect."""

    effects: tuple[str, ...]
    size: float
    """Training residual of ordinary least squares due to the effect, in standard deviations of the noise."""
    axes: tuple[int, ...] = (0, 1, 2)
    noise: str = "flicker"
    poses: bool = False
    turn_on_dph: float = 0.0
    unequal: bool = False
    start_off_degc: float = 0.0
    latitude_deg: float | None = None
    late: bool = False
    """The whole curve is over the temperature of the die, and is bent beyond a cubic."""
    driver: str = ""
    """Which further column drives the bias, of `closing_the_loop_physics`; "none" for columns alone."""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Case:
    """Three runs, two for training, and the truth."""

    setting: Setting
    runs: list[Run]
    truth: list[set[str]]
    """Names of the effects in each channel."""
    floor: float
    """rms of all noise in means of 30 s, rad/s."""


def chamber(rng: Generator, up: bool, rate: float, seconds: int = SECONDS) -> FloatArray:
    """Return the air of a chamber: ramps between two ends with soaks."""
    start, high, low = 25 + rng.uniform(-3, 3), 42 + rng.uniform(-3, 3), 12 + rng.uniform(-3, 3)
    soak = rng.uniform(400, 900)
    knots, values = [0.0], [start]
    ends = [high, low] if up else [low, high]
    while knots[-1] < seconds:
        for end in ends:
            knots.append(knots[-1] + abs(end - values[-1]) / rate * 60)
            values.append(end)
            knots.append(knots[-1] + soak)
            values.append(end)
    air: FloatArray = np.interp(np.arange(seconds) + 0.5, knots, values)
    return air


@dataclass(frozen=True, slots=True)
class Network:
    """Two nodes: air to board, board to die, with the die's own heat."""

    board_s: float
    die_s: float
    back: float
    heat_degc: float

    @classmethod
    def drawn(cls, rng: Generator) -> Network:
        """Return that of a unit."""
        return cls(rng.uniform(150, 220), rng.uniform(170, 280), rng.uniform(0.05, 0.2), rng.uniform(0.5, 2))

    def run(self, air: FloatArray, start_off_degc: float) -> Thermal:
        """Return the temperatures of a run from near equilibrium, or from so far off it."""
        board, die = np.empty(len(air)), np.empty(len(air))
        b = air[0] + start_off_degc + 0.5 * self.heat_degc
        d = air[0] + 0.2 * start_off_degc + 1.5 * self.heat_degc
        for at, outside in enumerate(air):
            b += (outside - b) / self.board_s + self.back * (d - b) / self.die_s
            d += (b - d + self.heat_degc) / self.die_s
            board[at], die[at] = b, d
        return Thermal(np.arange(len(air), dtype=np.float64) + 0.5, board, die)


POSES = np.array([[0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]], float) * GRAVITY


def make_case(setting: Setting, seed: int) -> Case:
    """Return the case of a setting and a seed; with ten further columns where it has a driver."""
    case = _thermal_case(setting, seed)
    if setting.latitude_deg is not None:
        case = replace(
            case, runs=[_with_level_earth_rate(run, setting.latitude_deg, seed) for run in case.runs]
        )
    return _with_columns(case, setting, seed) if setting.driver else case


def _with_level_earth_rate(run: Run, latitude_deg: float, seed: int) -> Run:
    """Return a run with the horizontal earth rate, too, another heading in each pose."""
    rng = np.random.default_rng([seed, 6])
    up = np.column_stack([run.mean[f"accel_{axis}"] for axis in "xyz"]) / GRAVITY
    turns = np.flatnonzero(np.abs(np.diff(up, axis=0)).max(axis=1) > 0.5) + 1
    changed = dict(run.mean)
    for rows in np.split(np.arange(len(up)), turns):
        across = np.cross(up[rows[0]].round(), rng.normal(size=3))
        level = EARTH_DPH * np.cos(np.radians(latitude_deg)) * DPH * across / np.linalg.norm(across)
        for at, axis in enumerate("xyz"):
            changed[f"gyro_{axis}"] = changed[f"gyro_{axis}"].copy()
            changed[f"gyro_{axis}"][rows] += level[at]
    return replace(run, mean=changed)


def _with_columns(case: Case, setting: Setting, seed: int) -> Case:
    """Return a case with columns that do not matter, and one that drives the bias, if any does."""
    rng, driving, runs = np.random.default_rng([seed, 77]), DRIVING.get(setting.driver), []
    for run in case.runs:
        mean = dict(run.mean)
        for name, column in IRRELEVANT.items():
            mean[name] = column(rng, run)
        if driving is not None:
            mean[driving.column] = driving.made(rng, run)
        runs.append(replace(run, mean=mean))
    if driving is None:
        return replace(case, runs=runs)
    for axis, letter in enumerate("xyz"):
        # The physics of an axis is the same in every run.
        parts = [
            driving.does(np.random.default_rng([seed, axis]), run.mean[driving.column], run) for run in runs
        ]
        temperatures = [run.mean["temperature"] for run in runs]
        factor = _factor(parts, temperatures, axis, setting.size * case.floor)
        for run, part in zip(runs, parts, strict=True):
            run.mean[f"gyro_{letter}"] = run.mean[f"gyro_{letter}"] + factor * part
    return replace(case, runs=runs, truth=[{*truth, driving.truth} for truth in case.truth])


def _thermal_case(setting: Setting, seed: int) -> Case:
    """Return the case without further columns."""
    rng = np.random.default_rng(seed)
    network = Network.drawn(rng)
    thermal = [
        network.run(chamber(rng, up, rate), setting.start_off_degc * float(rng.choice([-1, 1])))
        for up, rate in ((True, 1.0), (False, 1.0), (True, 0.7))
    ]
    noise_rms = float(np.hypot(WHITE_DPH, FLICKER_DPH if setting.noise == "flicker" else 0.0))
    poses = [_poses(rng, run, setting.poses) for run in thermal]
    bias = np.zeros((3, 3, SECONDS))
    truth: list[set[str]] = [set(), set(), set()]
    for name in setting.effects:
        for axis in setting.axes:
            for run, part in enumerate(_scaled(rng, name, setting, thermal, poses, axis, noise_rms)):
                bias[run, axis] += part
            truth[axis].add(NAMED.get(name, name))
    runs = [_recorded(rng, run, bias[at], poses[at], setting, at) for at, run in enumerate(thermal)]
    if setting.turn_on_dph:
        for channel in truth:
            channel.add("run_offset")
    return Case(setting, runs, truth, noise_rms * DPH)


def _scaled(
    rng: Generator,
    name: str,
    setting: Setting,
    thermal: list[Thermal],
    poses: list[FloatArray],
    axis: int,
    noise_rms: float,
) -> list[FloatArray]:
    """Return an effect in degrees per hour, scaled so that the declared model leaves `size` times the
    noise."""
    if name == "g_sensitivity":
        row = rng.normal(size=3)
        row[axis] = 0.0 if setting.latitude_deg is not None else row[axis]
        parts = [pose @ row for pose in poses]
    else:
        parts = [*PHYSICS[name](rng, thermal, axis)]
    if setting.unequal:
        parts = [part * factor for part, factor in zip(parts, (0.3, 1.0, 0.6), strict=True)]
    factor = _factor(parts, [run.board for run in thermal], axis, setting.size * noise_rms)
    return [part * factor for part in parts]


def _factor(parts: list[FloatArray], temperatures: list[FloatArray], axis: int, left_rms: float) -> float:
    """Return the factor with which a cubic over temperature leaves so much of two runs for training."""
    temperature, part = (np.concatenate([_means(one) for one in of[:2]]) for of in (temperatures, parts))
    columns = ((temperature - 25) / 20)[:, np.newaxis] ** np.arange(4)
    left = part - columns @ np.linalg.lstsq(columns, part, rcond=None)[0]
    return SIGNS[axis] * left_rms / rms(left)


def _means(values: FloatArray) -> FloatArray:
    return np.asarray(values.reshape(-1, BLOCK).mean(axis=1))


def _poses(rng: Generator, run: Thermal, several: bool) -> FloatArray:
    """Return the specific force in body axes, (n, 3)."""
    if not several:
        return np.tile(POSES[0], (len(run.time_s), 1))
    order = rng.permutation(len(POSES))
    which = np.minimum((run.time_s // (SECONDS / len(POSES))).astype(int), len(POSES) - 1)
    return np.asarray(POSES[order[which]])


def _recorded(
    rng: Generator, thermal: Thermal, bias_dph: FloatArray, pose: FloatArray, setting: Setting, at: int
) -> Run:
    """Return what the diagnosis reads: means and scatter of each second."""
    n = len(thermal.time_s)
    reading = np.round((thermal.board + 0.01 * rng.standard_normal(n)) * 16) / 16
    mean: dict[str, FloatArray] = {"temperature": reading}
    variance: dict[str, FloatArray] = {}
    u = ((thermal.die if setting.late else thermal.board) - 25) / 20
    second_sd = WHITE_DPH * np.sqrt(BLOCK)
    for axis, letter in enumerate("xyz"):
        turn_on = (0.0, rng.choice([-1.0, 1.0]), rng.uniform(-1, 1))[at]
        total = np.polynomial.polynomial.polyval(u, CURVES[axis]) + bias_dph[axis]
        total = total + second_sd * rng.standard_normal(n) + _slow(rng, n, setting.noise)
        total = total + setting.turn_on_dph * turn_on
        if setting.latitude_deg is not None:
            total = total + EARTH_DPH * np.sin(np.radians(setting.latitude_deg)) * pose[:, axis] / GRAVITY
        mean[f"gyro_{letter}"] = total * DPH
        scatter = rng.chisquare(SAMPLES - 1, n) / (SAMPLES - 1)
        variance[f"gyro_{letter}"] = (second_sd * DPH) ** 2 * SAMPLES * scatter
        mean[f"accel_{letter}"] = pose[:, axis] + 1e-3 * rng.standard_normal(n)
        variance[f"accel_{letter}"] = np.full(n, 1e-4)
    count = dict.fromkeys(mean, np.full(n, SAMPLES))
    return Run(f"run {at + 1}", thermal.time_s, count, mean, variance, np.ones(n))


def _slow(rng: Generator, n: int, kind: str) -> FloatArray:
    if kind == "white":
        return np.zeros(n)
    if kind == "walk":
        return np.asarray(np.cumsum(rng.standard_normal(n)) * 3.0 / np.sqrt(SECONDS))
    frequency = np.fft.rfftfreq(n, 1.0)
    amplitude = np.zeros(len(frequency))
    band = (frequency >= 1 / 7200) & (frequency <= 1 / 60)
    amplitude[band] = 1 / np.sqrt(frequency[band])
    phasors = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    values = np.fft.irfft(amplitude * phasors, n)
    # Scaled by its expectation, not by what this draw happens to have.
    expected = np.sqrt(2 * np.sum(amplitude**2) * 2) / n
    return np.asarray(FLICKER_DPH * values / expected)
