"""A navigation-grade unit on a real site, where the ground sways, people walk, and a tripod settles."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from alignment_site_tilts import (
    creeping,
    door,
    footsteps,
    gusts,
    in_hand,
    lorry,
    lorry_once,
    settling,
    slowing,
    steadily,
    sway,
    swelling,
    swinging,
    turning,
    wind,
)
from samples import gauss_markov, sent
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
    """One kind of site."""

    name: str
    tilts: tuple[tuple[Any, ...], ...] = ()
    """How the unit moves: functions of alignment_site_tilts and numbers."""
    arw: float = SITE_ARW
    """deg/√h."""
    warm_up: tuple[float, float] = (0.0, 150.0)
    """µg of both level accelerometers, and s."""
    bias_deg_per_h: float = 0.0
    """Of each gyro, its sign drawn."""
    east_bias_deg_per_h: float = 0.0
    """Of nothing but a gyro that points east, as the unit then stands."""
    flicker_deg_per_h: float = 0.0
    """Standard deviation of a Gauss-Markov process of 100 s in each gyro."""
    vrw: float = VRW
    """m/s/√s."""
    lever_m: float = 0.0
    """How far above the pivot of a tilt the accelerometers are; they see its acceleration, too."""
    steps_ug: float = 0.0
    """Standard deviation of jumps of each accelerometer, one in 100 s."""
    force_ug: float = 0.0
    """Bias of each level accelerometer, its sign drawn."""
    latitude_deg: float = LATITUDE_DEG
    rate_hz: float = RATE_HZ
    any_attitude: bool = False
    """The body stands on any of its sides, rather than level."""
    turns: tuple[tuple[Any, ...], ...] = ()
    """About the vertical: functions of alignment_site_tilts and numbers."""
    lean_deg: float = 0.0
    """By which the axis of the turn leans, in a direction that is drawn."""
    parameters: Mapping[str, float | None] = field(default_factory=dict)


ANY = {"accel_bias_sd_ug": None}
"""Accelerometers whose bias has no declared sigma."""
WARM_UP = (83.7, 150.0)
"""Of the paper: µg and s."""
KINDS: tuple[tuple[str, Callable[..., FloatArray], tuple[tuple[float, ...], ...]], ...] = (
    ("sway {:g} µrad at {:g} Hz", sway, (
        (20, 0.2), (200, 0.07), (5, 1.3), (2, 0.05), (200, 0.05), (200, 0.5), (200, 1.97), (2000, 0.01),
        (50, 0.01), (2000, 0.1))),
    ("wind, {:g} µrad at {:g} Hz", wind, (
        (20, 0.25, 0.05), (200, 0.5, 0.02), (50, 0.03, 0.2), (10, 0.01, 0.5))),
    ("footsteps of {:g} µrad every {:g} s", footsteps, (
        (2, 8), (20, 3), (0.2, 1), (20, 1), (20, 60), (200, 5), (100, 0.5), (100, 20))),
    ("settling {:g} µrad, {:g} s", settling, (
        (50, 60), (200, 60), (5, 60), (500, 10), (500, 100), (500, 600), (2000, 100), (2000, 3000),
        (100, 5), (10, 30))),
    ("lorries, {:g} µrad every {:g} s", lorry, ((30, 40), (5, 15))),
    ("one lorry, {:g} µrad at {:g} Hz, at {:g} s", lorry_once, (
        (30, 1.3, 30), (30, 1.3, 300), (1000, 0.5, 300))),
    ("a door slams, {:g} µrad, at {:g} s", door, ((100, 30), (100, 300))),
    ("gusts, {:g} µrad, {:g} s", gusts, ((10, 1), (100, 3))),
    ("in the hand for {:g} s", in_hand, ((3,), (25,))),
)  # fmt: skip
"""Name, motion and numbers of sites where nothing else is out of the ordinary."""
SCENES = (
    Scene("quiet, noise of the paper", arw=PAPER_ARW),
    Scene("quiet"),
    Scene("warm-up 83.7 µg, 300 s, noise of the paper", arw=PAPER_ARW, warm_up=(83.7, 300.0)),
    Scene("warm-up 83.7 µg, 150 s", warm_up=WARM_UP),
    Scene("sway 20 µrad at 0.2 Hz, noise of the paper, warm-up", ((sway, 20, 0.2),), PAPER_ARW, WARM_UP),
    Scene("footsteps of 2 µrad, noise of the paper, warm-up", ((footsteps, 2, 8),), PAPER_ARW, WARM_UP),
    Scene("settling 50 µrad, 120 s, noise of the paper", ((settling, 50, 120),), PAPER_ARW),
    Scene("settling 200 µrad, 20 s, warm-up", ((settling, 200, 20),), warm_up=WARM_UP),
    Scene("settling 50 µrad, 300 s, warm-up", ((settling, 50, 300),), warm_up=WARM_UP),
    Scene("creeping 100 µrad", ((creeping, 100, 20),)),
    Scene(
        "sway, footsteps, settling 50 µrad, warm-up",
        ((sway, 20, 0.2), (footsteps, 2, 8), (settling, 50, 60)),
        warm_up=WARM_UP,
    ),
    Scene("sway 20 µrad at 1.97 Hz, noise of the paper", ((sway, 20, 1.97),), PAPER_ARW),
    Scene("wind, 5 µrad at 0.1 Hz, noise of the paper", ((wind, 5, 0.1, 0.2),), PAPER_ARW),
    Scene("traffic, 1 µrad about 12 Hz", ((wind, 1, 12, 0.1),)),
    Scene("footsteps of 5 µrad every 5 s, noise of the paper", ((footsteps, 5, 5),), PAPER_ARW),
    Scene("settling 20 µrad, 600 s, noise of the paper", ((settling, 20, 600),), PAPER_ARW),
    Scene("tactical", arw=TACTICAL_ARW),
    Scene("tactical, wind, 20 µrad at 0.25 Hz", ((wind, 20, 0.25, 0.05),), TACTICAL_ARW),
    Scene("bias of 3 °/h, not declared", bias_deg_per_h=3),
    Scene("bias of 0.05 °/h, not declared", bias_deg_per_h=0.05),
    Scene("flicker of 0.01 °/h", flicker_deg_per_h=0.01),
    Scene("bias of 3 °/h of the gyro that points east", east_bias_deg_per_h=3),
    Scene("sway 500 µrad at 0.02 Hz, noise of the paper", ((sway, 500, 0.02),), PAPER_ARW),
    Scene("sway 50 µrad at 0.03 Hz, warm-up", ((sway, 50, 0.03),), warm_up=WARM_UP),
    Scene("sway 200 µrad at 0.08 Hz, 3 m above its pivot", ((sway, 200, 0.08),), lever_m=3),
    Scene("sway 100 µrad at 4.3 Hz, 1 m above its pivot", ((sway, 100, 4.3),), lever_m=1),
    Scene("sway 100 µrad at 0.06 Hz, dying in 40 s", ((sway, 100, 0.06, 40),)),
    Scene("sway 100 µrad at 0.15 Hz, swelling", ((swelling, 100, 0.15),)),
    Scene("sway 100 µrad at 0.15 Hz, its frequency ±10 %", ((sway, 100, 0.15, math.inf, 0.1),)),
    Scene("sway 100 µrad at 0.04 Hz and 30 µrad at 0.11 Hz", ((sway, 100, 0.04), (sway, 30, 0.11))),
    Scene("sway 100 µrad at 0.05 Hz, settling 100 µrad, 200 s", ((sway, 100, 0.05), (settling, 100, 200))),
    Scene("settling 100 µrad, 100 s, tactical", ((settling, 100, 100),), TACTICAL_ARW),
    Scene("quiet, accelerometers ten times as noisy", vrw=10 * VRW),
    Scene("sway 200 µrad at 0.05 Hz, accelerometers ten times as noisy", ((sway, 200, 0.05),), vrw=10 * VRW),
    Scene("sway 200 µrad at 0.05 Hz, tactical", ((sway, 200, 0.05),), TACTICAL_ARW),
    Scene(
        "settling 50 µrad, 100 s, accelerometers of a tenth of the noise",
        ((settling, 50, 100),),
        vrw=VRW / 10,
    ),
    Scene("accelerometers that jump by 30 µg", steps_ug=30),
    Scene("gyros of a tenth of the noise", arw=SITE_ARW / 10),
    Scene(
        "at 0°, any attitude, 10 Hz, sway 20 µrad at 0.2 Hz",
        ((sway, 20, 0.2),),
        latitude_deg=0,
        rate_hz=10,
        any_attitude=True,
    ),
    Scene(
        "at 60°, any attitude, settling 50 µrad, 60 s",
        ((settling, 50, 60),),
        latitude_deg=60,
        any_attitude=True,
    ),
    Scene(
        "at -75°, any attitude, sway 100 µrad at 0.05 Hz",
        ((sway, 100, 0.05),),
        latitude_deg=-75,
        any_attitude=True,
    ),
    Scene("one lorry, 300 µrad, at 300 s, tactical", ((lorry_once, 300, 3, 300),), TACTICAL_ARW),
    Scene("a door slams, 10 µrad, at 540 s, noise of the paper", ((door, 10, 540),), PAPER_ARW),
    Scene("swell, 1000 µrad at 14 and 15 s", ((sway, 1000, 1 / 14), (sway, 1000, 1 / 15))),
    Scene("accelerometers off by 100 µg, not declared", force_ug=100, parameters=ANY),
    Scene("accelerometers off by 1000 µg, not declared", force_ug=1000, parameters=ANY),
    Scene(
        "accelerometers off by 100 µg, not declared, noise of the paper",
        arw=PAPER_ARW,
        force_ug=100,
        parameters=ANY,
    ),
    Scene(
        "tactical, accelerometers off by 1000 µg, not declared",
        arw=TACTICAL_ARW,
        force_ug=1000,
        parameters=ANY,
    ),
    Scene("at 80°, quiet, 200 Hz", latitude_deg=80, rate_hz=200),
    *(Scene(name.format(*size), ((move, *size),)) for name, move, sizes in KINDS for size in sizes),
)
HALF_TURN = (turning, 180, 300, 308)
CREEPS = (
    *(
        Scene(f"{angle:g}° in {seconds:g} s", turns=((turning, angle, 0, seconds),))
        for seconds in (20.0, 60.0, 200.0, 600.0)
        for angle in (0.03, 0.3, 3, 30)
    ),
    *(
        Scene(
            f"3° in {seconds:g} s, biases of {bias:g} °/h",
            bias_deg_per_h=bias,
            turns=((turning, 3, 0, seconds),),
        )
        for seconds in (200.0, 600.0)
        for bias in (0.01, 0.1, 0.5, 2.0)
    ),
    Scene(
        "3° in 200 s, tactical, biases of 0.03 °/h",
        arw=TACTICAL_ARW,
        bias_deg_per_h=0.03,
        turns=((turning, 3, 0, 200),),
    ),
    Scene("3° from 60 to 300 s", turns=((turning, 3, 60, 300),)),
    Scene("0.3° in 600 s, steadily", turns=((steadily, 0.3, 600),)),
    Scene("3° in 600 s, steadily", turns=((steadily, 3, 600),)),
    Scene("3° in 300 s, steadily", turns=((steadily, 3, 300),)),
    Scene("3°, slowing down in 30 s", turns=((slowing, 3, 30),)),
    Scene("3°, slowing down in 300 s", turns=((slowing, 3, 300),)),
    Scene("to and fro by 0.1° in 100 s", turns=((swinging, 0.1, 100),)),
    Scene("to and fro by 1° in 400 s", turns=((swinging, 1, 400),)),
    Scene("half a turn, biases of 2 °/h", bias_deg_per_h=2, turns=(HALF_TURN,)),
    *(
        Scene(
            f"half a turn about an axis that leans by {lean:g}°, biases of {bias:g} °/h",
            bias_deg_per_h=bias,
            turns=(HALF_TURN,),
            lean_deg=lean,
        )
        for lean in (0.6, 1.3, 3.0)
        for bias in (0.0, 2.0)
    ),
    *(
        Scene(
            f"{first:g}° in 280 s, half a turn, {then:g}° in 280 s, biases of {bias:g} °/h",
            bias_deg_per_h=bias,
            turns=((turning, first, 10, 290), HALF_TURN, (turning, then, 315, 595)),
        )
        for first, then, bias in ((0, 10, 30), (10, 0, 30), (3, -3, 2), (3, 3, 2), (0, 3, 0), (1, 0, 0.5))
    ),
)
"""Turns about the vertical, each from the first sample on, where no other time is stated."""


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
    for turn, *numbers in scene.turns:
        heading += turn(np.arange(n) / scene.rate_hz, *numbers)
    attitude = _attitude(scene, heading, rng)
    gyro, accel = _at_rest(scene, heading, attitude, rng)
    if scene.tilts:
        step = 1.0 / scene.rate_hz
        angle = sum(tilt(step * np.arange(n), rng, *numbers) for tilt, *numbers in scene.tilts)
        gyro[1:, :2] += np.diff(angle, axis=0) / step
        # Turned by a about its axes, the body has the vector f as f - a x f; above its pivot, it swings.
        swing = scene.lever_m * np.gradient(np.gradient(angle, step, axis=0), step, axis=0)
        force = angle * STANDARD_GRAVITY + swing
        accel[:, 0] += force[:, 1]
        accel[:, 1] -= force[:, 0]
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
    return Record(sent(np.arange(n) / scene.rate_hz, gyro=gyro, accel=accel), heading, level)


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
    to_body = attitude.inv()
    gyro = rng.normal(size=(n, 3)) * math.radians(scene.arw) / 60.0 / math.sqrt(step)
    gyro += EARTH_RATE * to_body.apply([math.cos(latitude), 0.0, -math.sin(latitude)])
    gyro[1:, 2] += np.diff(heading) / step
    gyro += scene.bias_deg_per_h * DEG_PER_H * rng.choice([-1.0, 1.0], 3)
    gyro += scene.east_bias_deg_per_h * DEG_PER_H * rng.choice([-1.0, 1.0]) * east
    if scene.flicker_deg_per_h:
        gyro += gauss_markov(rng, n, scene.rate_hz, 100.0, scene.flicker_deg_per_h * DEG_PER_H)
    accel = rng.normal(size=(n, 3)) * scene.vrw / math.sqrt(step)
    accel -= STANDARD_GRAVITY * to_body.apply([0.0, 0.0, 1.0])
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
