"""Whether a magnetometer has the gyros' axes: the field of a recording beside how the gyros say it turned.

The field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later one,
P the matrix that takes the magnetometer's axes to the gyros', and q what iron on the unit adds there::

    P field_0 - q = C (P field_1 - q)

Of the 24 rotations that turn axes into axes the one is taken that leaves least; P and -P leave the same, as
no turn shows whether a magnetometer has the field or its reverse.  From there least squares find the
rotation, with what else may be between the two: a constant bias of the gyros and a time by which the
magnetometer is late.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.errors import bad_data
from imumon.filters.slots import SlotGatherer, Slots
from imumon.filters.turns import PAUSE_S
from imumon.models.magnetometer import MagnetometerModel

_SIGNED = [
    np.eye(3)[list(order)] * signs
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3))
]
WAYS = np.array([way for way in _SIGNED if np.linalg.det(way) > 0.0])
"""The rotations that turn axes into axes, the identity first, (24, 3, 3)."""
LOST = 0.01
"""rad²: variance of a turn for want of samples beyond which it is not compared with the field."""
ALONG = 1e-6
"""Share of the squares of turns about other axes, below which iron along an axis does not show."""
SLOT_NS = 500_000_000
"""A hand turns a unit by tenths of a radian meanwhile, and by less than half a circle."""
LEAST_SLOTS = 20
"""For seven numbers and what is left over: ten seconds of turns."""
GYRO_SCALE = 0.01
"""Of gyros without calibration, each element of scale and misalignment, as in `AttitudeParameters`: what is
fitted to such gyros is known to no better, rad."""
WORST_SD = np.radians(10.0)
"""A rotation that is known to no better says nothing of axes, which are 90° apart."""
MOST_LEFT, BEYOND = 0.25, 3.0
"""Of the squares of how the field went, and of what the fit of its strength left: what is left beyond both
has not gone as the gyros turned, in any axes."""
PARTS = 8
"""Of a record: long enough to differ by themselves, and enough for a standard deviation to a quarter."""
SIGMAS = 4.0
"""By eight parts: beyond it is one in 200 (Student, seven degrees of freedom)."""


class Axes(NamedTuple):
    """The rotation from the magnetometer's axes to the gyros'."""

    rotation: FloatArray
    """(3, 3)."""
    sd: float
    """Of its angle, rad."""
    follows: bool
    """Whether the field went as the gyros turned, in these axes."""

    @property
    def way(self) -> int:
        """Which of `WAYS` is next to it."""
        return int(np.einsum("kij,ij->k", WAYS, self.rotation).argmax())

    @property
    def is_significant(self) -> bool:
        """Whether the gyros tell which axes these are."""
        return self.follows and self.sd < WORST_SD

    @property
    def angle(self) -> float:
        """By how much the magnetometer is turned against the gyros, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


class _Pairs(NamedTuple):
    """The field before and after turns, over its strength, (n, 3), the rates then, (n, 3), and the turns."""

    before: FloatArray
    after: FloatArray
    rate_before: FloatArray
    rate_after: FloatArray
    rotation: FloatArray
    by_bias: FloatArray


class Gathered:
    """What the gyros and the magnetometer of a recording say, slot by slot."""

    def __init__(self) -> None:
        self._gatherer = SlotGatherer(6, SLOT_NS, turns=True)
        self._slots: list[Slots] = []

    def passing(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks as they are, and take of them what has gyros, magnetometer and time."""
        for block in blocks:
            gyro, mag = block.gyro, block.mag
            if gyro is not None and mag is not None and "device_time_ns" in block:
                values, time_ns = np.column_stack([gyro, mag]), block["device_time_ns"]
                self._slots.append(self._gatherer.process(time_ns, block["segment"], values))
            yield block

    def axes(self, model: MagnetometerModel) -> Axes | None:
        """Return the axes of a magnetometer that is calibrated; None where the gyros do not tell.

        Slots count whose turn is known from the end of the one before.
        """
        if not self._slots:
            return None
        last, end_ns, begins = (
            np.concatenate([getattr(slots, name) for slots in self._slots])
            for name in ("last", "end_ns", "begins")
        )
        turns = [turn for slots in self._slots for turn in slots.turns]
        seconds = np.array([turn.seconds for turn in turns])
        uncertain = np.array([turn.coning @ turn.coning + turn.fast**2 + turn.missed for turn in turns])
        known = ~begins[1:] & (np.abs(1e-9 * np.diff(end_ns) - seconds[1:]) < PAUSE_S)
        known &= (uncertain[1:] < LOST) & np.isfinite(last[1:] + last[:-1]).all(1)
        if known.sum() < LEAST_SLOTS:
            return None
        after = np.flatnonzero(known) + 1
        field, rate = model.corrected(last[:, 3:]) / model.field, last[:, :3]
        rotation, by_bias = (
            np.array([getattr(turns[k], name) for k in after]) for name in ("rotation", "by_bias")
        )
        pairs = _Pairs(field[after - 1], field[after], rate[after - 1], rate[after], rotation, by_bias)
        return _fitted(pairs, model.residual_sd / model.field)


def doubts(axes: Axes | None, source: str) -> list[str]:
    """Return warnings about the axes.

    Raises BAD_DATA where the magnetometer has other axes than the gyros.
    """
    if axes is not None and not axes.follows:
        return [
            "the field did not go as the gyros turned, in any axes: are unit and axes of the gyros right? "
            "The axes of the magnetometer were not checked"
        ]
    if axes is None or not axes.is_significant:
        return []
    if axes.way:
        raise bad_data(
            f"{source}: the magnetometer has not the gyros' axes: their x, y, z are its "
            + named(WAYS[axes.way]),
            "name the columns of mag in this order in the map or device file, and reverse what has a minus "
            "(in a device file by a negative scale); turns do not tell which of the two it is: north of the "
            "magnetic equator the field must point down",
        )
    text = (
        f"the magnetometer is turned by {np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against "
        "the gyros: headings are off by up to as much, and more where the field is steep; the model file "
        "does not hold that"
    )
    return [text] if axes.angle >= SIGMAS * axes.sd else []


def _fitted(pairs: _Pairs, noise: float) -> Axes:
    """Return the axes by pairs of fields, whose scatter over their strength is `noise`."""
    way = WAYS[int(left_by_ways(pairs.before, pairs.after, pairs.rotation).argmin())]
    solved = least_squares(lambda x: _left(pairs, way, x), np.zeros(7), x_scale="jac", method="lm")
    left = np.asarray(solved.fun)
    variance = float(left @ left) / (len(left) - 7)
    went = float(((pairs.after - pairs.before) ** 2).sum()) / len(left)
    follows = variance < MOST_LEFT * went or variance < (BEYOND * noise) ** 2
    sd = np.sqrt(np.linalg.eigvalsh(_covariance(left, np.asarray(solved.jac))[:3, :3])[-1])
    rotation = Rotation.from_rotvec(solved.x[:3]).as_matrix() @ way
    return Axes(rotation, float(np.hypot(sd, GYRO_SCALE)), follows)


def left_by_ways(before: FloatArray, after: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the sum of the squares that each of `WAYS` leaves over, with the iron that leaves least, (24,).

    Parameters
    ----------
    before, after : arrays (n, 3)
        The field before and after turns, over its strength.
    rotation : array (n, 3, 3)
        The turns.
    """
    by_iron = rotation - np.eye(3)
    turned = np.einsum("nij,wjk,nk->nwi", rotation, WAYS, after)
    left = np.einsum("wij,nj->nwi", WAYS, before) - turned
    square = np.einsum("nij,nik->jk", by_iron, by_iron)
    pull = np.einsum("nij,nwi->wj", by_iron, left)
    explained = np.einsum("wi,ij,wj->w", pull, np.linalg.pinv(square, ALONG, hermitian=True), pull)
    return np.asarray((left**2).sum((0, 2)) - explained)


def _covariance(left: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Return the covariance of least squares by how `PARTS` of the record differ, (7, 7).

    What is left is not white: a field differs from place to place, and gyros and magnetometer have errors
    that go with the turns.
    """
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    rows = np.array_split(np.arange(len(left) // 3), PARTS)
    pulls = np.array(
        [(left.reshape(-1, 3, 1)[part] * jacobian.reshape(-1, 3, 7)[part]).sum((0, 1)) for part in rows]
    )
    return np.asarray(inverse @ (pulls.T @ pulls) @ inverse * PARTS / (PARTS - 1))


def _left(pairs: _Pairs, way: FloatArray, x: FloatArray) -> FloatArray:
    """Return what is left of the fields, (3n,).

    `x` is the rotation vector from `way`, rad, the bias of the gyros, rad/s, and the lateness of the
    magnetometer, s.  A field that is late by tau is off by tau times its rate, -rate x field.
    """
    bias, late_s = x[3:6], x[6]
    axes = Rotation.from_rotvec(x[:3]).as_matrix() @ way
    before, after = pairs.before @ axes.T, pairs.after @ axes.T
    before = before - late_s * np.cross(pairs.rate_before - bias, before)
    after = after - late_s * np.cross(pairs.rate_after - bias, after)
    turned = np.einsum("nij,nj->ni", pairs.rotation, after)
    return np.asarray(before - Rotation.from_rotvec(-pairs.by_bias @ bias).apply(turned)).reshape(-1)


def named(way: FloatArray) -> str:
    """Say which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    return " or ".join(
        ", ".join(f"{'-' if sign < 0.0 else '+'}{'xyz'[axis]}" for sign, axis in zip(of, axes, strict=True))
        for of in both
    )
