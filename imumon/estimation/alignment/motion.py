"""Disturbances of a unit that should stand still, slot by slot: knocks, steps on the floor, and turns.

A slot is disturbed when its mean leaves those of the last half minute by more than they scatter, or its
samples scatter far more.  So sway that has been there is no disturbance.  A turn is followed by the gyros,
sample by sample (`imumon.filters.turns`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.filters.turns import STILL, Turn

RECENT = 120
"""Slots of which the usual level and scatter are taken: half a minute holds two periods of slow sway."""
RENEWED = 0.25
"""They are taken anew after this share of these slots."""
LEAST = 8
"""Slots, 2 s, after which a unit is taken to rest, at the start and after a disturbance."""
PATIENT = 40
"""Slots, 10 s, after which it is taken to rest though it trembles more than before, as when people walk."""
LIMIT = 7.0
"""Standard deviations: less than once a year for Gaussian means of six channels in slots of 1/4 s."""
FINEST = np.array([2e-8, 2e-8, 2e-8, 2e-4, 2e-4, 2e-4])
"""The scatter of means is never taken for less, rad/s and m/s²: 20 µg, 0.004 °/h."""
TURNING = 1e-3
"""rad/s: a unit whose rate differs by more from that at rest is still being turned; a hand is not slower."""
REMAINS = 3.0
"""Standard deviations of the gyros' noise, above which a disturbance has left an angle."""
WANDERS = 2.0
"""An angle of as many times the farthest that it wanders at rest is no knock's: sway and steps vary so."""
NORMAL = 1.4826
"""Standard deviation of normal values over the median of their sizes."""


@dataclass(frozen=True, slots=True)
class Slot:
    """A slot: middle and length in s, samples, mean and variance (2, 6) of the channels, whether at rest, and
    how it turned."""

    time_s: float
    length_s: float
    samples: int
    values: FloatArray
    at_rest: bool
    turn: Turn = STILL

    @property
    def mean(self) -> FloatArray:
        """Mean of gyros and accelerometers, rad/s and m/s², (6,)."""
        mean: FloatArray = self.values[0]
        return mean


@dataclass(frozen=True, slots=True)
class Usual:
    """What slots at rest have been like.

    Parameters
    ----------
    middle, spread : array (6,)
        Median of their means, and by how much these scatter, rad/s and m/s².
    limit : array (2, 6)
        Of the distance from the middle, and of the variance within a slot.
    """

    middle: FloatArray
    spread: FloatArray
    limit: FloatArray

    def beyond(self, values: FloatArray, level: FloatArray) -> BoolArray:
        """Return what of slots, (..., 2, 6), is not as usual, for their levels, (..., 3)."""
        off = values.copy()
        off[..., 0, :3] -= self.middle[:3]
        off[..., 0, 3:] -= level  # an accelerometer may warm up
        return np.asarray(np.abs(off) > self.limit)


def usual_of(recent: FloatArray) -> Usual:
    """Return what slots, (m, 2, 6), were like."""
    values = recent.copy()
    values[:, 1] = np.sqrt(values[:, 1])
    middle = np.median(values, axis=0)
    spread = NORMAL * np.median(np.abs(values - middle), axis=0) + FINEST
    reach = LIMIT + 3.0 * LIMIT / math.sqrt(len(values))
    limit = reach * spread
    limit[1] = (middle[1] + limit[1]) ** 2
    return Usual(middle[0], spread[0], limit)


@dataclass
class Motion:
    """What is known of the unit's rest.

    Parameters
    ----------
    recent : array (m, 2, 6)
        Means and variances of the last undisturbed slots.
    passed : list of Slot
        Those of the disturbance.
    calm : int
        How many of the last of them may be a new rest.
    still : int
        How many of the last of them were as usual.
    base : array (3,)
        Rate at the last rest, rad/s.
    level : array (3,)
        Mean specific force of the last slots at rest, m/s².
    turned : Turn
        Since the disturbance began, less the rate at the last rest.
    """

    recent: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 6)))
    passed: list[Slot] = field(default_factory=list)
    calm: int = 0
    still: int = 0
    base: FloatArray | None = None
    level: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    turned: Turn = STILL
    known: Usual | None = None
    age: int = 0
    """Slots since the usual was taken."""
    disturbed: bool = True
    cause: str = ""
    begun_s: float = math.nan

    def judge(self, slot: Slot) -> str:
        """Return what disturbs the slot, or nothing."""
        if len(self.recent) < LEAST:
            return ""
        beyond = self.usual().beyond(slot.values, self.level)
        if not beyond.any():
            return ""
        if beyond[0, :3].any():
            return "the unit turned"
        if beyond[0, 3:].any():
            return "the specific force jumped"
        return "a shock or vibration" if slot.samples >= LEAST else ""

    def rest_on(self, values: FloatArray) -> FloatArray:
        """Go on by slots at rest, (m, 2, 6), until one is not as usual or what is usual must be taken anew.

        Returns
        -------
        array, (n, 3)
            The level after each slot taken, m/s².
        """
        if self.disturbed or len(self.recent) < LEAST:
            return np.zeros((0, 3))
        if self.known is None:
            self.usual()
        values = values[: int(RENEWED * len(self.recent)) + 1 - self.age]
        levels = mean_level(np.concatenate((self.recent[-LEAST:], values)))
        beyond = self.usual().beyond(values, levels[:-1]).any((1, 2))
        taken = int(beyond.argmax()) if beyond.any() else len(values)
        if taken:
            self._go_on(values[:taken])
        return levels[1 : taken + 1]

    def usual(self) -> Usual:
        """Return what recent slots were like."""
        if self.known is None:
            self.known = usual_of(self.recent)
            self.age = 0
        return self.known

    def wander(self) -> FloatArray:
        """Return by how much the mean level of LEAST slots scatters at rest, m/s², (3,)."""
        levels = mean_level(self.recent)
        spread: FloatArray = NORMAL * np.median(np.abs(levels - np.median(levels, axis=0)), axis=0)
        return np.maximum(spread, self.usual().spread[3:] / math.sqrt(LEAST))

    def go_on(self, slot: Slot) -> None:
        """Add an undisturbed slot."""
        self._go_on(slot.values[None])

    def _go_on(self, values: FloatArray) -> None:
        """Add undisturbed slots, (m, 2, 6), of which all but the last leave the usual as it is."""
        before = min(len(self.recent) + len(values) - 1, RECENT)
        self.age += len(values)
        if self.age > RENEWED * before:
            self.known = None
        self._remember(
            np.concatenate((self.recent[max(len(self.recent) + len(values) - RECENT, 0) :], values))
        )

    def _remember(self, recent: FloatArray) -> None:
        self.recent = recent
        self.level = mean_level(recent[-LEAST:])[-1]

    def begin(self, slot: Slot, cause: str) -> None:
        """Begin a disturbance."""
        self.base = np.median(self.recent[:, 0, :3], axis=0) if len(self.recent) else None
        self.disturbed, self.cause, self.begun_s = True, cause, slot.time_s - 0.5 * slot.length_s
        self.turned = STILL
        self.passed, self.calm, self.still = [], 0, 0

    def follow(self, slot: Slot) -> FloatArray:
        """Follow the unit through a disturbed slot; return its rotation, (3, 3)."""
        self.passed.append(slot)
        if self.base is None:
            moves = len(self.passed) > 1 and np.abs(slot.mean - self.passed[-2].mean)[:3].max() > TURNING
            self.calm = 0 if moves else self.calm + 1
            return STILL.rotation
        turn = slot.turn.less(self.base)
        self.turned = self.turned.then(turn)
        rate = slot.mean[:3] - self.base
        self.calm = 0 if np.abs(rate).max() > TURNING else self.calm + 1
        trembles = bool((np.abs(rate) > self.usual().limit[0, :3]).any())
        self.still = 0 if trembles else self.still + 1
        return turn.rotation

    @property
    def rested(self) -> bool:
        """Whether the calm has lasted."""
        if self.calm < LEAST:
            return False
        if self.base is None and not self.passed[-1].at_rest:
            return False
        if self.base is None and self.calm < PATIENT and len(self.passed) - self.begins() < LEAST:
            return False
        if self.base is not None and self.still < LEAST and self.calm < PATIENT:
            return False
        return float(np.std([slot.mean[:3] for slot in self.passed[-LEAST:]], axis=0).max()) < TURNING

    def begins(self) -> int:
        """Return the first slot passed from which on all are as the last ones: what was before is no rest."""
        values = np.array([slot.values for slot in self.passed])
        beyond = usual_of(values[-LEAST:]).beyond(values, values[-LEAST:, 0, 3:].mean(axis=0)).any((1, 2))
        return min(int(np.flatnonzero(np.r_[True, beyond])[-1]), len(values) - LEAST)

    @property
    def seconds(self) -> float:
        """Length of the disturbance, with the calm after it."""
        return self.passed[-1].time_s + 0.5 * self.passed[-1].length_s - self.begun_s

    @property
    def returned(self) -> bool:
        """Whether the gyros saw no angle remain: then all of it may count, and nothing is lost."""
        seconds, known = self.seconds, max(len(self.recent), 1)
        length_s = self.passed[-1].length_s
        # How far the angle wanders in such a time at rest, where the unit sways more than its noise says.
        slots = min(len(self.passed), known // 2)
        angle = length_s * np.cumsum(self.recent[:, 0, :3] - self.recent[:, 0, :3].mean(0), axis=0)
        farthest = np.abs(angle[slots:] - angle[: known - slots]).max(axis=0)
        # Of a longer time than was seen at rest, nothing is known but that.
        farthest *= len(self.passed) / max(slots, 1)
        # Their noise over that time, and that of the rate at rest, a median.
        noise = math.sqrt(length_s * seconds + math.pi / 2.0 * seconds**2 / known) * self.usual().spread[:3]
        turn = self.turned.rotation - self.turned.rotation.T
        remains = 0.5 * np.abs([turn[2, 1], turn[0, 2], turn[1, 0]])
        return bool((remains < np.maximum(REMAINS * noise, WANDERS * farthest)).all())

    def rest(self, same: bool) -> None:
        """End the disturbance; the unit stands as before, or in a new pose."""
        recent = np.array([slot.values for slot in self.passed[-self.calm :]])
        if same and len(self.recent) >= LEAST:
            recent = np.concatenate([self.recent, recent])
        self._remember(recent[-RECENT:])
        self.known = None
        self.disturbed, self.passed, self.calm = False, [], 0


def mean_level(values: FloatArray) -> FloatArray:
    """Return the mean specific force of each LEAST slots in a row, (n, 3); of all where there are fewer."""
    force = values[:, 0, 3:]
    together = min(len(force), LEAST)
    total = np.zeros((len(force) - together + 1, 3))
    for k in range(together):  # in this order, however many at once
        total += force[k : k + len(total)]
    return total / together
