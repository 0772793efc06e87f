"""Slots at rest that contradict the bias: has it jumped, or does the unit move unnoticed?"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.slot import MOVED_DEGC, Reading

JUMP_PRIOR, JUMP_PRIOR_AFTER_GAP, JUMP_PRIOR_WARMED = 0.05, 0.5, 0.9
"""How likely it is, of a slot that contradicts the bias, that the bias is another: else the unit moves
unnoticed.  Behind a gap in the data nobody saw a movement begin; a temperature that has moved meanwhile is
the better explanation."""
UNNOTICED_S = 51.0
"""Mean length of a movement that nobody notices: with it a jump is certain after `PATIENCE_S`."""
CERTAIN = 0.95
"""Probability of a jump from which on the bias is estimated anew."""
SEEMING_TURN = 1.5e-4
"""rad/s, 31 °/h: so fast accelerometers that drift seem to turn: `accel_drift` of the rest room over g."""
RECENT = 8
"""Slots that say what the bias has become: few, for it may be running away with the temperature."""
PATIENCE_S = 300.0
"""2 ln(0.95 / 0.05) times `UNNOTICED_S`: so long it takes until a jump is believed, half behind a gap."""


@dataclass(slots=True, eq=False)
class Contrary:
    """Slots in a row that contradict the bias: it has jumped, or the unit moves unnoticed."""

    readings: list[Reading] = field(default_factory=list)
    """The last `RECENT` of them."""
    seconds: float = 0.0
    """Length of all."""
    behind_gap: bool = False
    """Whether nothing has agreed since a gap in the data."""
    since_degc: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """Temperature at the first of them, (3,)."""
    turned: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rotation since the first of them in this pose, if it is one, rad, (3,)."""
    turned_s: float = 0.0
    """In so long."""
    tilt: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What gravity had shown by then, rad, (3,)."""
    gravity: float = 0.0
    """Logarithm of how much likelier gravity is what it is if the unit does not turn."""

    def add(self, reading: Reading, off: FloatArray, up: FloatArray, tilt_noise: float) -> None:
        """Take a slot.

        Parameters
        ----------
        off : array (3,)
            Its rate less the bias, rad/s.
        up : array (3,)
            Zero without accelerometers, which show the rotation about what is level.
        tilt_noise : float
            rad sqrt(s).
        """
        if not self.readings:
            self.since_degc = reading.slot.degc
        if reading.fresh or not self.turned_s:
            # Nobody knows when in the first slot it began.
            self.turned, self.turned_s, self.tilt, self.gravity = np.zeros(3), 0.0, reading.tilt, 0.0
        dt = reading.slot.dt
        self.readings = [*self.readings, reading][-RECENT:]
        self.seconds += dt
        if self.seconds > dt and up.any():
            self.turned = self.turned + dt * (off - (off @ up) * up)
            self.turned_s += dt
            seen = reading.tilt - self.tilt
            unexplained = seen - self.turned
            variance = 2.0 * tilt_noise**2 / dt + (SEEMING_TURN * self.turned_s) ** 2
            self.gravity = float(unexplained @ unexplained - seen @ seen) / (2.0 * variance)

    @property
    def prior(self) -> float:
        """Probability that a slot which contradicts the bias has another."""
        if self.readings and (np.abs(self.readings[-1].slot.degc - self.since_degc) >= MOVED_DEGC).any():
            return JUMP_PRIOR_WARMED
        return JUMP_PRIOR_AFTER_GAP if self.behind_gap else JUMP_PRIOR

    @property
    def jump(self) -> float:
        """Probability that the bias has jumped: unnoticed movements last `UNNOTICED_S` in the mean."""
        if not self.readings:
            return 0.0
        prior = math.log(self.prior / (1.0 - self.prior))
        return 0.5 + 0.5 * math.tanh(0.5 * (prior + self.seconds / UNNOTICED_S + self.gravity))

    @property
    def has_jumped(self) -> bool:
        """Whether the bias is what these slots say, but for the first, which may have the old one yet."""
        return self.jump > CERTAIN and len(self.readings) > 2

    @property
    def rate(self) -> FloatArray:
        """Mean rate of the slots, rad/s, (3,), but for the first, which may have the old bias yet."""
        return np.asarray(np.mean([reading.rate for reading in self.readings[1:] or self.readings], 0))
