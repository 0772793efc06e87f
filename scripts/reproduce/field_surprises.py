"""What cannot be predicted: gaps, corners, broken thermometers, bias that jumps; with physics of its own.

A unit at rest: its gyros' temperature lags that of the thermometer, their bias follows it by a parabola, and
1/f noise is three Gauss-Markov processes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from samples import sent
from scipy.signal import lfilter
from study import matrix

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H, STANDARD_GRAVITY
from imumon.pipeline import Pipeline

SLOPE_DPH = np.array([60.0, -90.0, 20.0])
CURVATURE_DPH = np.array([0.5, -1.0, 0.3])
TURN_ON_DPH = np.array([500.0, -900.0, 200.0])
"""Bias over temperature less 25 °C: deg/h/°C, deg/h/°C², deg/h."""
FLICKER_DPH, ANGLE_WALK = 5.0, 0.2
"""Of the processes together, and in deg/√h."""
FLICKER_TAUS_S = (3.0, 30.0, 300.0)
POWER_ON_DEGC = 85.0
"""What a DS18B20 reads before its first conversion."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What a scene is."""

    t: FloatArray
    degc: FloatArray
    """Time, s, and temperature, (n,)."""
    dph: FloatArray
    """Bias beside that of the temperature, deg/h, (n, 3)."""
    kept: npt.NDArray[np.bool_]
    """Samples that are not lost on the way, (n,)."""
    misread: FloatArray
    vibration: FloatArray
    """What the thermometer reads instead, NaN where nothing; and m/s², (n,)."""
    step_degc: float = 0.1
    noise_degc: float = 0.02
    lag_s: float = 30.0
    """Of the thermometer, and of the gyros behind it."""
    corners_s: tuple[float, ...] = ()


def lagged(values: FloatArray, tau_s: float, dt: float) -> FloatArray:
    """Return what follows values with a time constant, in equilibrium at first."""
    keep = math.exp(-dt / tau_s)
    follows, _ = lfilter([1.0 - keep], [1.0, -keep], values, zi=[keep * values[0]])
    return np.asarray(follows)


def plain(seconds: float, rate_hz: float, degc: Callable[[FloatArray], FloatArray]) -> Truth:
    """Return a scene in which nothing happens but a course of temperature."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    n = len(t)
    return Truth(t, degc(t), np.zeros((n, 3)), np.ones(n, np.bool_), np.full(n, np.nan), np.zeros(n))


def course(times_s: list[float], degc: list[float], lag_s: float = 0.0) -> Callable[[FloatArray], FloatArray]:
    """Return a course of temperature between points, with rounded corners where there is a lag."""

    def at(t: FloatArray) -> FloatArray:
        sharp = np.interp(t, times_s, degc)
        return lagged(sharp, lag_s, float(t[1] - t[0])) if lag_s else sharp

    return at


def gap(rng: np.random.Generator, gap_s: float = 1100.0, rate_hz: float = 10.0) -> Truth:
    """Return a ramp of 100 °C/h that turns round in a gap."""
    turn_s, sign = 900.0 + rng.uniform(0.0, 1.0) * gap_s, rng.choice([-1.0, 1.0])
    end_s = 900.0 + gap_s + 60.0
    times = [0.0, 300.0, turn_s, end_s]
    moved = np.cumsum([0.0, 0.0, (turn_s - 300.0) / 36.0, -(end_s - turn_s) / 36.0 * rng.uniform(0.0, 1.0)])
    # No chamber goes farther than 60 °C from where it began.
    scene = plain(end_s, rate_hz, course(times, [*(25.0 + sign * np.clip(moved, -60.0, 60.0))], 30.0))
    return replace(scene, kept=(scene.t < 900.0) | (scene.t >= 900.0 + gap_s))


def ramp_end(rng: np.random.Generator) -> Truth:
    """Return a ramp that begins and ends from one moment to the next."""
    begin_s, end_s = rng.uniform(580.0, 620.0), rng.uniform(1180.0, 1220.0)
    top = 25.0 + (end_s - begin_s) / 3600.0 * 100.0 * rng.choice([-1.0, 1.0])
    return plain(1800.0, 10.0, course([0.0, begin_s, end_s, 1800.0], [25.0, 25.0, top, top]))


def chamber(rng: np.random.Generator, step_degc: float, hold_s: float) -> Truth:
    """Return a profile of 20 °C up and down at 1 °C/min; a triangle where nothing is held between."""
    parts = [(rng.uniform(240.0, 360.0), 0.0)]
    for way in (20.0, -20.0, 20.0):
        parts += [(1200.0, way), *([(hold_s, 0.0)] if hold_s else [])]
    times, moved = np.cumsum([(0.0, rng.uniform(24.5, 25.5)), *parts], axis=0).T
    scene = plain(times[-1], 10.0, course([*times], [*moved]))
    return replace(scene, step_degc=step_degc, corners_s=tuple(times[1:-1]))


def broken_start(rng: np.random.Generator, reading_degc: float, seconds: float) -> Truth:
    """Return a thermometer that has not measured yet when it is read first."""
    rate = rng.uniform(-1.0, 1.0) / 60.0
    scene = plain(900.0, 20.0, lambda t: 25.0 + rate * t)
    return replace(scene, misread=np.where(scene.t < seconds, reading_degc, np.nan), step_degc=0.0625)


def warm_up(rng: np.random.Generator) -> Truth:
    """Return a board that warms by 20 °C from power-on."""
    tau_s = math.exp(rng.uniform(math.log(10.0), math.log(400.0)))
    scene = plain(900.0, 50.0, lambda t: 22.0 + 20.0 * (1.0 - np.exp(-t / tau_s)))
    return replace(scene, step_degc=0.0625, lag_s=5.0)


def telegraph(rng: np.random.Generator) -> Truth:
    """Return a bias that jumps by 30 to 120 deg/h every two minutes or so."""
    scene = plain(3600.0, 25.0, lambda t: np.full(len(t), 30.0))
    flips = rng.random((len(scene.t), 3)) < 1.0 / (120.0 * 25.0)
    return replace(scene, dph=np.where(np.cumsum(flips, 0) % 2, 1.0, -1.0) * [30.0, 60.0, 15.0])


def stuck_thermometer(rng: np.random.Generator) -> Truth:
    """Return a thermometer that reads 85 °C for 8 s now and then, and nonsense for one reading."""
    scene = plain(2400.0, 20.0, course([0.0, 300.0, 1200.0, 2400.0], [25.0, 25.0, 45.0, 30.0], 60.0))
    misread = np.where(
        rng.random(len(scene.t)) < 0.002, rng.choice([85.0, -127.0, 0.0], len(scene.t)), np.nan
    )
    for start_s in (300.0, 1000.0, 1700.0):
        misread[(scene.t >= start_s) & (scene.t < start_s + 8.0)] = POWER_ON_DEGC
    return replace(scene, misread=misread, step_degc=0.0625, noise_degc=0.0)


def fan(rng: np.random.Generator) -> Truth:
    """Return a bench with a fan that goes on and off every minute; the gyros rectify its vibration."""
    phase_s = rng.uniform(0.0, 60.0)
    scene = plain(1800.0, 100.0, lambda t: 30.0 + 3.0 * np.sin(t / 300.0))
    turning = lagged(((scene.t + phase_s) % 120.0 > 60.0).astype(np.float64), 2.0, 0.01)
    return replace(scene, dph=turning[:, np.newaxis] * [60.0, -100.0, 40.0], vibration=turning)


SURPRISES: dict[str, Callable[[np.random.Generator], Truth]] = {
    "gap of 20 min in which a ramp turns": gap,
    "ramp that begins and ends at once": ramp_end,
    **{
        f"{shape} of 1 °C/min, steps of {step:g} °C": partial(chamber, step_degc=step, hold_s=hold)
        for shape, hold in (("triangle", 0.0), ("trapezoid", 600.0))
        for step in (0.0625, 1.0)
    },
    "warm-up from power-on": warm_up,
    "telegraph of the bias": telegraph,
    "thermometer that sticks at 85 °C": stuck_thermometer,
    **{
        f"thermometer that reads {value:g} °C {how}": partial(
            broken_start, reading_degc=value, seconds=length
        )
        for value in (POWER_ON_DEGC, 0.0)
        for how, length in (("once at power-on", 0.05), ("for 10 s from power-on", 10.0))
    },
    "fan that the gyros rectify": fan,
}


def samples_of(scene: Truth, rng: np.random.Generator) -> tuple[SampleBlock, FloatArray]:
    """Return what is recorded, and the true bias, (n, 3), rad/s."""
    n, dt = len(scene.t), float(scene.t[1] - scene.t[0])
    offset = lagged(scene.degc, scene.lag_s, dt)[:, np.newaxis] - 25.0
    bias = (scene.dph + TURN_ON_DPH + SLOPE_DPH * offset + CURVATURE_DPH * offset**2) * DEG_PER_H
    share = FLICKER_DPH / math.sqrt(len(FLICKER_TAUS_S)) * DEG_PER_H
    for tau_s in FLICKER_TAUS_S:
        keep = math.exp(-dt / tau_s)
        first = rng.normal(size=(1, 3)) * share
        drive = rng.normal(size=(n, 3)) * share * math.sqrt(1.0 - keep**2)
        bias = bias + lfilter([1.0], [1.0, -keep], drive, axis=0, zi=keep * first)[0]
    shaken = np.sin(2.0 * math.pi * 47.3 * scene.t) * scene.vibration
    walk = math.radians(ANGLE_WALK) / 60.0 / math.sqrt(dt)
    gyro = bias + walk * rng.normal(size=(n, 3)) + np.outer(shaken, [0.02, 0.03, 0.01])
    accel = np.array([0.1, 0.3, -STANDARD_GRAVITY]) + np.outer(shaken, [0.2, 0.3, 0.25])
    accel = accel + 1e-3 / math.sqrt(dt) * rng.normal(size=(n, 3))
    reading = np.round((scene.degc + scene.noise_degc * rng.normal(size=n)) / scene.step_degc)
    reading = np.where(np.isnan(scene.misread), reading * scene.step_degc, scene.misread)
    samples = sent(scene.t, temperature=reading, gyro=gyro, accel=accel)
    kept = {name: values[scene.kept] for name, values in samples.columns.items()}
    return SampleBlock(kept), bias[scene.kept]


@dataclass(frozen=True, eq=False)
class Outcome:
    """Errors of bias (deg/h), temperature and its rate (°C, °C/h), by these names; the same over sigma; and
    the seconds since a corner, NaN before the first."""

    error: dict[str, FloatArray]
    ratio: dict[str, FloatArray]
    since: FloatArray

    def after_s(self, what: str, ratio: float) -> FloatArray:
        """Return how long after a corner the samples were of which an error is beyond so many sigmas."""
        beyond = np.abs(self.ratio[what].reshape(len(self.since), -1)).max(axis=1) > ratio
        return np.asarray(self.since[beyond & np.isfinite(self.since)])


def met(make: Callable[[np.random.Generator], Truth], seed: int) -> Outcome:
    """Run the stages over a scene."""
    rng = np.random.default_rng(seed)
    scene = make(rng)
    samples, bias = samples_of(scene, rng)
    pipeline = Pipeline(None, [TemperatureRate(), RestAndBias(mode="learned")])
    pipeline.push(samples)
    samples = pipeline.take()
    # Since the sample before: what comes is of the next corner.
    slope = np.diff(scene.degc) / np.diff(scene.t)
    slope = np.concatenate([slope[:1], slope])[scene.kept]
    off, sd = matrix(samples, "gyro_bias") - bias, matrix(samples, "gyro_bias_sd")
    degc = samples["temperature_estimate"] - scene.degc[scene.kept]
    rate = samples["temperature_rate"] - slope
    corners = np.array([-math.inf, *scene.corners_s])
    passed = scene.t[scene.kept] - corners[np.searchsorted(corners, scene.t[scene.kept], "right") - 1]
    return Outcome(
        {"bias": off / DEG_PER_H, "temperature": degc, "rate": rate * 3600.0},
        {
            "bias": off / sd,
            "temperature": degc / samples["temperature_estimate_sd"],
            "rate": rate / samples["temperature_rate_sd"],
        },
        np.where(np.isfinite(passed), passed, np.nan),
    )
