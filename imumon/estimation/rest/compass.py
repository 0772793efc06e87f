"""What knows the heading without the gyros tells a turn from a bias: a magnetometer, or the device's yaw."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from itertools import product

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.rest.state import SLOT_S, State

ENDS = 8
"""Slots whose mean is a reading of the compass; fewer where it turns by `WANTED_RAD` in less than two."""
WANTED_RAD = 0.7
"""A turn by so much is compared: less is near the noise, much more is ambiguous."""
CLEAR = 8.0
"""Standard deviations of a reading between a turn and none before either is believed."""
UP = np.array([0.0, 0.0, 1.0])
NEAR = 0.25
"""Share of the way from none to a turn, or back, by which a reading may be off: hard and soft iron."""
ANY = (0.5, 0.75, 1.0, 1.25, 1.5)
"""Shares of the gyros' mean that are tried where their bias is not known: it is no more than half of it."""


class Verdict(Enum):
    """What the compass says of a turn that the gyros show."""

    UNDECIDED = 0
    TURNS = 1
    RESTS = 2


def reference(block: SampleBlock) -> FloatArray | None:
    """Return a vector that turns with the heading, (n, 3), or None when the block has none.

    It is the magnetic field in body axes, else cosine and sine of the yaw and zero.
    """
    field = block.mag
    if field is not None:
        return field
    yaw = block.columns.get("yaw")
    q = block.quaternion
    if yaw is None and q is not None:
        w, x, y, z = q.T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    if yaw is None:
        return None
    return np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(block))])


def verdict(state: State, turn: FloatArray, slots: int, shares: Sequence[float] = (1.0,)) -> Verdict:
    """Tell whether a turn, (3,) rad/s, or one of its shares, changed the heading in the latest slots."""
    if not np.isfinite(state.windows.reference[state.length - 1, 0]):
        return Verdict.UNDECIDED
    rate = float(np.linalg.norm(turn))
    if rate == 0.0:
        return Verdict.UNDECIDED
    wanted = int(WANTED_RAD / (rate * SLOT_S)) + 1
    ends = min(ENDS, max(wanted // 2, 1))
    slots = min(slots - ends, wanted)
    if slots < 2 * ends:
        return Verdict.UNDECIDED
    n, values = state.length, state.windows.reference
    then, now = values[n - slots - ends : n - slots], values[n - ends : n]
    noise = float(np.sqrt(np.diff(values[n - slots - ends : n], axis=0).var(0).sum() / (2.0 * ends)))
    start, end = then.mean(0), now.mean(0)
    seconds = state.span_s(slots)
    # The field turns against the body; of the yaw the sense depends on the axes.
    axis, senses = (UP, (-1.0, 1.0)) if start[2] == 0.0 else (turn / rate, (-1.0,))
    clear = float(np.linalg.norm(_turned(start, axis, rate * seconds) - start))
    if not clear > CLEAR * noise or clear < 1e-9:
        return Verdict.UNDECIDED
    if float(np.linalg.norm(end - start)) < NEAR * clear:
        return Verdict.RESTS
    for sense, share in product(senses, shares):
        if float(np.linalg.norm(end - _turned(start, axis, sense * share * rate * seconds))) < NEAR * clear:
            return Verdict.TURNS
    return Verdict.UNDECIDED


def _turned(vector: FloatArray, axis: FloatArray, angle: float) -> FloatArray:
    """Return a vector turned about a unit axis (Rodrigues)."""
    along = (vector @ axis) * axis
    across = vector - along
    return np.asarray(along + np.cos(angle) * across + np.sin(angle) * np.cross(axis, vector))
