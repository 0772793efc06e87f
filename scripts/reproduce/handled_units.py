"""Units that are carried, handled and driven: what they send, the truth, and the bias that is estimated."""

import math
from dataclasses import dataclass

import numpy as np
from samples import Record, gauss_markov, sent
from scipy.spatial.transform import Rotation
from study import matrix

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H, EARTH_RATE, STANDARD_GRAVITY

RATE_HZ = 50.0
TAUS_S = (1.0, 10.0, 100.0, 1000.0)
SLOPES_DPH = np.array([45.0, -100.0, 0.3])
"""Slopes of the axes over temperature, deg/h per °C, where `Sensor.thermal` is one."""
SENSOR_STEP_DEGC = 0.0625
FIRST_REST_S = 60.0


@dataclass(frozen=True)
class Sensor:
    """Noise of a sensor: angle and velocity random walk, deg/√h and m/s/√s, flicker of a decade each, deg/h,
    sensitivity to temperature over that of an industrial one, and turn-on bias, deg/s."""

    angle_walk: float
    velocity_walk: float
    flicker_dph: float
    thermal: float
    turn_on: float


SENSORS = {
    "tactical": Sensor(0.02, 2e-4, 0.1, 0.03, 0.01),
    "industrial": Sensor(0.28, 1e-3, 2.0, 1.0, 0.5),
    "consumer": Sensor(0.6, 3e-3, 20.0, 3.0, 3.0),
    "flickering": Sensor(0.3, 1e-3, 27.0, 1.0, 0.5),
    "all flicker": Sensor(0.03, 1e-3, 27.0, 1.0, 0.5),
}


@dataclass(frozen=True)
class Case:
    """How a unit is handled."""

    sensor: str = "industrial"
    per_g: float = 0.02
    """Largest entry of the matrix of sensitivity to the specific force, deg/s/g."""
    rest_s: float = 12.0
    motion_s: float = 20.0
    """Length of rests (the first lasts a minute) and of what lies between; no rests where rest_s is 0."""
    rests: int = 10
    temperature: str = "constant"
    """Or "ramp" (2 °C/min), or "warm-up" (20 °C, time constant 400 s)."""
    place: bool = False
    """Whether the estimator knows latitude and heading."""
    motion: str = "hand"
    """Turned to any pose and shaken; else one of `DRIVES`."""
    scale_sd: float = 0.0
    accel_sd: float = 0.0
    """Scale and misalignment of the gyros, and turn-on error of the accelerometers, m/s²."""


@dataclass(frozen=True)
class Drive:
    """How something is driven about on the level."""

    speed: float
    """Mean, m/s; half of that are its changes."""
    yaw_rate: float
    """rms, rad/s."""
    slowest_hz: float
    """Of the changes of both; the fastest is 0.1 Hz."""
    sway: tuple[float, float, float] = (0.03, 0.05, 1.0)
    shake: tuple[float, float, float] = (1.0, 2.0, 15.0)
    """rms of what tilts it, rad, and shakes it, m/s², and the lowest and highest frequency, Hz."""


DRIVES = {
    "rover": Drive(1.0, 0.3, 0.02),
    "car": Drive(12.0, 0.1, 0.005),
    "boat": Drive(3.0, 0.05, 0.002, (0.09, 0.08, 0.25), (0.5, 0.08, 24.0)),
    "walking": Drive(1.4, 0.3, 0.01, (0.08, 0.5, 4.0), (1.5, 1.0, 20.0)),
    "drone": Drive(2.0, 0.3, 0.01, (0.12, 0.05, 0.6), (6.0, 10.0, 24.0)),
}
LATITUDE_DEG = 40.93


def waves(rng: np.random.Generator, t: FloatArray, low_hz: float, high_hz: float, size: float) -> FloatArray:
    """Return smooth motion of three axes with frequencies between these, rms `size`, (n, 3)."""
    parts = 6
    f = np.exp(rng.uniform(math.log(low_hz), math.log(high_hz), (parts, 3)))
    phase, weight = rng.uniform(0.0, 2.0 * np.pi, (parts, 3)), rng.uniform(0.5, 1.5, (parts, 3))
    total = (weight * np.sin(2.0 * np.pi * f * t[:, None, None] + phase)).sum(1)
    return np.asarray(size * math.sqrt(2.0 / parts) * total)


def _moved(case: Case, rng: np.random.Generator, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return rates, rad/s, and accelerations in the axes of the ground, m/s², from rest to rest, (n, 3)."""
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    ramp = np.clip(np.minimum(t, t[-1] - t) / min(1.0, 0.25 * seconds), 0.0, 1.0)[:, np.newaxis]
    ramp = np.asarray(ramp * ramp * (3.0 - 2.0 * ramp))
    if case.motion == "hand":
        return ramp * waves(rng, t, 0.05, 1.0, 1.0), ramp * waves(rng, t, 0.3, 3.0, 1.0)
    # It speeds up, brakes and turns; the road is rough; what tilts it comes back.
    drive = DRIVES[case.motion]
    yaw = ramp[:, 0] * waves(rng, t, drive.slowest_hz, 0.1, drive.yaw_rate)[:, 2]
    along = ramp[:, 0] * drive.speed * (1.0 + 0.5 * waves(rng, t, drive.slowest_hz, 0.1, 1.0)[:, 0])
    heading = np.cumsum(yaw) / RATE_HZ
    velocity = along[:, np.newaxis] * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(t))])
    (tilt, low, high), (shake, lowest, highest) = drive.sway, drive.shake
    rate = np.gradient(ramp * waves(rng, t, low, high, tilt), 1.0 / RATE_HZ, axis=0)
    rate[:, 2] = yaw
    return rate, np.gradient(velocity, 1.0 / RATE_HZ, axis=0) + ramp * waves(rng, t, lowest, highest, shake)


def simulate(case: Case, seed: int) -> Record:
    """Return a record."""
    rng = np.random.default_rng(seed)
    rates, accelerations, still = [], [], []
    for k in range(max(case.rests, 1)):
        seconds = case.rest_s and (FIRST_REST_S if k == 0 else case.rest_s)
        moved, shaken = _moved(case, rng, case.motion_s)
        n = round(seconds * RATE_HZ)
        rates += [np.zeros((n, 3)), moved]
        accelerations += [np.zeros((n, 3)), shaken]
        still += [np.ones(n, np.bool_), np.zeros(len(moved), np.bool_)]
    rate, acceleration, rest = (np.concatenate(parts) for parts in (rates, accelerations, still))
    n = len(rate)
    steps = Rotation.from_rotvec(rate / RATE_HZ).as_matrix()
    body_to_ground, poses = np.eye(3), np.empty((n, 3, 3))
    for k in range(n):
        body_to_ground = body_to_ground @ steps[k]
        poses[k] = body_to_ground
    latitude = math.radians(LATITUDE_DEG)
    earth = EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)]) @ poses
    gravity = np.array([0.0, 0.0, -STANDARD_GRAVITY])
    force = np.einsum("ni,nij->nj", acceleration + gravity, poses)
    return Record(*_sensed(case, rng, rate + earth, force), earth, rest)


def _sensed(
    case: Case, rng: np.random.Generator, rate: FloatArray, force: FloatArray
) -> tuple[SampleBlock, FloatArray]:
    """Return what the sensors make of it, and the bias."""
    n, sensor = len(rate), SENSORS[case.sensor]
    t = np.arange(n) / RATE_HZ
    courses = {"ramp": 25.0 + t / 30.0, "warm-up": 45.0 - 20.0 * np.exp(-t / 400.0)}
    degc = courses.get(case.temperature, np.full(n, 25.0))
    bias = np.radians(sensor.turn_on) * rng.normal(size=3)
    bias = bias + sum(gauss_markov(rng, n, RATE_HZ, tau, sensor.flicker_dph * DEG_PER_H) for tau in TAUS_S)
    bias = bias + sensor.thermal * SLOPES_DPH * DEG_PER_H * (degc - 25.0)[:, np.newaxis]
    matrix = rng.uniform(-1.0, 1.0, (3, 3))
    matrix *= math.radians(case.per_g) / STANDARD_GRAVITY / np.abs(matrix).max()
    bias = bias + force @ matrix.T
    white, shaking = rng.normal(size=(2, n, 3)) * math.sqrt(RATE_HZ)
    gyro = rate + bias + math.radians(sensor.angle_walk) / 60.0 * white
    accel = force + sensor.velocity_walk * shaking
    read = np.round((degc + 0.02 * rng.normal(size=n)) / SENSOR_STEP_DEGC) * SENSOR_STEP_DEGC
    if case.scale_sd or case.accel_sd:
        gyro += rate @ rng.normal(0.0, case.scale_sd, (3, 3))
        accel += rng.normal(0.0, case.accel_sd, 3)
    return sent(t, temperature=read, gyro=gyro, accel=accel), bias


CASES = {
    "the default scene": Case(),
    "no sensitivity to g": Case(per_g=0.0),
    "sensitivity 0.1 °/s/g": Case(per_g=0.1),
    "rests of 3 s": Case(rest_s=3.0, rests=20),
    "rests of 60 s": Case(rest_s=60.0, rests=6),
    "motion of 5 s": Case(motion_s=5.0, rests=20),
    "motion of 600 s": Case(motion_s=600.0, rests=3),
    "ramp of 2 °C/min": Case(temperature="ramp"),
    "warm-up": Case(temperature="warm-up"),
    "tactical": Case(sensor="tactical"),
    "consumer": Case(sensor="consumer"),
    "flicker of 27 °/h beside 0.3 °/√h": Case(sensor="flickering"),
    "flicker of 27 °/h beside 0.03 °/√h": Case(sensor="all flicker"),
    "flicker of 27 °/h beside 0.3 °/√h, ramp": Case(sensor="flickering", temperature="ramp"),
    "place known": Case(place=True),
    "place known, 0.1 °/s/g": Case(place=True, per_g=0.1),
    "tactical, place known": Case(sensor="tactical", place=True),
    "tactical, place known, motion of 600 s": Case(sensor="tactical", place=True, motion_s=600.0, rests=3),
    "consumer, warm-up, 0.1 °/s/g, rests of 3 s": Case(
        sensor="consumer", temperature="warm-up", per_g=0.1, rest_s=3.0, rests=20
    ),
    "rover": Case(motion="rover", motion_s=60.0),
    "car": Case(motion="car", motion_s=60.0),
}
MOVING = {
    name: Case(rest_s=0.0, rests=1, motion_s=300.0, motion=name, scale_sd=0.01, accel_sd=0.05)
    for name in DRIVES
}
"""Units that never rest."""


def places(rest: BoolArray) -> tuple[IntArray, IntArray]:
    """Return the rows that are scored (ends of rests, before the next, once a second in motion), and those
    in motion; from the end of the first rest on."""
    moving = np.flatnonzero(~rest)
    motion = moving[moving > FIRST_REST_S * RATE_HZ]
    leaves = np.flatnonzero(rest[:-1] & ~rest[1:])
    comes = np.flatnonzero(~rest[:-1] & rest[1:])
    return np.concatenate([leaves[1:], comes, motion[:: round(RATE_HZ)]]), motion


def estimated(case: Case, record: Record) -> tuple[FloatArray, FloatArray, Record]:
    """Return error and sigma of the pipeline, rad/s, (n, 3) each, and the record with its columns."""
    samples = record.samples
    known = (LATITUDE_DEG, 0.0) if case.place else (None, None)
    for stage in (TemperatureRate(), RestAndBias(None, None, "learned", *known)):
        samples = samples.with_columns(stage.process(samples))
    observable = record.bias if case.place else record.bias + record.earth
    error, sd = matrix(samples, "gyro_bias") - observable, matrix(samples, "gyro_bias_sd")
    return error, sd, Record(samples, record.bias, record.earth, record.rest)
