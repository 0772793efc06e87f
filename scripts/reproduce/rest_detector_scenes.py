"""Scenes for the rest detector: what a unit does, seen through sensors of different grades."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from samples import sent
from scipy.signal import butter, lfilter, sosfilt
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock

GRAVITY = 9.80665
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


def steady_turn(
    rate_hz: float, turn_dps: float, minutes: float, ramp_s: float, tilt_deg: float = 0.0
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


def turn_from_start(rate_hz: float, turn_dps: float) -> Scene:
    """A turn from the start that stops after 200 s, rest of 100 s, and both again for 100 s each."""
    scene = still(rate_hz, 500.0)
    turns = (scene.t < 200.0) | ((scene.t >= 300.0) & (scene.t < 400.0))
    width = round(rate_hz)  # it takes a second to stop, and to begin
    eased = np.convolve(np.concatenate([np.ones(width), turns]), np.ones(width) / width)[width:]
    rate = turn_dps * DEG * eased[: len(scene.t)]
    _turn(scene, rate)
    scene.rest[rate > 1e-9] = False
    return scene


def rest_after_turn(rate_hz: float, turn_dps: float, ramp_s: float) -> Scene:
    """Rest of 150 s, a turn of 5 min that may be wander of the bias, and an hour of rest."""
    scene = still(rate_hz, 150.0 + 300.0 + 3600.0)
    since = scene.t - 150.0
    rate = turn_dps * DEG * np.clip(np.minimum(since, 300.0 - since) / ramp_s, 0.0, 1.0)
    _turn(scene, rate)
    scene.rest[(since > 0.0) & (since <= 300.0)] = False
    return scene


def swing(rate_hz: float, axis: int, degrees: float, period_s: float, arm_m: float = 0.0) -> Scene:
    """Rest of 150 s, then a swing of 150 s, or of three periods, about an axis of the unit (0 to 2).

    It hangs on an arm, so that the specific force turns less than the unit; 0 is rocking about the unit.
    """
    scene = still(rate_hz, 150.0 + max(150.0, 3.0 * period_s))
    since = np.maximum(scene.t - 150.0, 0.0)
    angle = degrees * DEG * np.sin(2 * np.pi * since / period_s)
    scene.angles[:, axis] += angle
    scene.acceleration[:, 1] -= arm_m * np.gradient(np.gradient(angle, scene.t), scene.t)
    scene.rest[since > 0.0] = False
    return scene


def slow_tilt(rate_hz: float, seconds: float) -> Scene:
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
    rng = np.random.default_rng([seed, 4])
    _idle(scene, np.ones(len(scene.t)), rng, rate_hz)
    return scene


def _idle(scene: Scene, share: FloatArray, rng: np.random.Generator, rate_hz: float) -> None:
    """Add the vibration of an engine at 750 revolutions a minute: second order and twice that."""
    for order, size in ((25.3, 1.0), (50.6, 0.4)):
        if order < 0.45 * rate_hz:
            phase = rng.uniform(0, 2 * np.pi, 6)
            angle = 2 * np.pi * order * scene.t[:, np.newaxis] + phase
            scene.acceleration[:] += (
                0.2 * size * share[:, np.newaxis] * np.array([0.4, 0.6, 1.0]) * np.sin(angle[:, :3])
            )
            scene.gyro_extra[:] += (
                0.2 * DEG * size * share[:, np.newaxis] * np.array([1.0, 0.6, 0.3]) * np.sin(angle[:, 3:])
            )
    scene.acceleration[:] += 0.01 * share[:, np.newaxis] * rng.standard_normal((len(scene.t), 3))


def driving(rate_hz: float, seconds: float, seed: int = 0, roughness: float = 1.0) -> Scene:
    """A car in town: it stands for a third of every 90 s, engine idling, and drives between.

    On the road the body bounces and pitches at 1.5 Hz (0.3 m/s², 1 °/s), the wheels shake it up to 30 Hz
    (0.4 m/s², 0.7 °/s; all rms, smooth asphalt), it accelerates and brakes, and turns now and then.
    """
    scene = still(rate_hz, seconds)
    rng = np.random.default_rng([seed, 5])
    n, t = len(scene.t), scene.t
    cycle = t % 90.0
    speed = np.clip((cycle - 30.0) / 10.0, 0.0, 1.0) * np.clip((89.0 - cycle) / 8.0, 0.0, 1.0)
    speed = speed**2 * (3.0 - 2.0 * speed)
    scene.acceleration[:, 0] += 14.0 * np.gradient(speed, t)
    shake = (roughness * np.sqrt(speed))[:, np.newaxis]
    scene.acceleration[:] += (
        shake
        * np.array([0.2, 0.5, 1.0])
        * (0.3 * _wander(rng, n, rate_hz, 1.5) + 0.4 * _wander(rng, n, rate_hz, 30.0))
    )
    scene.gyro_extra[:] += (
        DEG
        * shake
        * np.array([1.0, 1.0, 0.3])
        * (_wander(rng, n, rate_hz, 1.5) + 0.7 * _wander(rng, n, rate_hz, 30.0))
    )
    bends = np.sin(2 * np.pi * t / 37.0) > 0.7
    yaw_rate = 10.0 * DEG * speed * bends + 0.5 * DEG * speed * np.sin(2 * np.pi * t / 53.0)
    scene.angles[:, 2] += np.cumsum(yaw_rate) / rate_hz
    scene.acceleration[:, 1] += 14.0 * speed * yaw_rate
    _idle(scene, np.ones(n), rng, rate_hz)
    scene.rest[speed > 0.0] = False
    return scene


def motorway(rate_hz: float, seconds: float, seed: int = 0) -> Scene:
    """A car on a smooth road at a constant speed, nearly straight on: a third of the vibration in town."""
    scene = still(rate_hz, seconds)
    rng = np.random.default_rng([seed, 6])
    n = len(scene.t)
    scene.acceleration[:] += np.array([0.2, 0.5, 1.0]) * (
        0.1 * _wander(rng, n, rate_hz, 1.5) + 0.15 * _wander(rng, n, rate_hz, 30.0)
    )
    scene.gyro_extra[:] += (
        DEG
        * np.array([1.0, 1.0, 0.3])
        * (0.3 * _wander(rng, n, rate_hz, 1.5) + 0.25 * _wander(rng, n, rate_hz, 30.0))
    )
    scene.angles[:, 2] += 0.3 * DEG * 53.0 / (2 * np.pi) * np.sin(2 * np.pi * scene.t / 53.0)
    scene.rest[:] = False
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
    "tilted slowly, 1 deg in 60 s": _fixed(slow_tilt),
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
