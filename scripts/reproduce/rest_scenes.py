"""Scenes for the rest detector: what a unit does, what sensors of grades read, and what is taken for rest."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from samples import sent
from scipy.signal import butter, lfilter, sosfilt
from scipy.spatial.transform import Rotation
from study import matrix
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, SampleBlock

GRAVITY = 9.80665
FULL_RATE_HZ, TURN_RATE_HZ = 100.0, 25.0
SECONDS = 200.0
TURNS = (
    (0.02, 10.0, 0.5, 0.0), (0.05, 10.0, 0.5, 0.0), (0.1, 10.0, 10.0, 0.0), (0.5, 10.0, 0.5, 0.0),
    (0.5, 10.0, 120.0, 0.0), (0.5, 60.0, 120.0, 0.0), (0.5, 60.0, 1200.0, 0.0),
    (0.5, 10.0, 120.0, 45.0), (0.5, 10.0, 120.0, 90.0), (5.0, 12.0, 5.0, 0.0),
    (30.0, 30.0, 120.0, 0.0), (300.0, 10.0, 20.0, 0.0),
)  # fmt: skip
"""deg/s, minutes, seconds in which it begins and ends, and degrees from the vertical to the axis."""
DEG = np.pi / 180.0
DEG_PER_H = DEG / 3600.0


@dataclass(frozen=True, slots=True)
class Grade:
    """White noise of a sample at 100 Hz, rad/s and m/s² (going with the root of the rate), and its steps.

    gyro_walk is the rate random walk, rad/s/√s, and gyro_flicker the floor of the Allan deviation, rad/s.
    """

    name: str
    gyro_sd: float
    accel_sd: float
    gyro_walk: float = 0.0
    gyro_step: float = 0.0
    accel_step: float = 0.0
    gyro_flicker: float = 0.0


def _sensor(name: str, arw: float, flicker: float, micro_g: float, steps: tuple[float, float]) -> Grade:
    """Return a sensor by its data sheet: °/√h, °/h, µg/√Hz, and steps in °/s and m/s²."""
    white, force = arw / 60.0 * DEG * 10.0, micro_g * 1e-6 * GRAVITY * 10.0
    return Grade(name, white, force, 0.0, steps[0] * DEG, steps[1], flicker * DEG_PER_H)


SENSORS = (
    _sensor("tactical: 0.1 °/h, 0.003 °/√h", 0.003, 0.1, 50.0, (0.0, 0.0)),
    _sensor("industrial: 5 °/h, 0.15 °/√h", 0.15, 5.0, 60.0, (0.0, 0.0)),
    _sensor("as BMI160: 15 °/h, 0.42 °/√h", 0.42, 15.0, 180.0, (0.0038, 6e-4)),
    _sensor("as MPU-6050: 40 °/h, 0.3 °/√h", 0.3, 40.0, 400.0, (0.0076, 6e-4)),
    _sensor("coarse: 20 °/h, steps of 0.06 °/s", 0.3, 20.0, 200.0, (0.06, 0.038)),
    _sensor("noisy: 30 °/h, 1.8 °/√h", 1.8, 30.0, 500.0, (0.0, 0.0)),
)
"""Gyros with flicker noise, from tactical to worse than what consumers buy."""
FLICKER_TAUS_S = (10.0, 100.0, 1000.0)
FLOOR_PER_MARKOV = 0.776
"""Floor of the Allan deviation of Markov processes with these time constants, over the sd of one."""
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
    rest: BoolArray


def still(rate_hz: float, seconds: float, _: int = 0) -> Scene:
    """Return a scene in which nothing happens."""
    n = int(seconds * rate_hz)
    zero = np.zeros((n, 3))
    angles = zero + np.array([0.03, -0.02, 0.7])
    return Scene(np.arange(n) / rate_hz, angles, zero.copy(), zero.copy(), np.ones(n, bool))


def fan(rate_hz: float, seconds: float, _: int = 0) -> Scene:
    """Steady vibration of 23 Hz and 0.5 m/s² from a third of the time on: still rest."""
    scene = still(rate_hz, seconds)
    on = scene.t > seconds / 3
    scene.acceleration[on, 2] += 0.5 * np.sin(2 * np.pi * 23.17 * scene.t[on])
    scene.acceleration[on, 0] += 0.2 * np.sin(2 * np.pi * 23.17 * scene.t[on] + 1)
    scene.gyro_extra[on, 0] += 0.3 * DEG * np.sin(2 * np.pi * 23.17 * scene.t[on])
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


def steady_turn(
    rate_hz: float, turn_dps: float, minutes: float, ramp_s: float, tilt_deg: float = 0.0, _: int = 0
) -> Scene:
    """Rest of 150 s, a turn, begun and ended evenly in ramp_s, and 90 s of rest; its axis is tilted."""
    seconds = 60.0 * minutes + ramp_s
    scene = still(rate_hz, 150.0 + seconds + 90.0)
    since = scene.t - 150.0
    rate = turn_dps * DEG * np.clip(np.minimum(since, seconds - since) / ramp_s, 0.0, 1.0)
    _turn(scene, rate, tilt_deg)
    scene.rest[(since > 0.0) & (since <= seconds)] = False
    return scene


def _turn(scene: Scene, rate: FloatArray, tilt_deg: float = 0.0) -> None:
    """Turn the unit at a rate, (n,) in rad/s, about an axis that is tilted."""
    axis = np.array([np.sin(tilt_deg * DEG), 0.0, np.cos(tilt_deg * DEG)])
    turn = Rotation.from_rotvec(np.outer(np.cumsum(rate) * (scene.t[1] - scene.t[0]), axis))
    placed = turn * Rotation.from_euler("ZYX", scene.angles[0, ::-1])
    scene.angles[:] = placed.as_euler("ZYX")[:, ::-1]


def slow_tilt(rate_hz: float, seconds: float, _: int = 0) -> Scene:
    """Rest, then tilted slowly by a hand from half of the time on: ±1° in 60 s."""
    scene = still(rate_hz, seconds)
    since = np.maximum(scene.t - seconds / 2, 0.0)
    scene.angles[:, 0] += DEG * np.sin(2 * np.pi * since / 60.0)
    scene.angles[:, 1] += 0.5 * DEG * np.sin(2 * np.pi * since / 60.0)
    scene.rest[since > 0.0] = False
    return scene


def breathing(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """Rest, then worn by a person who sits and breathes: 0.1 °/s about a horizontal axis, every 4 s or so."""
    scene = still(rate_hz, seconds)
    rng = np.random.default_rng([seed, 3])
    moving = scene.t > seconds / 2
    period_s = 4.0 + 0.4 * _wander(rng, len(scene.t), rate_hz, 0.1)[:, 0]
    rate = 0.1 * DEG * np.sin(2 * np.pi * np.cumsum(1.0 / np.maximum(period_s, 2.0)) / rate_hz) * moving
    scene.angles[:, 1] += np.cumsum(rate) / rate_hz
    scene.rest[moving] = False
    return scene


def idling(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """A car that stands with its engine running: 25 Hz and its harmonics, 0.2 m/s² and 0.2 °/s."""
    scene = still(rate_hz, seconds)
    _idle(scene, np.random.default_rng([seed, 4]), rate_hz)
    return scene


def _idle(scene: Scene, rng: np.random.Generator, rate_hz: float) -> None:
    """Add the vibration of an engine at 750 revolutions a minute: second order and twice that."""
    for order, size in ((25.3, 1.0), (50.6, 0.4)):
        if order < 0.45 * rate_hz:
            angle = 2 * np.pi * order * scene.t[:, np.newaxis] + rng.uniform(0, 2 * np.pi, 6)
            scene.acceleration[:] += 0.2 * size * np.array([0.4, 0.6, 1.0]) * np.sin(angle[:, :3])
            scene.gyro_extra[:] += 0.2 * DEG * size * np.array([1.0, 0.6, 0.3]) * np.sin(angle[:, 3:])
    scene.acceleration[:] += 0.01 * rng.standard_normal((len(scene.t), 3))


def _road(
    scene: Scene,
    rng: np.random.Generator,
    share: FloatArray,
    force: tuple[float, float],
    rate: tuple[float, float],
) -> None:
    """Shake a car: the body bounces and pitches at 1.5 Hz, the wheels up to 30 Hz; m/s² and °/s of each."""
    n, rate_hz = len(scene.t), 1.0 / (scene.t[1] - scene.t[0])
    shake = share[:, np.newaxis]
    for values, axes, (body, wheels) in (
        (scene.acceleration, np.array([0.2, 0.5, 1.0]), force),
        (scene.gyro_extra, DEG * np.array([1.0, 1.0, 0.3]), rate),
    ):
        values += (
            shake * axes * (body * _wander(rng, n, rate_hz, 1.5) + wheels * _wander(rng, n, rate_hz, 30.0))
        )


def driving(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """A car in town: it stands for a third of every 90 s, engine idling, and drives between.

    On the road (rms of smooth asphalt) it accelerates and brakes, and turns now and then.
    """
    scene = still(rate_hz, seconds)
    rng = np.random.default_rng([seed, 5])
    t = scene.t
    cycle = t % 90.0
    speed = np.clip((cycle - 30.0) / 10.0, 0.0, 1.0) * np.clip((89.0 - cycle) / 8.0, 0.0, 1.0)
    speed = speed**2 * (3.0 - 2.0 * speed)
    scene.acceleration[:, 0] += 14.0 * np.gradient(speed, t)
    _road(scene, rng, np.sqrt(speed), (0.3, 0.4), (1.0, 0.7))
    bends = np.sin(2 * np.pi * t / 37.0) > 0.7
    yaw_rate = 10.0 * DEG * speed * bends + 0.5 * DEG * speed * np.sin(2 * np.pi * t / 53.0)
    scene.angles[:, 2] += np.cumsum(yaw_rate) / rate_hz
    scene.acceleration[:, 1] += 14.0 * speed * yaw_rate
    _idle(scene, rng, rate_hz)
    scene.rest[speed > 0.0] = False
    return scene


def motorway(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """A car on a smooth road at a constant speed, nearly straight on: a third of the vibration in town."""
    scene = still(rate_hz, seconds)
    _road(scene, np.random.default_rng([seed, 6]), np.ones(len(scene.t)), (0.1, 0.15), (0.3, 0.25))
    scene.angles[:, 2] += 0.3 * DEG * 53.0 / (2 * np.pi) * np.sin(2 * np.pi * scene.t / 53.0)
    scene.rest[:] = False
    return scene


SCENES: dict[str, Callable[[float, float, int], Scene]] = {
    "fan": fan,
    "held in a hand": hand,
    "tilted slowly, 1 deg in 60 s": slow_tilt,
    "breathing, 0.1 deg/s": breathing,
    "idling engine": idling,
    "driving in town": driving,
    "driving on a smooth road": motorway,
}
"""From rate, seconds and seed."""


def measure_with_bias(scene: Scene, grade: Grade, seed: int) -> tuple[SampleBlock, FloatArray]:
    """Return what sensors of a grade read of a scene, and the bias of the gyros less the scene's, (n, 3)."""
    rng = np.random.default_rng(seed)
    n, rate_hz = len(scene.t), 1.0 / (scene.t[1] - scene.t[0])
    scale = np.sqrt(rate_hz / 100.0)
    body_to_ned = Rotation.from_euler("ZYX", scene.angles[:, ::-1])
    turn = (body_to_ned[:-1].inv() * body_to_ned[1:]).as_rotvec() * rate_hz
    # The turn that leads to a sample is read with it, not before.
    gyro = np.vstack([turn[:1], turn]) + BIAS + scene.gyro_extra
    gyro += grade.gyro_sd * scale * rng.standard_normal((n, 3))
    walk = grade.gyro_walk / np.sqrt(rate_hz) * np.cumsum(rng.standard_normal((n, 3)), 0)
    for tau_s in FLICKER_TAUS_S if grade.gyro_flicker else ():
        keeps = np.exp(-1.0 / (rate_hz * tau_s))
        steps = np.sqrt(1.0 - keeps**2) * rng.standard_normal((n, 3))
        steps[0] /= np.sqrt(1.0 - keeps**2)
        walk += grade.gyro_flicker / FLOOR_PER_MARKOV * lfilter([1.0], [1.0, -keeps], steps, axis=0)
    gyro += walk
    accel = body_to_ned.inv().apply([0.0, 0.0, -GRAVITY]) + scene.acceleration + np.array([0.1, -0.2, 0.05])
    accel += grade.accel_sd * scale * rng.standard_normal((n, 3))
    if grade.gyro_step:
        gyro = np.round(gyro / grade.gyro_step) * grade.gyro_step
        accel = np.round(accel / grade.accel_step) * grade.accel_step
    return sent(scene.t, gyro=gyro, accel=accel), BIAS + walk


def percent(found: BoolArray, where: BoolArray) -> float:
    """Return the share of samples somewhere that are taken for rest, NaN where there are none."""
    return 100.0 * float(found[where].mean()) if where.any() else np.nan


def vqf_rest(samples: SampleBlock) -> BoolArray:
    """Return what the rest detection of the PyPI package vqf finds, with its default settings.

    It is given gyros without their bias at the start, for it takes more than 2 deg/s for motion.
    """
    t = samples["device_time_ns"] * 1e-9
    gyro, accel = matrix(samples, "gyro"), matrix(samples, "accel")
    found = VQF(float(t[1] - t[0])).updateBatch(
        np.ascontiguousarray(gyro - BIAS), np.ascontiguousarray(accel)
    )
    return np.asarray(found["restDetected"], np.bool_)
