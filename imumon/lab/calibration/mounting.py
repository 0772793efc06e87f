"""Which axes a magnetometer has beside the gyros', by how the field goes through turns.

The field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later one,
P the matrix that takes the magnetometer's axes to the gyros', and q what iron on the unit adds there::

    P field_0 - q = C (P field_1 - q)

This is linear in P and q, so sums of products of fields and turns, a matrix of 12 by 12, hold all that slots
say: what any P leaves over, with the q that leaves least, is a square form of it.  P and -P leave the same:
whether a magnetometer shows the field or its reverse, no turn shows.  So of the 48 ways to name three axes
and their signs 24 can be distinguished.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations, product

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.filters.turns import Turn, Turns


def _ways() -> FloatArray:
    """Return the rotations that turn axes into axes, the identity first, (24, 3, 3)."""
    signed = (
        np.eye(3)[list(order)] * signs
        for order in permutations(range(3))
        for signs in product((1, -1), repeat=3)
    )
    return np.array([way for way in signed if np.linalg.det(way) > 0.0])


WAYS = _ways()
DECISIVE = 4.0
"""By so much less another way must leave over, as a scale that is off by 50 % would leave of a turn."""
LEAST_TURNED = 3.0
"""rad²: sum of the squared angles by which the field must contradict the axes, as of a radian about each."""
LOST = 0.01
"""rad²: variance of a turn for want of samples beyond which it is not compared with the field."""
ALONG = 1e-6
"""Share of the squares of turns about other axes, below which iron along an axis does not show."""


@dataclass(slots=True, eq=False)
class Mounting:
    """Evidence of the turns so far.

    Parameters
    ----------
    squares : array (12, 12)
        Of P row by row and q behind: p' squares p is the sum of the squares that they leave over, in units of
        the field's strength squared.
    """

    squares: FloatArray = field(default_factory=lambda: np.zeros((12, 12)))

    def add(self, before: FloatArray, after: FloatArray, rotation: FloatArray) -> None:
        """Take the field before and after turns, (n, 3), over its strength, and the turns, (n, 3, 3)."""
        n = len(before)
        left = np.zeros((n, 3, 3, 3))
        left[:, range(3), range(3)] = before[:, np.newaxis]
        left -= rotation[..., np.newaxis] * after[:, np.newaxis, np.newaxis]
        rows = np.concatenate([left.reshape(n, 3, 9), rotation - np.eye(3)], axis=2).reshape(3 * n, 12)
        self.squares += rows.T @ rows

    def left(self) -> FloatArray:
        """Return the sum of the squares that each of `WAYS` leaves over, (24,)."""
        ways, beside = WAYS.reshape(-1, 9), self.squares[:9, 9:]
        by_iron = beside @ np.linalg.pinv(self.squares[9:, 9:], ALONG, hermitian=True) @ beside.T
        return np.asarray(((ways @ (self.squares[:9, :9] - by_iron)) * ways).sum(1))

    @property
    def found(self) -> int:
        """Which of `WAYS` it is where that is certain, else 0: as declared, or not known."""
        left = self.left()
        least = int(left.argmin())
        certain = left[0] > DECISIVE * left[least] and left[0] - left[least] > LEAST_TURNED
        return least if certain else 0


def are_known(turns: Turn | Turns) -> BoolArray:
    """Tell of which turns enough is known between their samples, (m,), or () of one."""
    return np.asarray((turns.coning**2).sum(-1) + turns.fast**2 + turns.missed < LOST)


def named(way: FloatArray) -> str:
    """Say which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    return " or ".join(
        ", ".join(f"{'-' if sign < 0.0 else '+'}{'xyz'[axis]}" for sign, axis in zip(of, axes, strict=True))
        for of in both
    )
