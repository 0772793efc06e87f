"""Which axes a magnetometer has beside the gyros', by how the field goes through turns.

The field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later one, and
P the matrix that takes the magnetometer's axes to the gyros'::

    P field_0 = C P field_1

This is linear in P, so sums of products of fields and turns, a matrix of 9 by 9, hold all that slots say:
what any P leaves over is a square form of it.  P and -P leave the same: whether a magnetometer shows the
field or its reverse, no turn tells.  So of the 48 ways to name three axes and their signs 24 are told apart.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import permutations, product

import numpy as np

from imumon.blocks import FloatArray


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
LEAST_TURNED = np.pi**2
"""rad²: sum of the squared angles by which the field contradicts the axes as declared, before it is said."""


@dataclass(slots=True, eq=False)
class Mounting:
    """What turns have told.

    Parameters
    ----------
    squares : array (9, 9)
        Of P row by row: p' squares p is the sum of the squares that P leaves over, in units of the field's
        strength squared.
    """

    squares: FloatArray = field(default_factory=lambda: np.zeros((9, 9)))

    def add(self, before: FloatArray, after: FloatArray, rotation: FloatArray) -> None:
        """Take the field before and after turns, (n, 3), over its strength, and the turns, (n, 3, 3)."""
        n = len(before)
        left = np.zeros((n, 3, 3, 3))
        left[:, range(3), range(3)] = before[:, np.newaxis]
        left -= rotation[..., np.newaxis] * after[:, np.newaxis, np.newaxis]
        rows = left.reshape(3 * n, 9)
        self.squares += rows.T @ rows

    def left(self) -> FloatArray:
        """Return the sum of the squares that each of `WAYS` leaves over, (24,)."""
        ways = WAYS.reshape(-1, 9)
        return np.asarray(((ways @ self.squares) * ways).sum(1))

    @property
    def found(self) -> int:
        """Which of `WAYS` it is where that is certain, else 0: as declared, or not told."""
        left = self.left()
        least = int(left.argmin())
        certain = left[0] > DECISIVE * left[least] and left[0] - left[least] > LEAST_TURNED
        return least if certain else 0


def named(way: FloatArray) -> str:
    """Say which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    return " or ".join(
        ", ".join(f"{'-' if sign < 0.0 else '+'}{'xyz'[axis]}" for sign, axis in zip(of, axes, strict=True))
        for of in both
    )
