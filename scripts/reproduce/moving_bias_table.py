"""Bias of units that never rest: a rover, a car, a boat, somebody who walks, a drone; beside VQF."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from attitude_scenes import ACCEL_SD, SCALE_SD, turned
from handled_units import LATITUDE_DEG, SENSORS, TAUS_S, waves
from samples import gauss_markov, sent
from scipy.spatial.transform import Rotation
from study import Cell, Cells, Options, Study, Table, largest, matrix, over_bar, rms, worst_first
from vqf import VQF

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import DEG_PER_H, EARTH_RATE, STANDARD_GRAVITY

PER_G_DPS = 0.02
"""Largest sensitivity to the specific force, °/s/g."""
SETTLED_S = 70.0
"""The first value comes after a minute."""
HEADS = (
    "scene", "Hz", "min", "z rms", "max", "°/h", "VQF, the same axes", "σ °/h", "claimed %", "VQF, all axes",
)  # fmt: skip
FORMATS = ("", ".0f", "g", ".2f", ".1f", ".0f", ".0f", ".0f", ".0f", ".0f")
Moves = tuple[FloatArray, FloatArray, FloatArray]
"""Roll, pitch and yaw, rad, velocity, m/s, and what shakes, m/s², east, north, up; (n, 3) each."""


def _along(speed: FloatArray, yaw: FloatArray) -> FloatArray:
    return np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros(len(yaw))])


@dataclass(frozen=True)
class Vehicle:
    """How something moves: sizes are rms, frequencies from, to, Hz.

    Parameters
    ----------
    sway : tuple
        Roll and pitch, rad, and frequencies.
    yaw : tuple
        The same.
    speed : tuple
        Forward, m/s, its changes as a share, and their frequencies.
    drift : tuple
        Velocity in any direction, m/s, and frequencies.
    shakes : tuple
        m/s², and frequencies.
    """

    sway: tuple[float, float, float]
    yaw: tuple[float, float, float]
    speed: tuple[float, float, float, float]
    drift: tuple[float, float, float]
    shakes: tuple[float, float, float]

    def moves(self, rng: np.random.Generator, t: FloatArray) -> Moves:
        """Return a way."""
        angles = waves(rng, t, *self.sway[1:], self.sway[0])
        angles[:, 2] += waves(rng, t, *self.yaw[1:], self.yaw[0])[:, 2]
        mean, share, slowest_hz, fastest_hz = self.speed
        speed = mean * (1.0 + share * waves(rng, t, slowest_hz, fastest_hz, 1.0)[:, 0])
        velocity = _along(speed, angles[:, 2]) + waves(rng, t, *self.drift[1:], self.drift[0])
        return angles, velocity, waves(rng, t, *self.shakes[1:], self.shakes[0])


SLIPS, ROAD = (0.0, 1.0, 2.0), (1.0, 2.0, 15.0)
VEHICLES = {
    "rover": Vehicle((0.03, 0.1, 2.0), (1.5, 0.005, 0.1), (1.0, 0.5, 0.01, 0.1), SLIPS, ROAD),
    "car": Vehicle((0.02, 0.1, 2.0), (1.5, 0.001, 0.03), (12.0, 0.5, 0.003, 0.05), SLIPS, ROAD),
    "boat": Vehicle(
        (0.09, 0.08, 0.25), (0.7, 0.002, 0.05), (3.0, 0.2, 0.002, 0.02), (0.5, 0.08, 0.25), (0.2, 10.0, 24.0)
    ),
    "walking": Vehicle(
        (0.08, 0.5, 4.0), (1.5, 0.005, 0.1), (1.4, 0.2, 0.01, 0.1), (0.2, 1.0, 4.0), (1.5, 5.0, 20.0)
    ),
    "drone": Vehicle(
        (0.12, 0.05, 0.6), (1.5, 0.005, 0.1), (0.0, 0.0, 0.01, 0.1), (2.0, 0.03, 0.3), (6.0, 10.0, 24.0)
    ),
}


def simulate(vehicle: Vehicle, rate_hz: float, seconds: float, seed: int) -> tuple[SampleBlock, FloatArray]:
    """Return what an industrial sensor in any pose sends, and its bias with the earth rate, rad/s, (n, 3)."""
    rng = np.random.default_rng(seed)
    n, sensor = round(seconds * rate_hz), SENSORS["industrial"]
    angles, velocity, shaken = vehicle.moves(rng, np.arange(n + 1) / rate_hz)
    lean = np.append(rng.normal(0.0, 0.1, 2), rng.uniform(-np.pi, np.pi))
    mount = np.diag([1.0, -1.0, -1.0]) if seed % 2 else np.eye(3)
    pose = turned(angles + lean) * Rotation.from_matrix(mount)
    rate = (pose[:-1].inv() * pose[1:]).as_rotvec() * rate_hz
    middle = (pose[:-1] * Rotation.from_rotvec(rate / rate_hz / 2.0)).as_matrix()
    acceleration = np.diff(velocity, axis=0) * rate_hz + shaken[1:]
    acceleration[:, 2] += STANDARD_GRAVITY
    force = np.einsum("nij,ni->nj", middle, acceleration)
    latitude = math.radians(LATITUDE_DEG)
    earth = EARTH_RATE * np.array([0.0, math.cos(latitude), math.sin(latitude)]) @ middle
    sensitive = rng.uniform(-1.0, 1.0, (3, 3))
    sensitive *= math.radians(PER_G_DPS) / STANDARD_GRAVITY / np.abs(sensitive).max()
    bias = np.radians(rng.normal(0.0, sensor.turn_on, 3)) + force @ sensitive.T + earth
    for tau_s in TAUS_S:
        bias += gauss_markov(rng, n, rate_hz, tau_s, sensor.flicker_dph * DEG_PER_H)
    white, jolts = rng.normal(size=(2, n, 3)) * math.sqrt(rate_hz)
    gyro = (
        rate
        + rate @ rng.normal(0.0, SCALE_SD, (3, 3))
        + bias
        + math.radians(sensor.angle_walk) / 60.0 * white
    )
    accel = force + rng.normal(0.0, ACCEL_SD, 3) + sensor.velocity_walk * jolts
    return sent(np.arange(1, n + 1) / rate_hz, gyro=gyro, accel=accel), bias


def row(name: str, rate_hz: float, minutes: float, seeds: range) -> tuple[float, Cells]:
    """Return how bad a row is, and the row: values of each second from the first window on."""
    late = slice(round(SETTLED_S * rate_hz), None, round(rate_hz))
    errors, sigmas, others = [], [], []
    for seed in seeds:
        samples, truth = simulate(VEHICLES[name], rate_hz, 60.0 * minutes, seed)
        full = VQF(1.0 / rate_hz).updateBatchFullState(matrix(samples, "gyro"), matrix(samples, "accel"))
        others.append((full["bias"] - truth)[late])
        samples = samples.with_columns(RestAndBias(mode="learned").process(samples))
        errors.append((matrix(samples, "gyro_bias") - truth)[late])
        sigmas.append(matrix(samples, "gyro_bias_sd")[late])
    error, sd, other = (np.concatenate(parts) for parts in (errors, sigmas, others))
    known = np.isfinite(error)
    ratios = error / sd
    in_dph = [rms(error), rms(other[known]), float(np.median(sd[known]))]
    cells: list[Cell] = [
        name,
        rate_hz,
        minutes,
        rms(ratios),
        largest(ratios),
        *(value / DEG_PER_H for value in in_dph),
    ]
    return over_bar(ratios), [*cells, 100.0 * float(known.mean()), rms(other) / DEG_PER_H]


def tables(given: Options) -> Iterator[Table]:
    """Yield one table, the worst row first."""
    kinds = product(VEHICLES, given.lists["rates"], given.lists["minutes"])
    chosen = [kind for kind in kinds if given.only in kind[0]][: 1 if given.quick else None]
    yield Table("", HEADS, worst_first(row(*kind, given.seeds) for kind in chosen), formats=FORMATS)


STUDY = Study(tables, 5, 500, lists={"rates": [50.0], "minutes": [10.0]})
