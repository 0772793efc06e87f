from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter

from imumon.blocks import FloatArray
from imumon.simulation.unit.motion import Event, movement

EVENT: TypeAdapter[Event] = TypeAdapter(Event)
ALL = {
    "turn": {"kind": "turn", "at_s": 2, "duration_s": 3, "roll_deg": 10, "pitch_deg": -20, "heading_deg": 90},
    "rotation": {"kind": "rotation", "at_s": 2, "duration_s": 5, "pitch_deg_per_s": 1, "roll_deg_per_s": -2},
    "bump": {
        "kind": "bump", "at_s": 3, "frequency_hz": 12, "decay_s": 0.15,
        "acceleration_m_per_s2": [0, 1, 2], "tilt_deg": [0.1, 0.2, 0],
    },
    "vibration": {
        "kind": "vibration", "at_s": 1, "duration_s": 4, "frequency_hz": 23.7,
        "acceleration_m_per_s2": 0.2, "tilt_deg": 0.01,
    },
    "handling": {
        "kind": "handling", "at_s": 1, "rounds": 3, "every_s": 12, "rest_s": 3,
        "swing_deg": [20, 10, 30], "travel_m": [0.2, 0.1, 0.05], "heading_deg": 30,
    },
}  # fmt: skip
START = np.deg2rad([1.0, 2.0, 40.0])


def event(name: str) -> Event:
    return EVENT.validate_python(ALL[name])


def times(rate_hz: float = 2000.0) -> FloatArray:
    return np.asarray(np.arange(0, 45, 1 / rate_hz))


@pytest.mark.parametrize("name", list(ALL))
def test_rates_are_the_derivatives_of_the_angles(name: str) -> None:
    """Except where a bump, a rotation or a fan begins or ends at once."""
    t = times()
    motion = movement([event(name)], START, t)
    numeric = np.gradient(motion.angles, t, axis=0)
    wrong = np.any(np.abs(numeric - motion.rates) > 2e-4 + 0.005 * np.abs(motion.rates).max(), axis=1)
    assert np.count_nonzero(wrong) <= (6 if name in ("bump", "rotation", "vibration") else 0)
    assert np.abs(motion.rates).max() > 1e-3


@pytest.mark.parametrize("name", list(ALL))
def test_where_the_unit_is_at_rest_nothing_moves(name: str) -> None:
    motion = movement([event(name)], START, times())
    if name == "vibration":  # a fan shakes a unit that stands where it stood
        assert not motion.moving.any()
        return
    assert motion.moving.any()
    assert not motion.moving.all()
    still = ~motion.moving
    assert np.abs(motion.rates[still]).max() < 1e-12
    assert np.abs(motion.acceleration[still]).max() < 1e-12


def test_handling_ends_each_round_at_rest_and_where_it_began_but_for_the_heading() -> None:
    t = times()
    motion = movement([event("handling")], START, t)
    velocity = np.cumsum(motion.acceleration, axis=0) * (t[1] - t[0])
    position = np.cumsum(velocity, axis=0) * (t[1] - t[0])
    assert np.abs(velocity).max() > 0.1
    for number in range(3):
        rest = (t > 1 + 12 * number + 0.01) & (t < 1 + 12 * number + 2.99)
        assert np.abs(velocity[rest]).max() < 1e-3
        assert np.abs(position[rest]).max() < 2e-3
        np.testing.assert_allclose(np.rad2deg(motion.angles[rest][0]), [1, 2, 40 + 30 * number], atol=1e-9)
    np.testing.assert_allclose(np.rad2deg(motion.angles[-1]), [1, 2, 40 + 90], atol=1e-9)


def test_events_add_up() -> None:
    t = times(200.0)
    parts = [movement([event(name)], np.zeros(3), t) for name in ALL]
    whole = movement([event(name) for name in ALL], np.zeros(3), t)
    np.testing.assert_allclose(whole.angles, sum(part.angles for part in parts), atol=1e-12)
    np.testing.assert_allclose(whole.acceleration, sum(part.acceleration for part in parts), atol=1e-12)
