"""Motion of a scenario: turns, shakes and rests of the unit, as closed functions of time.

So any part of a run can be computed by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from imumon.blocks import BoolArray, ColumnArray, FloatArray
from imumon.config import StrictModel

from .parameters import NONE, NotNegative, Positive, Three

EDGE_S = 2.0
"""How long it takes to get into motion and out of it, where a round of handling has room for that."""
RINGING = 12.0
"""A bump is over after this many of its time constants (6e-6 of its amplitude)."""
_RATIOS = np.array([1.0, 1.27, 0.81])
"""Periods of the three swings to each other, so that they do not repeat together."""


@dataclass
class Movement:
    """Motion at n times."""

    angles: FloatArray
    rates: FloatArray  # roll, pitch, heading in rad, and their derivatives in rad/s, (n, 3)
    acceleration: FloatArray  # north, east, down, in m/s², (n, 3)
    moving: BoolArray  # False at rest, (n,); a fan shakes a unit that is at rest


class _Timed(StrictModel):
    """An event; `_add` adds what it does by the time since its begin, negative before it."""

    at_s: NotNegative


class _Lasting(_Timed):
    duration_s: Positive


class Attitude(StrictModel):
    """How the unit's forward-right-down axes stand to north-east-down (ZYX); for FLU y and z are turned."""

    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    heading_deg: float = 0.0

    @property
    def angles(self) -> FloatArray:
        """Roll, pitch, heading in rad, (3,)."""
        return np.deg2rad([self.roll_deg, self.pitch_deg, self.heading_deg])


class Turn(_Lasting, Attitude):
    """A guided turn: the attitude changes by these angles, smoothly (minimum jerk), and stays there."""

    kind: Literal["turn"]

    def _add(self, since_s: FloatArray, total: Movement) -> None:
        way, speed, _ = _minimum_jerk(since_s, self.duration_s)
        total.angles += np.outer(way, self.angles)
        total.rates += np.outer(speed, self.angles)
        total.moving |= _within(since_s, self.duration_s)


class Rotation(_Lasting):
    """A turn at constant rates of roll, pitch and heading, from one moment to the next."""

    kind: Literal["rotation"]
    roll_deg_per_s: float = 0.0
    pitch_deg_per_s: float = 0.0
    heading_deg_per_s: float = 0.0

    def _add(self, since_s: FloatArray, total: Movement) -> None:
        rates = np.deg2rad([self.roll_deg_per_s, self.pitch_deg_per_s, self.heading_deg_per_s])
        turning = _within(since_s, self.duration_s)
        total.angles += np.outer(np.clip(since_s, 0.0, self.duration_s), rates)
        total.rates += np.outer(turning, rates)
        total.moving |= turning


class _Shaking(_Timed):
    frequency_hz: Positive
    acceleration_m_per_s2: Three = NONE  # amplitude north, east, down
    tilt_deg: Three = NONE  # amplitude of roll, pitch, heading

    def _shake(self, sine: ColumnArray, slope: ColumnArray, total: Movement) -> None:
        """Add an oscillation of amplitude 1 and its derivative (1/s), both of shape (n,)."""
        tilt = np.deg2rad(self.tilt_deg)
        total.acceleration += np.outer(sine, self.acceleration_m_per_s2)
        total.angles += np.outer(sine, tilt)
        total.rates += np.outer(slope, tilt)


class Bump(_Shaking):
    """A knock against the table: it rings at a frequency, first with its amplitude, and dies away."""

    kind: Literal["bump"]
    decay_s: Positive

    def _add(self, since_s: FloatArray, total: Movement) -> None:
        ringing = _within(since_s, RINGING * self.decay_s)
        since = np.where(ringing, since_s, 0.0)
        fading = ringing * np.exp(-since / self.decay_s)
        omega = 2 * np.pi * self.frequency_hz
        sine = fading * np.sin(omega * since)
        self._shake(sine, fading * omega * np.cos(omega * since) - sine / self.decay_s, total)
        total.moving |= ringing


class Vibration(_Shaking, _Lasting):
    """A fan: a steady sine of acceleration (north, east, down) and of angle (roll, pitch, heading)."""

    kind: Literal["vibration"]

    def _add(self, since_s: FloatArray, total: Movement) -> None:
        running = _within(since_s, self.duration_s)
        omega = 2 * np.pi * self.frequency_hz
        cosine = running * np.cos(omega * since_s)
        self._shake(running * np.sin(omega * since_s), omega * cosine, total)


class Handling(_Timed):
    """Rounds of rest and motion: each begins with a rest, then the unit is swung and carried about.

    `at_s`, `rounds`, `every_s`, `rest_s`: first round, their number, length of a round and of its rest.
    `swing_deg`, `swing_period_s`: amplitudes of roll, pitch, heading, and about how long one swing lasts.
    `travel_m`: amplitudes of the way north, east, down.
    `heading_deg`: change of heading from one rest to the next.
    """

    kind: Literal["handling"]
    rounds: int = Field(ge=1)
    every_s: Positive
    rest_s: Positive
    swing_deg: Three = NONE
    swing_period_s: Positive = 4.0
    travel_m: Three = NONE
    heading_deg: float = 0.0

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.rest_s >= self.every_s:
            raise ValueError(f"rest_s {self.rest_s:g} leaves no time for motion in every_s {self.every_s:g}")
        return self

    def _add(self, since_s: FloatArray, total: Movement) -> None:
        number = np.clip(np.floor(since_s / self.every_s), -1, self.rounds)
        under_way = (number >= 0) & (number < self.rounds)
        length = self.every_s - self.rest_s
        s = np.where(under_way, since_s - number * self.every_s - self.rest_s, -1.0)
        way, speed, _ = _minimum_jerk(s, length)
        heading = np.deg2rad(self.heading_deg)
        total.angles[:, 2] += heading * (np.maximum(number, 0.0) + way)
        total.rates[:, 2] += heading * speed
        envelope = _window(s, length)
        for axis in range(3):
            period = self.swing_period_s * _RATIOS[axis]
            swing = _swing(s, period, number + axis, envelope)
            total.angles[:, axis] += np.deg2rad(self.swing_deg[axis]) * swing[0]
            total.rates[:, axis] += np.deg2rad(self.swing_deg[axis]) * swing[1]
            travel = _swing(s, 0.7 * period, 2.0 * number - axis, envelope)
            total.acceleration[:, axis] += self.travel_m[axis] * travel[2]
        total.moving |= _within(s, length)


Event = Annotated[Turn | Rotation | Bump | Vibration | Handling, Field(discriminator="kind")]


def movement(events: Sequence[Event], start_rad: FloatArray, time_s: FloatArray) -> Movement:
    """Return the motion at each time (s since power-on), (n,), from a first attitude of shape (3,)."""
    n = len(time_s)
    total = Movement(np.tile(start_rad, (n, 1)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, bool))
    for event in events:
        if event.at_s <= time_s[-1]:
            event._add(time_s - event.at_s, total)
    return total


def _within(since_s: FloatArray, length_s: float) -> BoolArray:
    return (since_s >= 0.0) & (since_s < length_s)


def _minimum_jerk(since_s: FloatArray, length_s: float) -> FloatArray:
    """Return the way from 0 to 1 in this time, its speed and acceleration, 0 at both ends, (3, n)."""
    s = np.clip(since_s / length_s, 0.0, 1.0)
    way, speed = s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / length_s
    return np.array([way, speed, 60 * s * (1 - s) * (1 - 2 * s) / length_s**2])


def _window(since_s: FloatArray, length_s: float) -> FloatArray:
    """Return 0 outside 0..length_s, 1 inside, with smooth edges, and its two derivatives, (3, n)."""
    edge = min(EDGE_S, length_s / 2)
    return _minimum_jerk(since_s, edge) - _minimum_jerk(since_s - (length_s - edge), edge)


def _swing(since_s: FloatArray, period_s: float, phase: FloatArray, envelope: FloatArray) -> FloatArray:
    """Return an oscillation inside an envelope, and its two derivatives, (3, n)."""
    omega = 2 * np.pi / period_s
    sine, cosine = np.sin(omega * since_s + phase), np.cos(omega * since_s + phase)
    e, e1, e2 = envelope
    bend = e2 * sine + 2 * e1 * omega * cosine - e * omega**2 * sine
    return np.array([e * sine, e1 * sine + e * omega * cosine, bend])
