"""States of lanes in tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from imumon.lane import LaneState


class _Judging(Protocol):
    def lanes(self) -> Mapping[str, LaneState]:
        """Return the state of each of its lanes."""


def texts(stage: _Judging) -> dict[str, str]:
    """Return the states of the lanes of a stage, without how good they are."""
    return {lane: state.text for lane, state in stage.lanes().items()}
