"""What a lane of states shows: a text, and how good that is."""

from enum import Enum
from typing import NamedTuple


class Level(Enum):
    """How good a state is: the view colours it by that."""

    GOOD = "good"
    WAIT = "wait"
    """Not yet, or worth a look."""
    BAD = "bad"
    PLAIN = "plain"
    """Neither."""


class LaneState(NamedTuple):
    """The state of a lane."""

    text: str
    level: Level = Level.PLAIN
