"""Bias of a unit that has never been at rest: gravity turns, by the gyros, with a bias that is not known.

Once a minute twelve integrals of the specific force f, m/s², in axes that gyros carry along (C rotates into
them), are fitted (Gauss and Newton) by the specific force at rest g, upwards, m/s², and the bias, rad/s::

    ∫ C f dt = ∫ (g - [g x] ∫ C bias dt) dt + N(0, s²),    over a part of 5 s

Changes of speed are the noise, and the fit shows their variance s², (m/s)²; errors of scale, and biases of
the accelerometers, are smaller.  The rate about the vertical is not estimated: only sways make that rate
observable.  So an upright axis is unknown, even if it was known while level.
"""

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.slots import SLOT_S
from imumon.filters.turns import STILL, Turn, rotation_by
from imumon.geodesy import DEG_PER_H

from .bank import TURN_ON

PART_S, PARTS = 5.0, 12  # a window is a minute: a bias of a degree per second turns it by a radian
WINDOW_S = PARTS * PART_S
ALIKE = 6.0  # factor of the variance: accelerations of successive parts are alike.  Assumed.
LEAST_VARIANCE = 1e-4  # of the change of speed in a part, (m/s)²: 0.2 mg in 5 s.  Assumed.
BIAS_WALK = 30.0 * DEG_PER_H  # rad/s/√s: a walk of 230 °/h a minute, as 100 °/h/°C at 2 °C/min makes it


class Motion:
    """Bias and its covariance, rad/s, from window to window."""

    def __init__(self) -> None:
        self.mean, self.covariance = np.zeros(3), TURN_ON**2 * np.eye(3)
        # Of the present window, the last one growing: turn, and ∫ C f dt in the axes of its beginning, m/s.
        self.parts: list[tuple[Turn, FloatArray]] = []

    def interrupt(self, seconds: float) -> None:
        """Begin the window anew: it rested, or readings are missing.  The bias has walked meanwhile."""
        self.covariance += BIAS_WALK**2 * (seconds + sum(turn.seconds for turn, _ in self.parts)) * np.eye(3)
        self.parts = []

    def take(self, turn: Turn, force: FloatArray) -> None:
        """Take a slot in motion, in whose axes the specific force is taken as constant, m/s², (3,)."""
        full_s = PART_S - 0.5 * SLOT_S
        if not self.parts or self.parts[-1][0].seconds >= full_s:
            self.parts.append((STILL, np.zeros(3)))
        whole, velocity = self.parts[-1]  # and `by_bias` is ∫ C dt of the slot
        self.parts[-1] = whole.then(turn), velocity + whole.rotation @ (turn.by_bias @ force)
        if len(self.parts) == PARTS and self.parts[-1][0].seconds >= full_s:
            self._fit()
            self.parts = []

    def _fit(self) -> None:
        seconds = sum(turn.seconds for turn, _ in self.parts)
        # Up in body axes, on the average over the window: each part in the axes of its end.
        velocity = sum((turn.rotation.T @ v for turn, v in self.parts), np.zeros(3))
        vertical = velocity / np.linalg.norm(velocity)
        prior = np.zeros((6, 6))  # information on gravity, of which there is none, and bias
        prior[3:, 3:] = np.linalg.inv(self.covariance + BIAS_WALK**2 * seconds * np.eye(3))
        bias, variance = self.mean, 1.0  # where the fit is linear, rad/s; of a part, (m/s)²
        for _ in range(10):  # as the start, assumed
            measured, design = self._linear(bias)
            normal = design.T @ design / variance
            right = design.T @ measured / variance + prior[:, 3:] @ self.mean
            covariance = np.asarray(np.linalg.inv(normal + prior))
            found = covariance @ right
            left = measured - design @ found
            free = len(left) - np.trace(covariance @ normal)
            variance = ALIKE * max(float(left @ left) / free, LEAST_VARIANCE)
            bias = found[3:]
        self.mean, self.covariance = bias - (vertical @ bias) * vertical, covariance[3:, 3:]
        # About the vertical nothing is learned: the variance stays that of a turn-on bias.
        lacking = TURN_ON**2 - vertical @ self.covariance @ vertical
        self.covariance += max(lacking, 0.0) * np.outer(vertical, vertical)

    def _linear(self, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return measured and design near the bias `at`, rad/s: measured = design @ (g, bias).

        Carried along by the gyros less `at`, the axes turn too far by J (bias - at), J = ∫ C dt up to the
        middle of a part.  So it has v = ∫ C f dt = g T + J (bias - at) x v, or v + B at = g T + B bias.
        """
        axes, up_to = np.eye(3), np.zeros((3, 3))  # and ∫ C dt up to the part, s
        measured, design = [], []
        for turn, velocity in self.parts:
            angle = turn.by_bias @ at
            within = axes @ turn.by_bias  # ∫ C dt of the part
            v = axes @ rotation_by(-0.5 * angle) @ velocity
            b = np.cross(up_to + 0.5 * within, v[:, None], axis=0)
            measured.append(v + b @ at)
            design.append(np.hstack([turn.seconds * np.eye(3), b]))
            up_to = up_to + within
            axes = axes @ rotation_by(-angle) @ turn.rotation
        return np.concatenate(measured), np.concatenate(design)

    @property
    def bias(self) -> tuple[FloatArray, FloatArray]:
        """Return bias and variance until the next window ends, (3,) each; NaN where little is known."""
        variance = np.diag(self.covariance) + BIAS_WALK**2 * WINDOW_S
        # A bias that turns a window by half a turn may be a wrong minimum of the fit.
        known = variance < (0.5 * TURN_ON) ** 2  # half the sd of a turn-on bias.  Assumed.
        known &= float(np.linalg.norm(self.mean)) * WINDOW_S < np.pi
        return np.where(known, self.mean, np.nan), np.where(known, variance, np.nan)
