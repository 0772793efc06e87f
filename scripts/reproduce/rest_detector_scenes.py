"""Scenes for the rest detector: what a unit does, seen through sensors of different grades."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfilt
from scipy.spatial.transform import Rotation

from imumon.blocks import ColumnArray, FloatArray, SampleBlock

GRAVITY = 9.80665
DEG = np.pi / 180.0
DEG_PER_H = DEG / 3600.0


@dataclass(frozen=True, slots=True)
class Grade:
    """White noise of a sample at 100 Hz, rad/s and m/s² (going with the root of the rate), and its steps."""

    name: str
    gyro_sd: float
    accel_sd: float
    gyro_step: float = 0.0
    accel_step: float = 0.0


GRADES = (
    Grade("consumer", 0.3 * DEG, 0.05),
    Grade("consumer, coarse steps", 0.02 * DEG, 0.004, 0.0625 * DEG, 0.0383),
    Grade("industrial", 0.05 * DEG, 0.01),
    Grade("tactical", 3e-5, 2e-3),
    Grade("navigation", 1e-6, 2e-4),
)
BIAS = np.array([2.0, -0.3, 0.4]) * DEG


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Angles (roll, pitch, yaw; rad), acceleration of the unit and extra bias of the sensors, and the truth.

    Arrays (n, 3), and rest (n,) bool: rest is called for there.
    """

    t: FloatArray
    angles: FloatArray
    acceleration: FloatArray
    gyro_extra: FloatArray
    rest: npt.NDArray[np.bool_]


def still(rate_hz: float, seconds: float) -> Scene:
    """Return a scene in which nothing happens."""
    n = int(seconds * rate_hz)
    zero = np.zeros((n, 3))
    return Scene(
        np.arange(n) / rate_hz,
        zero + np.array([0.03, -0.02, 0.7]),
        zero.copy(),
        zero.copy(),
        np.ones(n, bool),
    )


def smooth(t: FloatArray, start: float, duration: float) -> FloatArray:
    """Return a minimum-jerk step from 0 to 1."""
    s = np.clip((t - start) / duration, 0.0, 1.0)
    step: FloatArray = s**3 * (10 - 15 * s + 6 * s**2)
    return step


def ramp(rate_hz: float, seconds: float) -> Scene:
    """Bias drifts: 70 deg/h/degC and 0.5 mg/degC at 2 degC/min."""
    scene = still(rate_hz, seconds)
    scene.gyro_extra[:] = np.outer(scene.t, np.array([70.0, -70.0, 40.0]) * DEG_PER_H * 2 / 60)
    scene.acceleration[:] = np.outer(scene.t, np.array([1.0, -1.0, 1.0]) * 0.5e-3 * GRAVITY * 2 / 60)
    return scene


def tilt(rate_hz: float, seconds: float, rate_dps: float = 0.1) -> Scene:
    """Rest, then a slow roll until half of the time is over, then rest."""
    scene = still(rate_hz, seconds)
    begin, end = 0.25 * seconds, 0.5 * seconds
    scene.angles[:, 0] += rate_dps * DEG * (np.clip(scene.t, begin, end) - begin)
    scene.rest[(scene.t > begin) & (scene.t <= end)] = False
    return scene


def tilt_from_start(rate_hz: float, seconds: float) -> Scene:
    """Roll slowly all the time."""
    scene = still(rate_hz, seconds)
    scene.angles[:, 0] += 0.1 * DEG * scene.t
    scene.rest[:] = False
    return scene


def yaw(rate_hz: float, seconds: float, rate_dps: float = 1.0) -> Scene:
    """Rest, then a level yaw at a constant rate for 30 s."""
    scene = still(rate_hz, seconds)
    scene.angles[:, :2] = 0.0
    begin = 0.25 * seconds
    scene.angles[:, 2] += rate_dps * DEG * (np.clip(scene.t, begin, begin + 30.0) - begin)
    scene.rest[(scene.t > begin) & (scene.t <= begin + 30.0)] = False
    return scene


def turns(rate_hz: float, seconds: float) -> Scene:
    """Guided turns of 90 deg in 3 s, about the vertical and in roll; rests of 12 s after one of 30 s."""
    scene = still(rate_hz, seconds)
    for number, start in enumerate(np.arange(30.0, seconds - 3.0, 15.0)):
        scene.angles[:, 2 if number % 2 == 0 else 0] += (
            (-1) ** (number // 2) * 90 * DEG * smooth(scene.t, start, 3.0)
        )
        scene.rest[(scene.t > start) & (scene.t <= start + 3.0)] = False
    return scene


def fan(rate_hz: float, seconds: float) -> Scene:
    """Steady vibration of 23 Hz and 0.5 m/s² from a third of the time on: still rest."""
    scene = still(rate_hz, seconds)
    on = scene.t > seconds / 3
    scene.acceleration[on, 2] += 0.5 * np.sin(2 * np.pi * 23.17 * scene.t[on])
    scene.acceleration[on, 0] += 0.2 * np.sin(2 * np.pi * 23.17 * scene.t[on] + 1)
    scene.gyro_extra[on, 0] += 0.3 * DEG * np.sin(2 * np.pi * 23.17 * scene.t[on])
    return scene


def bump(rate_hz: float, seconds: float) -> Scene:
    """A knock on the table every 20 s that rings at 17 Hz for a second."""
    scene = still(rate_hz, seconds)
    for start in np.arange(15.0, seconds - 5.0, 20.0):
        t = np.maximum(scene.t - start, 0.0)
        ring = np.exp(-t / 0.2) * np.sin(2 * np.pi * 17.0 * t)
        scene.acceleration[:, 2] += 3.0 * ring
        scene.acceleration[:, 0] += 1.0 * ring
        scene.gyro_extra[:, 1] += 2.0 * DEG * ring
        scene.rest[(scene.t > start) & (t < 0.6)] = False
    return scene


def _wander(rng: np.random.Generator, n: int, rate_hz: float, corner_hz: float) -> FloatArray:
    """Return noise of unit variance below a corner, (n, 3)."""
    sos = butter(2, min(corner_hz, 0.4 * rate_hz), fs=rate_hz, output="sos")
    lead = int(4 * rate_hz / corner_hz)
    noise: FloatArray = sosfilt(sos, rng.standard_normal((n + lead, 3)), axis=0)[lead:]
    result: FloatArray = noise / noise.std(axis=0)
    return result


def hand(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """Held in a hand as still as can be from the start: angles wander by 0.4 deg, tremor of 0.05 m/s²."""
    scene = still(rate_hz, seconds)
    rng = np.random.default_rng([seed, 1])
    n = len(scene.t)
    scene.angles[:] += 0.4 * DEG * _wander(rng, n, rate_hz, 0.5)
    scene.acceleration[:] += 0.05 * _wander(rng, n, rate_hz, 9.0)
    scene.rest[:] = False
    return scene


def walk_then_rest(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """Walked about with for half of the time, then put down."""
    scene = still(rate_hz, seconds)
    rng = np.random.default_rng([seed, 2])
    n = len(scene.t)
    share = (1 - smooth(scene.t, seconds / 2, 1.0))[:, np.newaxis]
    scene.angles[:] += 10 * DEG * share * _wander(rng, n, rate_hz, 0.8)
    scene.acceleration[:] += 1.5 * share * _wander(rng, n, rate_hz, 3.0)
    scene.rest[scene.t < seconds / 2 + 1.0] = False
    return scene


def _fixed(make: Callable[[float, float], Scene]) -> Callable[[float, float, int], Scene]:
    return lambda rate_hz, seconds, _: make(rate_hz, seconds)


SCENES: dict[str, Callable[[float, float, int], Scene]] = {
    "still": _fixed(still),
    "temperature ramp": _fixed(ramp),
    "tilt of 0.1 deg/s": _fixed(tilt),
    "tilt from the start": _fixed(tilt_from_start),
    "yaw of 1 deg/s": _fixed(yaw),
    "guided turns": _fixed(turns),
    "fan": _fixed(fan),
    "bumps": _fixed(bump),
    "held in a hand": hand,
    "walk, then rest": walk_then_rest,
}
"""From rate, seconds and seed."""


def measure(scene: Scene, grade: Grade, seed: int) -> SampleBlock:
    """Return what sensors of a grade read of a scene, at the rate of the scene."""
    rng = np.random.default_rng(seed)
    n, rate_hz = len(scene.t), 1.0 / (scene.t[1] - scene.t[0])
    scale = np.sqrt(rate_hz / 100.0)
    body_to_ned = Rotation.from_euler("ZYX", scene.angles[:, ::-1])
    turn = (body_to_ned[:-1].inv() * body_to_ned[1:]).as_rotvec() * rate_hz
    # The turn that leads to a sample is read with it, not before.
    gyro = np.vstack([turn[:1], turn]) + BIAS + scene.gyro_extra
    gyro += grade.gyro_sd * scale * rng.standard_normal((n, 3))
    accel = body_to_ned.inv().apply([0.0, 0.0, -GRAVITY]) + scene.acceleration + np.array([0.1, -0.2, 0.05])
    accel += grade.accel_sd * scale * rng.standard_normal((n, 3))
    if grade.gyro_step:
        gyro = np.round(gyro / grade.gyro_step) * grade.gyro_step
        accel = np.round(accel / grade.accel_step) * grade.accel_step
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.rint(scene.t * 1e9).astype(np.int64),
        "segment": np.zeros(n, np.int64),
    }
    for i, name in enumerate("xyz"):
        columns |= {f"gyro_{name}": gyro[:, i].copy(), f"accel_{name}": accel[:, i].copy()}
    return SampleBlock(columns)


def averaged(samples: SampleBlock, count: int) -> SampleBlock:
    """Return means of count samples each, dated by the last: how a device lowers its rate."""
    n = len(samples) // count * count
    return SampleBlock(
        {
            name: values[count - 1 : n : count]
            if values.dtype == np.int64
            else values[:n].reshape(-1, count).mean(1)
            for name, values in samples.columns.items()
        }
    )
