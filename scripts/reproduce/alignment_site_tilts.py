"""How a unit that should stand still moves: sway, wind, footsteps, a tripod that settles, a lorry, creep."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from imumon.blocks import FloatArray

Tilt = Callable[[FloatArray, np.random.Generator], FloatArray]
"""From seconds (n,) to the angle about the body's level axes, rad, (n, 2)."""
Turn = Callable[[FloatArray], FloatArray]
"""From seconds (n,) to the angle about the vertical, rad, clockwise from above, (n,)."""


def _direction(rng: np.random.Generator) -> FloatArray:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle)])


def sway(amplitude: float, hertz: float, decay_s: float = math.inf, modulation: float = 0.0) -> Tilt:
    """Return a sine of this amplitude, rad, in a random direction.

    It may die away, and its frequency may swing by a share `modulation` of itself, eight times slower.
    """

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        phase = 2.0 * math.pi * hertz * t + rng.uniform(0.0, 2.0 * math.pi)
        phase += 8.0 * modulation * np.sin(phase / 8.0)
        return np.outer(amplitude * np.exp(-t / decay_s) * np.sin(phase), _direction(rng))

    return tilt


def swelling(amplitude: float, hertz: float) -> Tilt:
    """Return a sway whose amplitude swells and falls, eight times slower than it sways."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        swell = 0.5 + 0.5 * np.sin(2.0 * math.pi * hertz / 8.0 * t + rng.uniform(0.0, 2.0 * math.pi))
        return np.asarray(sway(amplitude, hertz)(t, rng) * swell[:, None])

    return tilt


def lorry(amplitude: float, every_s: float) -> Tilt:
    """Return lorries that pass: the ground leans and comes back within some 6 s, and trembles at 8 Hz."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        total = np.zeros((len(t), 2))
        at = rng.uniform(0.0, every_s)
        while at < t[-1]:
            near = np.exp(-0.5 * ((t - at) / 1.5) ** 2)
            total += amplitude * np.outer(near * (1.0 + 0.3 * np.sin(16.0 * math.pi * t)), _direction(rng))
            at += every_s * rng.uniform(0.5, 1.5)
        return total

    return tilt


def lorry_once(amplitude: float, hertz: float, at_s: float) -> Tilt:
    """Return one that stops by: for some 16 s the ground leans, and sways in another direction."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        near = amplitude * np.exp(-(((t - at_s) / 8.0) ** 2))
        leans, sways = np.outer(near, _direction(rng)), np.outer(near, _direction(rng))
        return leans + sways * np.sin(2.0 * math.pi * hertz * t + rng.uniform(0.0, 2.0 * math.pi))[:, None]

    return tilt


def door(amplitude: float, at_s: float) -> Tilt:
    """Return a door that slams: the floor swings at 5 and 6 Hz, and dies away in 2 s."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        since = np.maximum(t - at_s, 0.0)
        swing = np.sin(2.0 * math.pi * np.outer(since, rng.uniform(4.5, 6.5, 2)))
        return np.asarray(amplitude * np.exp(-since / 2.0)[:, None] * swing)

    return tilt


def gusts(amplitude: float, lasting_s: float) -> Tilt:
    """Return angles that jitter about each level axis, with this standard deviation and correlation time."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        from scipy.signal import lfilter

        keep = math.exp(-float(t[1] - t[0]) / lasting_s)
        driven = rng.normal(size=(len(t), 2))
        for _ in range(2):
            driven = np.asarray(lfilter([1.0], [1.0, -keep], driven, axis=0))
        return np.asarray(amplitude * driven / driven.std())

    return tilt


def in_hand(until_s: float) -> Tilt:
    """Return a unit that is carried at first, by tenths of a radian at up to 2 Hz, and put down."""

    def tilt(t: FloatArray, rng: np.random.Generator) -> FloatArray:
        left = np.clip((until_s - t) / 1.5, 0.0, 1.0)
        total = np.zeros((len(t), 2))
        for hertz in rng.uniform(0.2, 2.0, 6):
            swing = np.sin(2.0 * math.pi * hertz * t + rng.uniform(0.0, 2.0 * math.pi))
            total += 0.1 / hertz * np.outer(swing, _direction(rng))
        return np.asarray(total * (left**2 * (3.0 - 2.0 * left))[:, None])

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


def turning(angle: float, from_s: float, until_s: float) -> Turn:
    """Return a turn that begins and ends gently; its rate and acceleration do not jump."""

    def turn(t: FloatArray) -> FloatArray:
        share = np.clip((t - from_s) / (until_s - from_s), 0.0, 1.0)
        return np.asarray(angle * share**3 * (10.0 - 15.0 * share + 6.0 * share**2))

    return turn


def steadily(angle: float, until_s: float) -> Turn:
    """Return a turn at one rate from the first sample on."""
    return lambda t: np.asarray(angle * np.minimum(t / until_s, 1.0))


def slowing(angle: float, tau_s: float) -> Turn:
    """Return a turn that slows down, as of a head that has just been clamped."""
    return lambda t: np.asarray(-angle * np.expm1(-t / tau_s))


def swinging(angle: float, period_s: float) -> Turn:
    """Return a turn to and fro, as of a mast in the sun."""
    return lambda t: np.asarray(angle * np.sin(2.0 * math.pi * t / period_s + 1.0))


def in_turn(*parts: Turn) -> Turn:
    """Return the sum of turns."""
    return lambda t: np.asarray(np.sum([part(t) for part in parts], axis=0))
