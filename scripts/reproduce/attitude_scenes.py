"""Units that are turned, swung, shaken and carried, with what they send and the true attitude."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from handled_units import SENSORS, waves
from samples import sent
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.models.model import MagnetometerModel

FINE_HZ = 1600.0
"""The truth has so many steps; a sample is the mean of those since the one before."""
SECONDS, REST_S, PERIOD_S = 150.0, 20.0, 40.0
"""It rests for so long, and again at the end of each period."""
LATITUDE_DEG = 45.0
FIELD_UT = np.array([0.0, 20.0, -43.0])
"""East, north, up: the dip is 65°."""
ACCEL_SD, SCALE_SD = 0.05, 0.01
"""Turn-on error of the accelerometers, m/s², scale and misalignment of the gyros: as the stage takes them."""
CONSUMER_SD, CONSUMER_SCALE_SD = 0.4, 0.03
"""The same of the BMI160, 40 mg, and the MPU-6050; the stage does not know."""
Z_REVERSED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0))
HARD_UT, SOFT, MAG_NOISE_UT = 0.3, 3e-3, 0.2
"""What a calibration leaves of hard and soft iron, and noise."""
SLOPES_DPH = np.array([60.0, -45.0, 30.0])
"""deg/h per °C."""
Moves = tuple[FloatArray, FloatArray]
"""Roll, pitch and yaw, rad, and where it is, m, east, north, up; (n, 3) each."""


@dataclass(frozen=True)
class Scene:
    """A unit and how it moves."""

    moves: Callable[[np.random.Generator, FloatArray, FloatArray], Moves]
    """Of a generator, seconds (n,) and how much of the motion there is, 0 to 1, (n,)."""
    magnet: str = ""
    """None; "near": one comes near and goes away; "body": one was fixed to the unit after calibration; "put
    on": one is put on the unit after a minute."""
    swap: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """What the gyros read of the rate: the identity but where axes or signs are mixed up."""
    warms: bool = False
    accel_sd: float = ACCEL_SD
    scale_sd: float = SCALE_SD
    """Turn-on error of its accelerometers, m/s²; scale and misalignment of its gyros."""


@dataclass(frozen=True, eq=False)
class Record:
    """What a unit sent, the truth as matrices from body axes to east-north-up, (n, 3, 3)."""

    samples: SampleBlock
    attitude: FloatArray
    axes: Literal["FRD", "FLU"]


def still(_: np.random.Generator, t: FloatArray, __: FloatArray) -> Moves:
    """Return no motion."""
    return np.zeros((len(t), 3)), np.zeros((len(t), 3))


def hand(rng: np.random.Generator, t: FloatArray, much: FloatArray) -> Moves:
    """Turned to any pose and shaken."""
    angles = waves(rng, t, 0.03, 0.5, 0.6) + waves(rng, t, 0.5, 3.0, 0.05)
    return much[:, np.newaxis] * angles, much[:, np.newaxis] * waves(rng, t, 0.3, 3.0, 0.03)


def arm(rng: np.random.Generator, t: FloatArray, much: FloatArray) -> Moves:
    """A robot arm: every second from one pose to another, the unit half a metre from the joint."""
    poses = rng.uniform(-0.8, 0.8, (math.ceil(t[-1]) + 2, 3))
    whole = t.astype(int)
    part = np.clip(1.5 * (t - whole), 0.0, 1.0)[:, np.newaxis]
    blend = part**3 * (10.0 - 15.0 * part + 6.0 * part * part)
    angles = much[:, np.newaxis] * ((1.0 - blend) * poses[whole] + blend * poses[whole + 1])
    return angles, turned(angles).apply(np.array([0.5, 0.0, 0.0]))


def swing(rng: np.random.Generator, t: FloatArray, much: FloatArray) -> Moves:
    """A swing of 2 m that twists: along it the unit feels no tilt."""
    phase = rng.uniform(0.0, 2.0 * np.pi)
    to_and_fro = 0.6 * np.sin(math.sqrt(STANDARD_GRAVITY / 2.0) * t + phase)
    twist = 0.4 * np.sin(0.5 * t + phase)
    angles = much[:, np.newaxis] * np.column_stack([to_and_fro, np.zeros(len(t)), twist])
    return angles, turned(angles).apply(np.array([0.0, 0.0, -2.0]))


def drone(rng: np.random.Generator, t: FloatArray, much: FloatArray) -> Moves:
    """Tilts and turns, flies as it tilts, and shakes: 10 m/s² and 20 °/s at 60 to 180 Hz."""
    lean = waves(rng, t, 0.1, 0.6, 0.15)
    lean[:, 2] = waves(rng, t, 0.02, 0.1, 1.0)[:, 2]
    # g tan(tilt) is what it speeds up by; at some 0.3 Hz that is so far.
    away = STANDARD_GRAVITY * lean[:, [1, 0, 0]] * np.array([1.0, -1.0, 0.0]) / (2.0 * np.pi * 0.3) ** 2
    angles = lean + waves(rng, t, 60.0, 180.0, 5e-4)
    return much[:, np.newaxis] * angles, much[:, np.newaxis] * (away + waves(rng, t, 60.0, 180.0, 1.8e-5))


def rover(rng: np.random.Generator, t: FloatArray, much: FloatArray) -> Moves:
    """Driven about on the level: it turns about the vertical, and hardly tilts."""
    angles = waves(rng, t, 0.1, 2.0, 0.03)
    angles[:, 2] = waves(rng, t, 0.02, 0.1, 2.0)[:, 2]
    speed = waves(rng, t, 0.02, 0.2, 1.0) * np.array([1.0, 1.0, 0.0])
    way = np.cumsum(much[:, np.newaxis] * speed, axis=0) / FINE_HZ
    return much[:, np.newaxis] * angles, way + much[:, np.newaxis] * waves(rng, t, 2.0, 15.0, 3e-4)


def car(rng: np.random.Generator, t: FloatArray, much: FloatArray) -> Moves:
    """Driven at 10 m/s through bends that last for seconds: accelerations as long as VQF's time constant."""
    angles = waves(rng, t, 0.1, 2.0, 0.02)
    angles[:, 2] = waves(rng, t, 0.01, 0.05, 1.5)[:, 2]
    angles *= much[:, np.newaxis]
    ahead = np.column_stack([np.cos(angles[:, 2]), np.sin(angles[:, 2]), np.zeros(len(t))])
    return angles, np.cumsum(10.0 * much[:, np.newaxis] * ahead, axis=0) / FINE_HZ


SCENES = {
    "at rest": Scene(still),
    "at rest, warming up": Scene(still, warms=True),
    "by hand": Scene(hand),
    "by hand, warming up": Scene(hand, warms=True),
    "robot arm": Scene(arm),
    "swing": Scene(swing),
    "drone": Scene(drone),
    "rover": Scene(rover),
    "car": Scene(car),
    "by hand, magnet comes near": Scene(hand, magnet="near"),
    "at rest, magnet comes near": Scene(still, magnet="near"),
    "by hand, magnet on the body": Scene(hand, magnet="body"),
    "rover, magnet on the body": Scene(rover, magnet="body"),
    "by hand, magnet put on": Scene(hand, magnet="put on"),
    "rover, magnet put on": Scene(rover, magnet="put on"),
    "by hand, consumer accelerometers": Scene(hand, accel_sd=CONSUMER_SD),
    "rover, consumer accelerometers": Scene(rover, accel_sd=CONSUMER_SD),
    "at rest, consumer accelerometers": Scene(still, accel_sd=CONSUMER_SD),
    "by hand, consumer gyros": Scene(hand, scale_sd=CONSUMER_SCALE_SD),
    "by hand, gyro z reversed": Scene(hand, swap=Z_REVERSED),
    "rover, gyro z reversed": Scene(rover, swap=Z_REVERSED),
    "robot arm, gyros x and y changed": Scene(
        arm, swap=((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    ),
}  # fmt: skip


def turned(angles: FloatArray) -> Rotation:
    """Return the rotations by roll, pitch and yaw, rad, (n, 3), from axes that stand upright."""
    return Rotation.from_euler("ZYX", angles[:, ::-1])


def simulate(scene: Scene, rate_hz: float, seed: int, seconds: float = SECONDS) -> Record:
    """Return a record: of body axes forward-left-up by even seeds, forward-right-down by odd ones."""
    rng = np.random.default_rng(seed)
    each = round(FINE_HZ / rate_hz)
    n = round(seconds * rate_hz)
    t = np.arange(n * each + 1) / FINE_HZ
    # Rest at first, and from three quarters of each period on; it goes over in a second.
    since = np.where(t < REST_S, PERIOD_S, (t - REST_S) % PERIOD_S)
    ramp = np.clip(np.minimum(since, 0.75 * PERIOD_S - since), 0.0, 1.0)
    much = ramp**3 * (10.0 - 15.0 * ramp + 6.0 * ramp * ramp)
    angles, position = scene.moves(rng, t, much)
    mount = np.diag([1.0, -1.0, -1.0]) if seed % 2 else np.eye(3)
    lean = np.append(rng.normal(0.0, 0.2, 2), rng.uniform(-np.pi, np.pi))
    pose = turned(lean[np.newaxis])[0] * turned(angles) * Rotation.from_matrix(mount)
    rate = (pose[:-1].inv() * pose[1:]).as_rotvec() * FINE_HZ
    poses = pose.as_matrix()[1:]
    acceleration = np.gradient(np.gradient(position, axis=0), axis=0)[1:] * FINE_HZ**2
    latitude = math.radians(LATITUDE_DEG)
    rate += EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)]) @ poses
    acceleration[:, 2] += STANDARD_GRAVITY
    force = np.einsum("nij,ni->nj", poses, acceleration)
    rate, force = (values.reshape(n, each, 3).mean(1) for values in (rate, force))
    at = slice(each - 1, None, each)
    samples = _sent(scene, rng, t[1:][at], rate, force, poses[at])
    return Record(samples, poses[at], "FRD" if seed % 2 else "FLU")


def _sent(
    scene: Scene,
    rng: np.random.Generator,
    t: FloatArray,
    rate: FloatArray,
    force: FloatArray,
    poses: FloatArray,
) -> SampleBlock:
    """Return what a device sends: an industrial sensor."""
    sensor, n, dt = SENSORS["industrial"], len(t), t[1] - t[0]
    degc = 25.0 + (20.0 * -np.expm1(-t / 400.0) if scene.warms else np.zeros(n))
    bias = np.radians(rng.normal(0.0, sensor.turn_on, 3))
    drift = np.radians(SLOPES_DPH / 3600.0) * (degc - 25.0)[:, np.newaxis]
    matrix = np.array(scene.swap) + rng.normal(0.0, scene.scale_sd, (3, 3))
    walk = math.radians(sensor.angle_walk) / 60.0
    gyro = rate @ matrix.T + bias + drift + walk / math.sqrt(dt) * rng.normal(size=(n, 3))
    accel = force + rng.normal(0.0, scene.accel_sd, 3)
    accel += sensor.velocity_walk / math.sqrt(dt) * rng.normal(size=(n, 3))
    field = np.einsum("nij,ni->nj", poses, FIELD_UT + _near(scene, rng, t))
    soft = rng.normal(0.0, SOFT, (3, 3))
    mag = field @ (np.eye(3) + 0.5 * (soft + soft.T)).T
    mag += rng.normal(0.0, HARD_UT, 3) + MAG_NOISE_UT * rng.normal(size=(n, 3))
    if scene.magnet in ("body", "put on"):
        there = t > (60.0 if scene.magnet == "put on" else 0.0)
        mag += np.outer(there, _any_direction(rng) * rng.uniform(5.0, 20.0))
    temperature = np.round((degc + 0.02 * rng.normal(size=n)) * 16.0) / 16.0
    return sent(t, temperature=temperature, gyro=gyro, accel=accel, mag=mag)


def _near(scene: Scene, rng: np.random.Generator, t: FloatArray) -> FloatArray:
    """Return the field of a magnet that is brought near in 5 s, and after 30 s taken away, (n, 3)."""
    if scene.magnet != "near":
        return np.zeros((len(t), 3))
    there = np.clip(np.minimum(t - 70.0, 105.0 - t) / 5.0, 0.0, 1.0)
    return np.asarray(there[:, np.newaxis] ** 3 * _any_direction(rng) * rng.uniform(5.0, 20.0))


def _any_direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def calibrated() -> MagnetometerModel:
    """Return the model of the magnetometer that a calibration has found."""
    strength = float(np.linalg.norm(FIELD_UT))
    return MagnetometerModel(
        unit="uT",
        hard_iron=[0.0] * 3,
        hard_iron_sd=[HARD_UT] * 3,
        soft_iron=np.eye(3).tolist(),
        soft_iron_sd=np.full((3, 3), SOFT).tolist(),
        field=strength,
        residual_sd=MAG_NOISE_UT,
        coverage=1.0,
    )
