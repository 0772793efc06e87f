"""Which slots are rest and which are turns.

A turn is followed by the gyros, sample by sample (`imumon.filters.turns`), less what they read at rest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.position import SLOT_S, Slot
from imumon.filters.turns import STILL, Turn, angle_of
from imumon.geodesy import EARTH_RATE

MOTION_RATE, LIMIT_FACTOR = 1e-3, 5.0
"""A rate is motion that differs from the median at rest by more than 1 mrad/s (slower than any hand; less is
sway, noise or creep), and by more than 5 times the largest deviation of the last 30 s."""
SWAYING_RATE = 20e-3
"""rad/s: at the start, a rate that varies by less for 10 s is taken for rest."""
CALM_SLOTS, SWAYING_SLOTS, MEDIAN_SLOTS = 8, 40, 120
"""Slots: 2 s of calm are a rest, 10 s of sway at the start; the rate at rest is the median of 30 s."""
MOST_PENDING = 480
"""Slots: 2 minutes of a motion, or before the first rest, may turn out to be rest; what is older is lost."""
SAME_ATTITUDE, SHORT_PATH = 1e-3, 20e-3
"""rad: a turn by less (0.06°, the noise of 1 °/√h in 10 s) on a path of less leaves the attitude as it is."""


class Motion:
    """The motion detector."""

    def __init__(self) -> None:
        self.rest_rate: FloatArray | None = None
        """Median rate at rest, rad/s, (3,); None before the first rest."""
        self.limit = MOTION_RATE
        """Distance from it that is still rest, rad/s."""
        self.recent: deque[FloatArray] = deque(maxlen=MEDIAN_SLOTS)
        """Rates of slots at rest."""
        self.pending: deque[Slot] = deque(maxlen=MOST_PENDING)
        """Slots of the motion; before the first rest, those that may belong to it."""
        self.turn: Turn = STILL
        """Since the motion began."""
        self.begun_s = self.ended_s = 0.0
        """Of the motion, s since the first sample."""

    @property
    def moving(self) -> bool:
        """Whether the unit moves, or came to rest less than 2 s ago."""
        return self.rest_rate is not None and bool(self.pending)

    def step(self, slot: Slot, at_rest: bool, turn: Turn) -> tuple[list[Slot], bool]:
        """Return the slots at rest that are known with this slot and its turn, and whether a rest begins.

        There are none before the first rest and in motion.  After a motion that leaves the attitude as it was
        they are all of its slots; a rest that begins, the first one or after a turn, has those before it.
        """
        if self.rest_rate is None:
            self.pending.append(slot)
            return (list(self.pending), True) if at_rest and self._first_rest() else ([], False)
        in_motion = self._is_motion(slot)
        if not (self.pending or in_motion):
            return [slot], False
        if not self.pending:
            self.begun_s = slot.ended_s - SLOT_S
        if in_motion:
            self.ended_s = slot.ended_s
        self.pending.append(slot)
        self.turn = self.turn.then(turn.less(self.rest_rate))
        calm = list(self.pending)[-CALM_SLOTS:]
        if any(self._is_motion(one) for one in calm):
            return [], False
        turned = angle_of(self.turn.rotation) > SAME_ATTITUDE or self.turn.path > SHORT_PATH
        return calm if turned else list(self.pending), turned

    def _first_rest(self) -> bool:
        """Return whether the unit rests for the first time; if so, drop the slots before that rest."""
        rates = np.array([one.rate for one in self.pending])[-SWAYING_SLOTS:]
        calm = len(rates) >= CALM_SLOTS and np.ptp(rates[-CALM_SLOTS:], axis=0).max() < MOTION_RATE
        if not (calm or (len(rates) == SWAYING_SLOTS and np.ptp(rates, axis=0).max() < SWAYING_RATE)):
            return False
        self._update_rest_rate(rates[-CALM_SLOTS:] if calm else rates)
        while any(self._is_motion(one) for one in self.pending):
            self.pending.popleft()
        return True

    def _is_motion(self, slot: Slot) -> bool:
        assert self.rest_rate is not None
        return float(np.abs(slot.rate - self.rest_rate).max()) > self.limit

    def _update_rest_rate(self, rates: FloatArray) -> None:
        self.rest_rate = np.median(rates, axis=0)
        self.limit = max(MOTION_RATE, LIMIT_FACTOR * float(np.abs(rates - self.rest_rate).max()))

    def add_rest(self, rest: Sequence[Slot]) -> None:
        """Take slots at rest, with which a motion ends; update the median every 10 s."""
        for slot in rest:
            self.recent.append(slot.rate)
            if slot.number % SWAYING_SLOTS < slot.length:
                self._update_rest_rate(np.array(self.recent))
        self.pending.clear()
        self.turn = STILL

    def azimuth_variance(self, up: FloatArray, scale_sd: float) -> float:
        """Return the variance of the angle by which the unit has turned about the vertical, rad².

        `up` (3,) is the vertical in body axes at the beginning, `scale_sd` is of scale factor and
        misalignment.
        """
        # The earth rate turns against the body: up to all of it is wrong while it turns by a radian.
        drift = EARTH_RATE * (self.ended_s - self.begun_s) * min(self.turn.path, 1.0)
        by_scale = scale_sd**2 * float(np.sum(self.turn.scale_about(up) ** 2))
        return by_scale + self.turn.sampling_variance(up) + drift**2
