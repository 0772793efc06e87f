"""Motion as closed functions of time, so that any part of a run can be computed by itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np

from imumon.blocks import FloatArray
from imumon.simulation.unit.events import Bump, Event, Handling, Rotation, Turn, Vibration

EDGE_S = 2.0
"""How long it takes to get into motion and out of it, where a round of handling has room for that."""
RINGING = 12.0
"""A bump is over after this many of its time constants (6e-6 of its amplitude)."""
_RATIOS = np.array([1.0, 1.27, 0.81])
"""Periods of the three swings to each other, so that they do not repeat together."""


@dataclass(slots=True)
class Movement:
    """Motion at n times."""

    angles: FloatArray
    rates: FloatArray
    """Roll, pitch, heading in rad, and their derivatives in rad/s, (n, 3)."""
    acceleration: FloatArray
    """North, east, down, in m/s², (n, 3)."""
    moving: np.ndarray[tuple[int], np.dtype[np.bool_]]
    """False at rest, (n,); a fan shakes a unit that is at rest."""


def movement(events: Sequence[Event], start_rad: FloatArray, time_s: FloatArray) -> Movement:
    """Return the motion at each time (s since power-on), (n,), from a first attitude of shape (3,)."""
    n = len(time_s)
    total = Movement(np.tile(start_rad, (n, 1)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, bool))
    for event in events:
        if event.at_s <= time_s[-1]:
            _add(event, time_s - event.at_s, total)
    return total


def is_static(events: Sequence[Event], first_s: float, last_s: float) -> bool:
    """Return whether no event is under way between two times."""
    return all(event.at_s > last_s or event.at_s + _length_s(event) < first_s for event in events)


def _length_s(event: Event) -> float:
    if isinstance(event, Bump):
        return RINGING * event.decay_s
    return event.rounds * event.every_s if isinstance(event, Handling) else event.duration_s


@singledispatch
def _add(event: Event, since_s: FloatArray, total: Movement) -> None:  # noqa: ARG001 - of all that follow
    """Add what an event does, by the time since its begin; negative times are before it."""
    raise TypeError(f"no motion for {event!r}")


@_add.register
def _(event: Turn, since_s: FloatArray, total: Movement) -> None:
    angles = np.deg2rad([event.roll_deg, event.pitch_deg, event.heading_deg])
    way, speed, _ = _minimum_jerk(since_s, event.duration_s)
    total.angles += np.outer(way, angles)
    total.rates += np.outer(speed, angles)
    total.moving |= _within(since_s, event.duration_s)


@_add.register
def _(event: Rotation, since_s: FloatArray, total: Movement) -> None:
    rates = np.deg2rad([event.roll_deg_per_s, event.pitch_deg_per_s, event.heading_deg_per_s])
    turning = _within(since_s, event.duration_s)
    total.angles += np.outer(np.clip(since_s, 0.0, event.duration_s), rates)
    total.rates += np.outer(turning, rates)
    total.moving |= turning


@_add.register
def _(event: Bump, since_s: FloatArray, total: Movement) -> None:
    ringing = _within(since_s, RINGING * event.decay_s)
    since = np.where(ringing, since_s, 0.0)
    fading = ringing * np.exp(-since / event.decay_s)
    omega = 2 * np.pi * event.frequency_hz
    sine = fading * np.sin(omega * since)
    total.acceleration += np.outer(sine, event.acceleration_m_per_s2)
    total.angles += np.outer(sine, np.deg2rad(event.tilt_deg))
    total.rates += np.outer(
        fading * omega * np.cos(omega * since) - sine / event.decay_s, np.deg2rad(event.tilt_deg)
    )
    total.moving |= ringing


@_add.register
def _(event: Vibration, since_s: FloatArray, total: Movement) -> None:
    running = _within(since_s, event.duration_s)
    omega = 2 * np.pi * event.frequency_hz
    sine, cosine = running * np.sin(omega * since_s), running * np.cos(omega * since_s)
    total.acceleration += np.outer(sine, event.acceleration_m_per_s2)
    total.angles += np.outer(sine, np.deg2rad(event.tilt_deg))
    total.rates += np.outer(omega * cosine, np.deg2rad(event.tilt_deg))


@_add.register
def _(event: Handling, since_s: FloatArray, total: Movement) -> None:
    number = np.clip(np.floor(since_s / event.every_s), -1, event.rounds)
    length = event.every_s - event.rest_s
    s = np.where(
        (number >= 0) & (number < event.rounds), since_s - number * event.every_s - event.rest_s, -1.0
    )
    way, speed, _ = _minimum_jerk(s, length)
    heading = np.deg2rad(event.heading_deg)
    total.angles[:, 2] += heading * (np.maximum(number, 0.0) + way)
    total.rates[:, 2] += heading * speed
    envelope = _window(s, length)
    for axis in range(3):
        period = event.swing_period_s * _RATIOS[axis]
        swing = _swing(s, period, number + axis, envelope)
        total.angles[:, axis] += np.deg2rad(event.swing_deg[axis]) * swing[0]
        total.rates[:, axis] += np.deg2rad(event.swing_deg[axis]) * swing[1]
        travel = _swing(s, 0.7 * period, 2.0 * number - axis, envelope)
        total.acceleration[:, axis] += event.travel_m[axis] * travel[2]
    total.moving |= _within(s, length)


Triple = tuple[FloatArray, FloatArray, FloatArray]
"""A function of time and its first two derivatives."""


def _within(since_s: FloatArray, length_s: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    return np.asarray((since_s >= 0.0) & (since_s < length_s))


def _minimum_jerk(since_s: FloatArray, length_s: float) -> Triple:
    """Return the way from 0 to 1 in this time, with speed and acceleration 0 at both ends."""
    s = np.clip(since_s / length_s, 0.0, 1.0)
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2 / length_s,
        60 * s * (1 - s) * (1 - 2 * s) / length_s**2,
    )


def _window(since_s: FloatArray, length_s: float) -> Triple:
    """Return 0 outside 0..length_s, 1 inside, with smooth edges."""
    edge = min(EDGE_S, length_s / 2)
    up, down = _minimum_jerk(since_s, edge), _minimum_jerk(since_s - (length_s - edge), edge)
    return up[0] - down[0], up[1] - down[1], up[2] - down[2]


def _swing(since_s: FloatArray, period_s: float, phase: FloatArray, envelope: Triple) -> Triple:
    """Return an oscillation inside an envelope."""
    omega = 2 * np.pi / period_s
    sine, cosine = np.sin(omega * since_s + phase), np.cos(omega * since_s + phase)
    e, e1, e2 = envelope
    return (
        e * sine,
        e1 * sine + e * omega * cosine,
        e2 * sine + 2 * e1 * omega * cosine - e * omega**2 * sine,
    )
