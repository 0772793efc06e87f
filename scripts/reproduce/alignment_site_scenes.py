"""A navigation-grade unit on a real site, where the ground sways, people walk, and a tripod settles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from alignment_site_tilts import (
    Tilt,
    Turn,
    creeping,
    door,
    footsteps,
    gusts,
    in_hand,
    in_turn,
    lorry,
    lorry_once,
    settling,
    slowing,
    steadily,
    sway,
    swelling,
    swinging,
    together,
    turning,
    wind,
)
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import DEG_PER_H, EARTH_RATE, MICRO_G, STANDARD_GRAVITY, forward

LATITUDE_DEG = 36.0
RATE_HZ = 100.0
VRW = 5e-5
"""m/s/√s."""
PAPER_ARW, SITE_ARW, TACTICAL_ARW = 2.43e-4, 1e-3, 0.01
"""deg/√h: of the paper, of a fibre-optic gyro, and of a tactical one."""
ACCEL_BIAS_UG = 30.0
"""Of accelerometers of navigation grade, as they are declared."""


@dataclass(frozen=True)
class Scene:
    """One kind of site.

    Parameters
    ----------
    arw : float
        deg/√h.
    tilt : Tilt
        How the unit moves.
    turn : Turn
        How it turns about the vertical.
    warm_up : (float, float)
        µg of both level accelerometers, and s.
    bias_deg_per_h : float
        Of each gyro, its sign drawn.
    east_bias_deg_per_h : float
        Of nothing but a gyro that points east, as the unit then stands.
    flicker_deg_per_h : float
        Standard deviation of a Gauss-Markov process of 100 s in each gyro.
    vrw : float
        m/s/√s.
    lever_m : float
        How far above the pivot of a tilt the accelerometers are; they see its acceleration, too.
    steps_ug : float
        Standard deviation of jumps of each accelerometer, one in 100 s.
    force_ug : float
        Bias of each level accelerometer, its sign drawn.
    any_attitude : bool
        The body stands on any of its sides, rather than level.
    lean_deg : float
        By which the axis of the turn leans, in a direction that is drawn.
    """

    name: str
    arw: float = SITE_ARW
    tilt: Tilt | None = None
    warm_up: tuple[float, float] = (0.0, 150.0)
    bias_deg_per_h: float = 0.0
    east_bias_deg_per_h: float = 0.0
    flicker_deg_per_h: float = 0.0
    vrw: float = VRW
    lever_m: float = 0.0
    steps_ug: float = 0.0
    force_ug: float = 0.0
    latitude_deg: float = LATITUDE_DEG
    rate_hz: float = RATE_HZ
    any_attitude: bool = False
    turn: Turn | None = None
    lean_deg: float = 0.0
    parameters: Mapping[str, float | None] = field(default_factory=dict)


MICRO = 1e-6
ANY = {"accel_bias_sd_ug": None}
"""Accelerometers that nobody has declared."""
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
    Scene("bias of 3 °/h of the gyro that points east", SITE_ARW, east_bias_deg_per_h=3.0),
    Scene("sway 2000 µrad at 0.01 Hz", SITE_ARW, sway(2000 * MICRO, 0.01)),
    Scene("sway 50 µrad at 0.01 Hz", SITE_ARW, sway(50 * MICRO, 0.01)),
    Scene("sway 500 µrad at 0.02 Hz, noise of the paper", PAPER_ARW, sway(500 * MICRO, 0.02)),
    Scene("sway 50 µrad at 0.03 Hz, warm-up", SITE_ARW, sway(50 * MICRO, 0.03), (83.7, 150.0)),
    Scene("sway 2000 µrad at 0.1 Hz", SITE_ARW, sway(2000 * MICRO, 0.1)),
    Scene("sway 200 µrad at 0.08 Hz, 3 m above its pivot", SITE_ARW, sway(200 * MICRO, 0.08), lever_m=3.0),
    Scene("sway 100 µrad at 4.3 Hz, 1 m above its pivot", SITE_ARW, sway(100 * MICRO, 4.3), lever_m=1.0),
    Scene("sway 100 µrad at 0.06 Hz, dying in 40 s", SITE_ARW, sway(100 * MICRO, 0.06, 40.0)),
    Scene("sway 100 µrad at 0.15 Hz, swelling", SITE_ARW, swelling(100 * MICRO, 0.15)),
    Scene("sway 100 µrad at 0.15 Hz, its frequency ±10 %", SITE_ARW, sway(100 * MICRO, 0.15, modulation=0.1)),
    Scene(
        "sway 100 µrad at 0.04 Hz and 30 µrad at 0.11 Hz",
        SITE_ARW,
        together(sway(100 * MICRO, 0.04), sway(30 * MICRO, 0.11)),
    ),
    Scene(
        "sway 100 µrad at 0.05 Hz, settling 100 µrad, 200 s",
        SITE_ARW,
        together(sway(100 * MICRO, 0.05), settling(100 * MICRO, 200.0)),
    ),
    Scene("wind, 50 µrad at 0.03 Hz", SITE_ARW, wind(50 * MICRO, 0.03, 0.2)),
    Scene("wind, 10 µrad at 0.01 Hz", SITE_ARW, wind(10 * MICRO, 0.01, 0.5)),
    Scene("footsteps of 200 µrad every 5 s", SITE_ARW, footsteps(200 * MICRO, 5.0)),
    Scene("footsteps of 100 µrad every 0.5 s", SITE_ARW, footsteps(100 * MICRO, 0.5)),
    Scene("footsteps of 100 µrad every 20 s", SITE_ARW, footsteps(100 * MICRO, 20.0)),
    Scene("lorries, 30 µrad every 40 s", SITE_ARW, lorry(30 * MICRO, 40.0)),
    Scene("lorries, 5 µrad every 15 s", SITE_ARW, lorry(5 * MICRO, 15.0)),
    Scene("settling 2000 µrad, 100 s", SITE_ARW, settling(2000 * MICRO, 100.0)),
    Scene("settling 2000 µrad, 3000 s", SITE_ARW, settling(2000 * MICRO, 3000.0)),
    Scene("settling 100 µrad, 5 s", SITE_ARW, settling(100 * MICRO, 5.0)),
    Scene("settling 10 µrad, 30 s", SITE_ARW, settling(10 * MICRO, 30.0)),
    Scene("settling 100 µrad, 100 s, tactical", TACTICAL_ARW, settling(100 * MICRO, 100.0)),
    Scene("quiet, accelerometers ten times as noisy", SITE_ARW, vrw=10 * VRW),
    Scene(
        "sway 200 µrad at 0.05 Hz, accelerometers ten times as noisy",
        SITE_ARW,
        sway(200 * MICRO, 0.05),
        vrw=10 * VRW,
    ),
    Scene("sway 200 µrad at 0.05 Hz, tactical", TACTICAL_ARW, sway(200 * MICRO, 0.05)),
    Scene(
        "settling 50 µrad, 100 s, accelerometers of a tenth of the noise",
        SITE_ARW,
        settling(50 * MICRO, 100.0),
        vrw=VRW / 10,
    ),
    Scene("accelerometers that jump by 30 µg", SITE_ARW, steps_ug=30.0),
    Scene("gyros of a tenth of the noise", SITE_ARW / 10),
    Scene(
        "at 0°, any attitude, 10 Hz, sway 20 µrad at 0.2 Hz",
        SITE_ARW,
        sway(20 * MICRO, 0.2),
        latitude_deg=0.0,
        rate_hz=10.0,
        any_attitude=True,
    ),
    Scene(
        "at 60°, any attitude, settling 50 µrad, 60 s",
        SITE_ARW,
        settling(50 * MICRO, 60.0),
        latitude_deg=60.0,
        any_attitude=True,
    ),
    Scene(
        "at -75°, any attitude, sway 100 µrad at 0.05 Hz",
        SITE_ARW,
        sway(100 * MICRO, 0.05),
        latitude_deg=-75.0,
        any_attitude=True,
    ),
    Scene("in the hand for 3 s", SITE_ARW, in_hand(3.0)),
    Scene("in the hand for 25 s", SITE_ARW, in_hand(25.0)),
    Scene("one lorry, 30 µrad at 1.3 Hz, at 30 s", SITE_ARW, lorry_once(30 * MICRO, 1.3, 30.0)),
    Scene("one lorry, 30 µrad at 1.3 Hz, at 300 s", SITE_ARW, lorry_once(30 * MICRO, 1.3, 300.0)),
    Scene("one lorry, 1000 µrad at 0.5 Hz, at 300 s", SITE_ARW, lorry_once(1000 * MICRO, 0.5, 300.0)),
    Scene("one lorry, 300 µrad, at 300 s, tactical", TACTICAL_ARW, lorry_once(300 * MICRO, 3.0, 300.0)),
    Scene("a door slams, 100 µrad, at 30 s", SITE_ARW, door(100 * MICRO, 30.0)),
    Scene("a door slams, 100 µrad, at 300 s", SITE_ARW, door(100 * MICRO, 300.0)),
    Scene("a door slams, 10 µrad, at 540 s, noise of the paper", PAPER_ARW, door(10 * MICRO, 540.0)),
    Scene("gusts, 10 µrad, 1 s", SITE_ARW, gusts(10 * MICRO, 1.0)),
    Scene("gusts, 100 µrad, 3 s", SITE_ARW, gusts(100 * MICRO, 3.0)),
    Scene(
        "swell, 1000 µrad at 14 and 15 s",
        SITE_ARW,
        together(sway(1000 * MICRO, 1 / 14), sway(1000 * MICRO, 1 / 15)),
    ),
    Scene("accelerometers off by 100 µg, not declared", SITE_ARW, force_ug=100.0, parameters=ANY),
    Scene("accelerometers off by 1000 µg, not declared", SITE_ARW, force_ug=1000.0, parameters=ANY),
    Scene(
        "accelerometers off by 100 µg, not declared, noise of the paper",
        PAPER_ARW,
        force_ug=100.0,
        parameters=ANY,
    ),
    Scene(
        "tactical, accelerometers off by 1000 µg, not declared", TACTICAL_ARW, force_ug=1000.0, parameters=ANY
    ),
    Scene("at 80°, quiet, 200 Hz", SITE_ARW, latitude_deg=80.0, rate_hz=200.0),
)

DEGREE = math.pi / 180.0
HALF_TURN = turning(math.pi, 300.0, 308.0)
CREEPS = (
    *(
        Scene(f"{angle:g}° in {seconds:g} s", turn=turning(angle * DEGREE, 0.0, seconds))
        for seconds in (20.0, 60.0, 200.0, 600.0)
        for angle in (0.03, 0.3, 3.0, 30.0)
    ),
    *(
        Scene(
            f"3° in {seconds:g} s, biases of {bias:g} °/h",
            bias_deg_per_h=bias,
            turn=turning(3.0 * DEGREE, 0.0, seconds),
        )
        for seconds in (200.0, 600.0)
        for bias in (0.01, 0.1, 0.5, 2.0)
    ),
    Scene(
        "3° in 200 s, tactical, biases of 0.03 °/h",
        TACTICAL_ARW,
        bias_deg_per_h=0.03,
        turn=turning(3.0 * DEGREE, 0.0, 200.0),
    ),
    Scene("3° from 60 to 300 s", turn=turning(3.0 * DEGREE, 60.0, 300.0)),
    Scene("0.3° in 600 s, steadily", turn=steadily(0.3 * DEGREE, 600.0)),
    Scene("3° in 600 s, steadily", turn=steadily(3.0 * DEGREE, 600.0)),
    Scene("3° in 300 s, steadily", turn=steadily(3.0 * DEGREE, 300.0)),
    Scene("3°, slowing down in 30 s", turn=slowing(3.0 * DEGREE, 30.0)),
    Scene("3°, slowing down in 300 s", turn=slowing(3.0 * DEGREE, 300.0)),
    Scene("to and fro by 0.1° in 100 s", turn=swinging(0.1 * DEGREE, 100.0)),
    Scene("to and fro by 1° in 400 s", turn=swinging(DEGREE, 400.0)),
    Scene("half a turn, biases of 2 °/h", bias_deg_per_h=2.0, turn=HALF_TURN),
    *(
        Scene(
            f"half a turn about an axis that leans by {lean:g}°, biases of {bias:g} °/h",
            bias_deg_per_h=bias,
            turn=HALF_TURN,
            lean_deg=lean,
        )
        for lean in (0.6, 1.3, 3.0)
        for bias in (0.0, 2.0)
    ),
    *(
        Scene(
            f"{first:g}° in 280 s, half a turn, {then:g}° in 280 s, biases of {bias:g} °/h",
            bias_deg_per_h=bias,
            turn=in_turn(
                turning(first * DEGREE, 10.0, 290.0), HALF_TURN, turning(then * DEGREE, 315.0, 595.0)
            ),
        )
        for first, then, bias in ((0, 10, 30), (10, 0, 30), (3, -3, 2), (3, 3, 2), (0, 3, 0), (1, 0, 0.5))
    ),
)  # fmt: skip
"""Turns about the vertical, each from the first sample on, but where it says otherwise."""


@dataclass(frozen=True)
class Record:
    """What the unit sent, its heading, rad, (n,), and its gyros in level axes forward and right, (n, 2)."""

    block: SampleBlock
    heading: FloatArray
    level_rate: FloatArray


def record(scene: Scene, seconds: float, seed: int) -> Record:
    """Return a seeded record of a unit; it is level, in forward-right-down axes, if not in any attitude."""
    rng = np.random.default_rng([seed, sum(map(ord, scene.name))])
    n = round(seconds * scene.rate_hz)
    heading = np.full(n, rng.uniform(0.0, 2.0 * math.pi))
    if scene.turn is not None:
        heading += scene.turn(np.asarray(np.arange(n) / scene.rate_hz, np.float64))
    attitude = _attitude(scene, heading, rng)
    gyro, accel = _at_rest(scene, heading, attitude, rng)
    if scene.tilt is not None:
        step = 1.0 / scene.rate_hz
        angle = scene.tilt(np.asarray(step * np.arange(n), np.float64), rng)
        gyro[1:, :2] += np.diff(angle, axis=0) / step
        # Turned by a about its axes, the body sees the vector f as f - a x f; above its pivot, it swings.
        swing = scene.lever_m * np.gradient(np.gradient(angle, step, axis=0), step, axis=0)
        seen = angle * STANDARD_GRAVITY + swing
        accel[:, 0] += seen[:, 1]
        accel[:, 1] -= seen[:, 0]
    ahead = attitude.apply([1.0, 0.0, 0.0])
    heading = np.arctan2(ahead[:, 1], ahead[:, 0])
    level = (Rotation.from_rotvec(np.outer(heading, [0.0, 0.0, -1.0])) * attitude).apply(gyro)[:, :2]
    if scene.any_attitude:
        body = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        body *= np.linalg.det(body)
        gyro, accel = gyro @ body.T, accel @ body.T
        x, y, _ = body.T @ forward(body @ np.array([0.0, 0.0, -1.0]))
        heading += math.atan2(y, x)
        level = level @ np.array([[x, -y], [y, x]])
    columns = {f"gyro_{a}": gyro[:, j].copy() for j, a in enumerate("xyz")}
    columns |= {f"accel_{a}": accel[:, j].copy() for j, a in enumerate("xyz")}
    time_ns = (np.arange(n) * (1e9 / scene.rate_hz)).astype(np.int64)
    block = SampleBlock({"device_time_ns": time_ns, "segment": np.zeros(n, np.int64), **columns})
    return Record(block, heading, level)


def _attitude(scene: Scene, heading: FloatArray, rng: np.random.Generator) -> Rotation:
    """Return the attitudes, from forward-right-down to north-east-down, of a unit that is turned to these
    headings about the vertical, or an axis that leans."""
    turned = Rotation.from_rotvec(np.outer(heading, [0.0, 0.0, 1.0]))
    if not scene.lean_deg:
        return turned
    towards = rng.uniform(0.0, 2.0 * math.pi)
    lean = math.radians(scene.lean_deg) * np.array([math.cos(towards), math.sin(towards), 0.0])
    return Rotation.from_rotvec(lean) * turned


def _at_rest(
    scene: Scene, heading: FloatArray, attitude: Rotation, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return what gyros and accelerometers of a unit at rest in these attitudes send, (n, 3) each."""
    n, step, latitude = len(heading), 1.0 / scene.rate_hz, math.radians(scene.latitude_deg)
    east = np.array([math.sin(heading[0]), math.cos(heading[0]), 0.0])
    seen = attitude.inv()
    gyro = rng.normal(size=(n, 3)) * math.radians(scene.arw) / 60.0 / math.sqrt(step)
    gyro += EARTH_RATE * seen.apply([math.cos(latitude), 0.0, -math.sin(latitude)])
    gyro[1:, 2] += np.diff(heading) / step
    gyro += scene.bias_deg_per_h * DEG_PER_H * rng.choice([-1.0, 1.0], 3)
    gyro += scene.east_bias_deg_per_h * DEG_PER_H * rng.choice([-1.0, 1.0]) * east
    if scene.flicker_deg_per_h:
        from scipy.signal import lfilter

        keep = math.exp(-step / 100.0)
        noise = rng.normal(size=(n, 3)) * math.sqrt(1.0 - keep**2)
        noise[0] = rng.normal(size=3)
        gyro += scene.flicker_deg_per_h * DEG_PER_H * np.asarray(lfilter([1.0], [1.0, -keep], noise, axis=0))
    accel = rng.normal(size=(n, 3)) * scene.vrw / math.sqrt(step)
    accel -= STANDARD_GRAVITY * seen.apply([0.0, 0.0, 1.0])
    amplitude, tau = scene.warm_up
    accel[:, :2] -= amplitude * MICRO_G * np.expm1(-step * np.arange(n) / tau)[:, None]
    if scene.force_ug:
        accel[:, :2] += scene.force_ug * MICRO_G * rng.choice([-1.0, 1.0], 2)
    if scene.steps_ug:
        jumps = rng.normal(size=(n, 2)) * (rng.uniform(size=(n, 2)) < step / 100.0)
        accel[:, :2] += scene.steps_ug * MICRO_G * np.cumsum(jumps, axis=0)
    return gyro, accel


def mean_heading(rate: FloatArray, weights: Callable[[int], FloatArray]) -> float:
    """Return the heading, rad, of the weighted mean of gyros, (n, 2), forward and right."""
    x, y = weights(len(rate)) @ rate
    return math.atan2(-y, x)
