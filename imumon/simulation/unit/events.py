"""What a scenario says of motion: turns, shakes and rests of the unit, each with its time."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from imumon.config import StrictModel
from imumon.simulation.unit.parameters import NONE, Three


class _Timed(StrictModel):
    at_s: float = Field(ge=0.0)


class _Lasting(_Timed):
    duration_s: float = Field(gt=0.0)


class Turn(_Lasting):
    """A guided turn: the attitude changes by these angles, smoothly (minimum jerk), and stays there."""

    kind: Literal["turn"]
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    heading_deg: float = 0.0


class Rotation(_Lasting):
    """A turn at constant rates of roll, pitch and heading, from one moment to the next."""

    kind: Literal["rotation"]
    roll_deg_per_s: float = 0.0
    pitch_deg_per_s: float = 0.0
    heading_deg_per_s: float = 0.0


class Bump(_Timed):
    """A knock against the table: it rings at a frequency and dies away."""

    kind: Literal["bump"]
    frequency_hz: float = Field(gt=0.0)
    decay_s: float = Field(gt=0.0)
    acceleration_m_per_s2: Three = NONE
    """First amplitude north, east, down."""
    tilt_deg: Three = NONE
    """First amplitude of roll, pitch, heading."""


class Vibration(_Lasting):
    """A fan: a steady sine of acceleration (north, east, down) and of angle (roll, pitch, heading)."""

    kind: Literal["vibration"]
    frequency_hz: float = Field(gt=0.0)
    acceleration_m_per_s2: Three = NONE
    tilt_deg: Three = NONE


class Handling(_Timed):
    """Rounds of rest and motion: each begins with a rest, then the unit is swung and carried about.

    Parameters
    ----------
    at_s, rounds, every_s, rest_s : float
        First round, number of rounds, length of a round, and of the rest at its beginning.
    swing_deg, swing_period_s : three numbers, float
        Amplitudes of roll, pitch, heading, and about how long one swing lasts.
    travel_m : three numbers
        Amplitudes of the way north, east, down.
    heading_deg : float
        Change of heading from one rest to the next.
    """

    kind: Literal["handling"]
    rounds: int = Field(ge=1)
    every_s: float = Field(gt=0.0)
    rest_s: float = Field(gt=0.0)
    swing_deg: Three = NONE
    swing_period_s: float = Field(default=4.0, gt=0.0)
    travel_m: Three = NONE
    heading_deg: float = 0.0

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.rest_s >= self.every_s:
            raise ValueError(f"rest_s {self.rest_s:g} leaves no time for motion in every_s {self.every_s:g}")
        return self


Event = Annotated[Turn | Rotation | Bump | Vibration | Handling, Field(discriminator="kind")]
