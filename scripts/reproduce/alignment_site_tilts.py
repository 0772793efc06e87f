"""How a unit that should stand still moves: sway, wind, footsteps, a tripod that settles, a lorry, creep.

A tilt takes seconds (n,), a generator and its own numbers (µrad, s and Hz), and returns the angle about the
body's level axes, rad, (n, 2).  A turn takes seconds and its own numbers (degrees and s), and returns the
angle about the vertical, rad, clockwise from above, (n,).
"""

import math

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import FloatArray

MICRO, DEGREE = 1e-6, math.pi / 180.0
Generator = np.random.Generator


def _direction(rng: Generator) -> FloatArray:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle)])


def _phase(rng: Generator) -> float:
    return float(rng.uniform(0.0, 2.0 * math.pi))


def sway(
    t: FloatArray,
    rng: Generator,
    urad: float,
    hertz: float,
    decay_s: float = math.inf,
    modulation: float = 0.0,
) -> FloatArray:
    """Return a sine in a random direction.

    It may die away, and its frequency may swing by a share `modulation` of itself, eight times slower.
    """
    phase = 2.0 * math.pi * hertz * t + _phase(rng)
    phase += 8.0 * modulation * np.sin(phase / 8.0)
    return np.outer(MICRO * urad * np.exp(-t / decay_s) * np.sin(phase), _direction(rng))


def swelling(t: FloatArray, rng: Generator, urad: float, hertz: float) -> FloatArray:
    """Return a sway whose amplitude swells and falls, eight times slower than it sways."""
    swell = 0.5 + 0.5 * np.sin(2.0 * math.pi * hertz / 8.0 * t + _phase(rng))
    return np.asarray(sway(t, rng, urad, hertz) * swell[:, None])


def lorry(t: FloatArray, rng: Generator, urad: float, every_s: float) -> FloatArray:
    """Return lorries that pass: the ground leans and comes back within some 6 s, and trembles at 8 Hz."""
    total = np.zeros((len(t), 2))
    at = rng.uniform(0.0, every_s)
    while at < t[-1]:
        near = np.exp(-0.5 * ((t - at) / 1.5) ** 2)
        total += MICRO * urad * np.outer(near * (1.0 + 0.3 * np.sin(16.0 * math.pi * t)), _direction(rng))
        at += every_s * rng.uniform(0.5, 1.5)
    return total


def lorry_once(t: FloatArray, rng: Generator, urad: float, hertz: float, at_s: float) -> FloatArray:
    """Return one that stops by: for some 16 s the ground leans, and sways in another direction."""
    near = MICRO * urad * np.exp(-(((t - at_s) / 8.0) ** 2))
    leans, sways = np.outer(near, _direction(rng)), np.outer(near, _direction(rng))
    return leans + sways * np.sin(2.0 * math.pi * hertz * t + _phase(rng))[:, None]


def door(t: FloatArray, rng: Generator, urad: float, at_s: float) -> FloatArray:
    """Return a door that slams: the floor swings at 5 and 6 Hz, and dies away in 2 s."""
    since = np.maximum(t - at_s, 0.0)
    swing = np.sin(2.0 * math.pi * np.outer(since, rng.uniform(4.5, 6.5, 2)))
    return np.asarray(MICRO * urad * np.exp(-since / 2.0)[:, None] * swing)


def gusts(t: FloatArray, rng: Generator, urad: float, lasting_s: float) -> FloatArray:
    """Return angles that jitter about each level axis, with this standard deviation and correlation time."""
    keep = math.exp(-float(t[1] - t[0]) / lasting_s)
    driven = rng.normal(size=(len(t), 2))
    for _ in range(2):
        driven = np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0))
    return np.asarray(MICRO * urad * driven / driven.std())


def in_hand(t: FloatArray, rng: Generator, until_s: float) -> FloatArray:
    """Return a unit that is carried at first, by tenths of a radian at up to 2 Hz, and put down."""
    left = np.clip((until_s - t) / 1.5, 0.0, 1.0)
    total = np.zeros((len(t), 2))
    for hertz in rng.uniform(0.2, 2.0, 6):
        total += 0.1 / hertz * np.outer(np.sin(2.0 * math.pi * hertz * t + _phase(rng)), _direction(rng))
    return np.asarray(total * (left**2 * (3.0 - 2.0 * left))[:, None])


def wind(t: FloatArray, rng: Generator, urad: float, hertz: float, damping: float) -> FloatArray:
    """Return a resonance driven by noise, of this standard deviation about each level axis."""
    step, w = float(t[1] - t[0]), 2.0 * math.pi * hertz
    radius, angle = math.exp(-damping * w * step), w * step * math.sqrt(1.0 - damping**2)
    poles = [1.0, -2.0 * radius * math.cos(angle), radius**2]
    driven = lfilter([1.0], poles, rng.normal(size=(len(t), 2)), axis=0)
    return np.asarray(MICRO * urad * driven / driven.std())


def footsteps(t: FloatArray, rng: Generator, urad: float, every_s: float) -> FloatArray:
    """Return short swings of the ground at 5 Hz, gone after half a second."""
    total = np.zeros((len(t), 2))
    at = rng.uniform(0.0, every_s)
    while at < t[-1]:
        since = np.maximum(t - at, 0.0)
        swing = np.sin(10.0 * math.pi * since) * np.exp(-since / 0.15)
        total += MICRO * urad * np.outer(swing, _direction(rng))
        at += every_s * rng.uniform(0.8, 1.2)
    return total


def settling(t: FloatArray, rng: Generator, urad: float, tau_s: float) -> FloatArray:
    """Return a tripod that settles by this angle."""
    return np.outer(-MICRO * urad * np.expm1(-t / tau_s), _direction(rng))


def creeping(t: FloatArray, rng: Generator, urad: float, tau_s: float) -> FloatArray:
    """Return a tripod that creeps by the logarithm of time; by this angle in ten minutes."""
    return np.outer(MICRO * urad * np.log1p(t / tau_s) / math.log1p(600.0 / tau_s), _direction(rng))


def turning(t: FloatArray, degrees: float, from_s: float, until_s: float) -> FloatArray:
    """Return a turn that begins and ends gently; its rate and acceleration do not jump."""
    share = np.clip((t - from_s) / (until_s - from_s), 0.0, 1.0)
    return np.asarray(DEGREE * degrees * share**3 * (10.0 - 15.0 * share + 6.0 * share**2))


def steadily(t: FloatArray, degrees: float, until_s: float) -> FloatArray:
    """Return a turn at one rate from the first sample on."""
    return np.asarray(DEGREE * degrees * np.minimum(t / until_s, 1.0))


def slowing(t: FloatArray, degrees: float, tau_s: float) -> FloatArray:
    """Return a turn that slows down, as of a head that has just been clamped."""
    return np.asarray(-DEGREE * degrees * np.expm1(-t / tau_s))


def swinging(t: FloatArray, degrees: float, period_s: float) -> FloatArray:
    """Return a turn to and fro, as of a mast in the sun."""
    return np.asarray(DEGREE * degrees * np.sin(2.0 * math.pi * t / period_s + 1.0))
