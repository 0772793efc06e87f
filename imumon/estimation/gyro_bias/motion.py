"""Bias of a unit that has never been at rest: gravity turns, by the gyros, with a bias that is not known.

A vehicle speeds up and brakes, but its velocity stays bounded.  In axes that the gyros carry along, what the
accelerometers sum up over a minute is gravity times the time, and a bias of the gyros bends it (to first
order of what is left of the errors, and iterated, Gauss and Newton)::

    ∫ C f dt = g t + v(t) - v(0) + ∫∫ [g x] C (bias + M ω) dt dt + ∫ C accelerometer bias dt

The velocity v is a Matern process, jerky (Ornstein-Uhlenbeck) or smooth (once differentiable), with one of
four correlation times, weighed by likelihood; its standard deviation is fitted to the window.
Scale and misalignment M and the accelerometers' bias are constant, and go from window to window with the
bias.

The rate about the vertical is not estimated.  Only sways make it observable, by terms of second order: its
estimate was wrong by four standard deviations.  So an upright axis has no bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.turns import STILL, Turn, rotation_by
from imumon.geodesy import DEG_PER_H, STANDARD_GRAVITY

HALF_A_SLOT_S = 0.125
PART_S, PARTS = 5.0, 12
"""A window is a minute: a bias of a degree per second turns it by a radian."""
CORRELATIONS_S = (5.0, 20.0, 60.0, 200.0)
MOST_TURNED = math.pi
"""rad: a bias that turns a window by more may be a wrong minimum of the fit, and is not shown."""
UNKNOWN_RATE = math.radians(3.0)
"""Standard deviation of the bias before anything is known: turn-on of consumer gyros."""
UNKNOWN_SCALE, UNKNOWN_FORCE = 0.03, 0.4
"""The same of elements of M, and of the accelerometers' bias, m/s²: 3 % and 40 mg, as data sheets of consumer
units have it."""
ANGLE_WALK = math.radians(0.6) / 60.0
"""Of consumer gyros, rad/sqrt(s): in motion the noise is not measured."""
BIAS_WALK = 30.0 * DEG_PER_H
"""Random walk of the bias, rad/s/sqrt(s): 230 °/h a minute, as 100 °/h/°C at 2 °C/min makes it."""
LEAST_SPEED2 = 1e-4
"""(m/s)²: nothing that moves is steadier than 1 cm/s."""
ITERATIONS = 5
RATE, STATES = slice(0, 3), 15
"""The states: bias, nine elements of M, bias of the accelerometers."""


def _prior() -> FloatArray:
    return np.diag(np.repeat([UNKNOWN_RATE**2, UNKNOWN_SCALE**2, UNKNOWN_FORCE**2], [3, 9, 3]))


@dataclass(slots=True, eq=False)
class Part:
    """Some seconds: the turn, and the integral of the specific force in the axes of its beginning, m/s."""

    turn: Turn = STILL
    velocity: FloatArray = field(default_factory=lambda: np.zeros(3))

    def then(self, turn: Turn, force: FloatArray) -> Part:
        """Return this and a slot after it, with its mean specific force, m/s²."""
        added = self.turn.rotation @ (turn.by_bias @ force)
        return Part(self.turn.then(turn), self.velocity + added)


@dataclass(slots=True, eq=False)
class Motion:
    """Bias by motion, window by window.

    Parameters
    ----------
    mean, covariance : array (15,), (15, 15)
    parts : list of Part
        Of the present window, the last one growing.
    force : array (3,)
        Mean specific force of the last window, m/s².
    """

    mean: FloatArray = field(default_factory=lambda: np.zeros(STATES))
    covariance: FloatArray = field(default_factory=_prior)
    parts: list[Part] = field(default_factory=lambda: [Part()])
    force: FloatArray = field(default_factory=lambda: np.zeros(3))

    def interrupt(self) -> None:
        """Begin the window anew: it rested, or readings are missing."""
        self.parts = [Part()]

    def take(self, turn: Turn, force: FloatArray) -> bool:
        """Take a slot in motion; return whether a window has ended with it."""
        self.parts[-1] = self.parts[-1].then(turn, force)
        if self.parts[-1].turn.seconds < PART_S - HALF_A_SLOT_S:
            return False
        if len(self.parts) < PARTS:
            self.parts.append(Part())
            return False
        window = _Window(self.parts)
        self.covariance[RATE, RATE] += np.eye(3) * BIAS_WALK**2 * window.seconds[-1]
        fits = [_fitted(window, self.mean, self.covariance, process) for process in processes(window.seconds)]
        self.mean, self.covariance = _mixed(fits)
        vertical = window.force / math.sqrt(float(window.force @ window.force))
        known = float(vertical @ self.covariance[RATE, RATE] @ vertical)
        self.covariance[RATE, RATE] += max(UNKNOWN_RATE**2 - known, 0.0) * np.outer(vertical, vertical)
        self.force = window.force
        self.interrupt()
        return True

    @property
    def bias(self) -> tuple[FloatArray, FloatArray]:
        """Return bias and variance until the next window ends, (3,) each; NaN where little is known."""
        variance = np.diag(self.covariance)[RATE] + BIAS_WALK**2 * PART_S * PARTS
        known = variance < (0.5 * UNKNOWN_RATE) ** 2
        known &= float(np.linalg.norm(self.mean[RATE])) * PART_S * PARTS < MOST_TURNED
        return np.where(known, self.mean[RATE], np.nan), np.where(known, variance, np.nan)


class _Window:
    """A minute of parts."""

    def __init__(self, parts: list[Part]) -> None:
        self.parts = parts
        self.seconds = np.cumsum([part.turn.seconds for part in parts])
        # Each in the axes of its end.
        total = sum((part.turn.rotation.T @ part.velocity for part in parts), np.zeros(3))
        self.force = np.asarray(total / self.seconds[-1])

    def summed(self, bias: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the velocities at the ends of parts, less a bias, and what the states change of them.

        They are (n, 3) and (n, 3, 15), m/s, in the axes of the beginning.
        """
        n = len(self.parts)
        velocity, by_states = np.empty((n, 3)), np.empty((n, 3, STATES))
        axes, angle = np.eye(3), np.zeros((3, STATES))
        whole, change = np.zeros(3), np.zeros((3, STATES))
        for k, part in enumerate(self.parts):
            turn, excess = part.turn, part.turn.by_bias @ bias
            added = axes @ rotation_by(-0.5 * excess) @ part.velocity
            turned = np.zeros((3, STATES))
            turned[:, RATE] = axes @ turn.by_bias
            turned[:, 3:12] = axes @ turn.by_scale.reshape(3, 9)
            # What an angle too much has turned the force by, less than first order aside.
            change = change + _cross(added) @ (angle + 0.5 * turned)
            change[:, 12:] -= axes @ turn.by_bias
            angle, whole = angle + turned, whole + added
            axes = axes @ rotation_by(-excess) @ turn.rotation
            velocity[k], by_states[k] = whole, change
        return velocity, by_states


def _cross(vector: FloatArray) -> FloatArray:
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def processes(seconds: FloatArray) -> list[FloatArray]:
    """Return covariances of changes of velocity since the beginning, by the variance of the velocity."""
    at = np.append(0.0, seconds)
    apart = np.abs(np.subtract.outer(at, at))
    jerky = [np.exp(-apart / tau) for tau in CORRELATIONS_S]
    ranges = [math.sqrt(3.0) * apart / tau for tau in CORRELATIONS_S]
    smooth = [(1.0 + x) * np.exp(-x) for x in ranges]
    return [p[1:, 1:] - p[1:, :1] - p[:1, 1:] + 1.0 for p in jerky + smooth]


class Fit(NamedTuple):
    """Mean and covariance of the states, and how likely the window is, as a logarithm up to a constant."""

    mean: FloatArray
    covariance: FloatArray
    evidence: float


def _mixed(fits: list[Fit]) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of states that are one of these."""
    evidence = np.array([fit.evidence for fit in fits])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    mean = np.asarray(sum(p * fit.mean for p, fit in zip(share, fits, strict=True)))
    cover = np.zeros_like(fits[0].covariance)
    for p, fit in zip(share, fits, strict=True):
        cover += p * (fit.covariance + np.outer(fit.mean - mean, fit.mean - mean))
    return mean, cover


def _fitted(window: _Window, prior: FloatArray, covariance: FloatArray, process: FloatArray) -> Fit:
    """Return the states after a window, for a process of the velocity: as of `processes`."""
    t, n = window.seconds, len(window.seconds)
    first, last = np.minimum.outer(t, t), np.maximum.outer(t, t)
    walk = (ANGLE_WALK * STANDARD_GRAVITY) ** 2 * first**2 / 6.0 * (3.0 * last - first)
    known = np.linalg.inv(covariance)
    mean, speed2 = prior.copy(), 1.0
    cover = covariance
    design = np.zeros((n, 3, 3 + STATES))
    design[:, :, :3] = t[:, np.newaxis, np.newaxis] * np.eye(3)
    for _ in range(ITERATIONS):
        velocity, by_states = window.summed(mean[RATE])
        design[:, :, 3:] = -by_states
        measured = velocity - by_states[:, :, RATE] @ mean[RATE]
        for _ in range(ITERATIONS):
            weight = np.linalg.inv(speed2 * process + walk)
            weighed = np.einsum("ab,bij->aij", weight, design).reshape(3 * n, -1)
            normal = design.reshape(3 * n, -1).T @ weighed
            information = normal.copy()
            information[3:, 3:] += known
            right = weighed.T @ measured.reshape(-1)
            right[3:] += known @ prior
            found = np.linalg.solve(information, right)
            left = measured - design @ found
            free = 3.0 * n - float(np.trace(np.linalg.solve(information, normal)))
            speed2 = max(speed2 * float(np.einsum("ai,ab,bi->", left, weight, left)) / free, LEAST_SPEED2)
        mean, cover = found[3:], np.linalg.inv(information)[3:, 3:]
    spread = np.linalg.slogdet(speed2 * process + walk)[1]
    off = mean - prior
    misfit = float(np.einsum("ai,ab,bi->", left, weight, left)) + float(off @ known @ off)
    evidence = -0.5 * (3.0 * spread + float(np.linalg.slogdet(information)[1]) + misfit)
    return Fit(mean, cover, evidence)
