"""A navigation-grade unit on a real site, where the ground sways, people walk, and a tripod settles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import DEG_PER_H, EARTH_RATE, MICRO_G, STANDARD_GRAVITY

LATITUDE_DEG = 36.0
RATE_HZ = 100.0
VRW = 5e-5
"""m/s/√s."""
PAPER_ARW, SITE_ARW, TACTICAL_ARW = 2.43e-4, 1e-3, 0.01
"""deg/√h: of the paper, of a fibre-optic gyro, and of a tactical one."""

Tilt = Callable[[FloatArray, np.random.Generator], FloatArray]
"""From seconds (n,) to the angle about the body's level axes, rad, (n, 2)."""


@dataclass(frozen=True)
class Scene:
    """One kind of site.

    Parameters
    ----------
    arw : float
        deg/√h.
    tilt : Tilt
        How the unit moves.
    warm_up : (float, float)
        µg of both level accelerometers, and s.
    bias_deg_per_h : float
        Of each gyro, its sign drawn.
    flicker_deg_per_h : float
        Standard deviation of a Gauss-Markov process of 100 s in each gyro.
    """

    name: str
    arw: float = SITE_ARW
    tilt: Tilt | None = None
    warm_up: tuple[float, float] = (0.0, 150.0)
    bias_deg_per_h: float = 0.0
    flicker_deg_per_h: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)


def _direction(rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle)])


def sway(amplitude: float, hertz: float) -> Tilt:
    """Return a sine of this amplitude, rad, in a random direction."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        wave = amplitude * np.sin(2.0 * math.pi * hertz * t + rng.uniform(0.0, 2.0 * math.pi))
        return np.outer(wave, _direction(rng))

    return tilt


def wind(amplitude: float, hertz: float, damping: float) -> Tilt:
    """Return a resonance driven by noise, of this standard deviation, rad, about each level axis."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        from scipy.signal import lfilter

        step, w = float(t[1] - t[0]), 2.0 * math.pi * hertz
        radius, angle = math.exp(-damping * w * step), w * step * math.sqrt(1.0 - damping**2)
        driven = lfilter(
            [1.0], [1.0, -2.0 * radius * math.cos(angle), radius**2], rng.normal(size=(len(t), 2)), axis=0
        )
        return np.asarray(amplitude * driven / driven.std())

    return tilt


def footsteps(amplitude: float, every_s: float) -> Tilt:
    """Return short swings of the ground, rad, at 5 Hz, gone after half a second."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        total = np.zeros((len(t), 2))
        at = rng.uniform(0.0, every_s)
        while at < t[-1]:
            since = t - at
            swing = np.where(
                since > 0.0, np.sin(10.0 * math.pi * since) * np.exp(-np.maximum(since, 0.0) / 0.15), 0.0
            )
            total += amplitude * np.outer(swing, _direction(rng))
            at += every_s * rng.uniform(0.8, 1.2)
        return total

    return tilt


def settling(amplitude: float, tau_s: float) -> Tilt:
    """Return a tripod that settles by this angle, rad."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        return np.outer(-amplitude * np.expm1(-t / tau_s), _direction(rng))

    return tilt


def creeping(amplitude: float, tau_s: float) -> Tilt:
    """Return a tripod that creeps by the logarithm of time; `amplitude` rad at ten minutes."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        return np.outer(amplitude * np.log1p(t / tau_s) / math.log1p(600.0 / tau_s), _direction(rng))

    return tilt


def together(*parts: Tilt) -> Tilt:
    """Return the sum of motions."""
    return lambda t, rng: np.sum([part(t, rng) for part in parts], axis=0)


MICRO = 1e-6
SCENES = (
    Scene("quiet, noise of the paper", PAPER_ARW),
    Scene("quiet", SITE_ARW),
    Scene("warm-up 83.7 µg, 300 s, noise of the paper", PAPER_ARW, None, (83.7, 300.0)),
    Scene("warm-up 83.7 µg, 150 s", SITE_ARW, None, (83.7, 150.0)),
    Scene("sway 20 µrad at 0.2 Hz", SITE_ARW, sway(20 * MICRO, 0.2)),
    Scene(
        "sway 20 µrad at 0.2 Hz, noise of the paper, warm-up", PAPER_ARW, sway(20 * MICRO, 0.2), (83.7, 150.0)
    ),
    Scene("sway 200 µrad at 0.07 Hz", SITE_ARW, sway(200 * MICRO, 0.07)),
    Scene("sway 5 µrad at 1.3 Hz", SITE_ARW, sway(5 * MICRO, 1.3)),
    Scene("wind, 20 µrad at 0.25 Hz", SITE_ARW, wind(20 * MICRO, 0.25, 0.05)),
    Scene("footsteps of 2 µrad every 8 s", SITE_ARW, footsteps(2 * MICRO, 8.0)),
    Scene("footsteps of 20 µrad every 3 s", SITE_ARW, footsteps(20 * MICRO, 3.0)),
    Scene(
        "footsteps of 2 µrad, noise of the paper, warm-up",
        PAPER_ARW,
        footsteps(2 * MICRO, 8.0),
        (83.7, 150.0),
    ),
    Scene("settling 50 µrad, 60 s", SITE_ARW, settling(50 * MICRO, 60.0)),
    Scene("settling 200 µrad, 60 s", SITE_ARW, settling(200 * MICRO, 60.0)),
    Scene("settling 50 µrad, 120 s, noise of the paper", PAPER_ARW, settling(50 * MICRO, 120.0)),
    Scene("settling 200 µrad, 20 s, warm-up", SITE_ARW, settling(200 * MICRO, 20.0), (83.7, 150.0)),
    Scene("settling 50 µrad, 300 s, warm-up", SITE_ARW, settling(50 * MICRO, 300.0), (83.7, 150.0)),
    Scene("creeping 100 µrad", SITE_ARW, creeping(100 * MICRO, 20.0)),
    Scene(
        "sway, footsteps, settling 50 µrad, warm-up",
        SITE_ARW,
        together(sway(20 * MICRO, 0.2), footsteps(2 * MICRO, 8.0), settling(50 * MICRO, 60.0)),
        (83.7, 150.0),
    ),
    Scene("sway 2 µrad at 0.05 Hz", SITE_ARW, sway(2 * MICRO, 0.05)),
    Scene("sway 200 µrad at 0.05 Hz", SITE_ARW, sway(200 * MICRO, 0.05)),
    Scene("sway 200 µrad at 0.5 Hz", SITE_ARW, sway(200 * MICRO, 0.5)),
    Scene("sway 200 µrad at 1.97 Hz", SITE_ARW, sway(200 * MICRO, 1.97)),
    Scene("sway 20 µrad at 1.97 Hz, noise of the paper", PAPER_ARW, sway(20 * MICRO, 1.97)),
    Scene("wind, 200 µrad at 0.5 Hz", SITE_ARW, wind(200 * MICRO, 0.5, 0.02)),
    Scene("wind, 5 µrad at 0.1 Hz, noise of the paper", PAPER_ARW, wind(5 * MICRO, 0.1, 0.2)),
    Scene("traffic, 1 µrad about 12 Hz", SITE_ARW, wind(MICRO, 12.0, 0.1)),
    Scene("footsteps of 0.2 µrad every 1 s", SITE_ARW, footsteps(0.2 * MICRO, 1.0)),
    Scene("footsteps of 20 µrad every 1 s", SITE_ARW, footsteps(20 * MICRO, 1.0)),
    Scene("footsteps of 20 µrad every 60 s", SITE_ARW, footsteps(20 * MICRO, 60.0)),
    Scene("footsteps of 5 µrad every 5 s, noise of the paper", PAPER_ARW, footsteps(5 * MICRO, 5.0)),
    Scene("settling 5 µrad, 60 s", SITE_ARW, settling(5 * MICRO, 60.0)),
    Scene("settling 500 µrad, 10 s", SITE_ARW, settling(500 * MICRO, 10.0)),
    Scene("settling 500 µrad, 100 s", SITE_ARW, settling(500 * MICRO, 100.0)),
    Scene("settling 500 µrad, 600 s", SITE_ARW, settling(500 * MICRO, 600.0)),
    Scene("settling 20 µrad, 600 s, noise of the paper", PAPER_ARW, settling(20 * MICRO, 600.0)),
    Scene("tactical", TACTICAL_ARW),
    Scene("tactical, wind, 20 µrad at 0.25 Hz", TACTICAL_ARW, wind(20 * MICRO, 0.25, 0.05)),
    Scene("bias of 3 °/h, not declared", SITE_ARW, bias_deg_per_h=3.0),
    Scene("bias of 0.05 °/h, not declared", SITE_ARW, bias_deg_per_h=0.05),
    Scene("flicker of 0.01 °/h", SITE_ARW, flicker_deg_per_h=0.01),
)


@dataclass(frozen=True)
class Record:
    """What the unit sent, and its heading, rad."""

    block: SampleBlock
    heading: float


def record(scene: Scene, seconds: float, seed: int) -> Record:
    """Return a seeded record of a level unit in forward-right-down axes."""
    rng = np.random.default_rng([seed, sum(map(ord, scene.name))])
    n, step = round(seconds * RATE_HZ), 1.0 / RATE_HZ
    t, heading, latitude = step * np.arange(n), rng.uniform(0.0, 2.0 * math.pi), math.radians(LATITUDE_DEG)
    earth = EARTH_RATE * np.array(
        [math.cos(latitude) * math.cos(heading), -math.cos(latitude) * math.sin(heading), -math.sin(latitude)]
    )
    gyro: FloatArray = earth + rng.normal(size=(n, 3)) * math.radians(scene.arw) / 60.0 * math.sqrt(RATE_HZ)
    gyro += scene.bias_deg_per_h * DEG_PER_H * rng.choice([-1.0, 1.0], 3)
    if scene.flicker_deg_per_h:
        from scipy.signal import lfilter

        keep = math.exp(-step / 100.0)
        noise = rng.normal(size=(n, 3)) * math.sqrt(1.0 - keep**2)
        noise[0] = rng.normal(size=3)
        gyro += np.asarray(scene.flicker_deg_per_h * DEG_PER_H * lfilter([1.0], [1.0, -keep], noise, axis=0))
    accel = np.array([0.0, 0.0, -STANDARD_GRAVITY]) + rng.normal(size=(n, 3)) * VRW * math.sqrt(RATE_HZ)
    amplitude, tau = scene.warm_up
    drift: FloatArray = -amplitude * MICRO_G * np.expm1(-t / tau)
    accel[:, :2] += drift[:, None]
    if scene.tilt is not None:
        angle = scene.tilt(np.asarray(t, np.float64), rng)
        gyro[1:, :2] += np.diff(angle, axis=0) / step
        # Turned by a about its axes, the body sees the vector f as f - a x f.
        accel[:, 0] += angle[:, 1] * STANDARD_GRAVITY
        accel[:, 1] -= angle[:, 0] * STANDARD_GRAVITY
    columns = {f"gyro_{a}": gyro[:, j].copy() for j, a in enumerate("xyz")}
    columns |= {f"accel_{a}": accel[:, j].copy() for j, a in enumerate("xyz")}
    time = {
        "device_time_ns": (np.arange(n) * (1e9 * step)).astype(np.int64),
        "segment": np.zeros(n, np.int64),
    }
    return Record(SampleBlock({**time, **columns}), heading)


def mean_heading(block: SampleBlock, rows: int, weights: Callable[..., Any]) -> float:
    """Return the heading, rad, of the weighted mean of the first rows of the gyros of a level unit."""
    w = weights(rows)
    x, y = (float(w @ block[f"gyro_{axis}"][:rows]) for axis in "xy")
    return math.atan2(-y, x)
