"""Whether a magnetometer has the gyros' axes: the field of a recording beside how the gyros say it turned.

The field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later one, and
P the matrix that takes the magnetometer's axes to the gyros'::

    P field_0 = C P field_1

Of the 24 rotations that turn axes into axes the one is taken that leaves least; P and -P leave the same, as
no turn shows whether a magnetometer has the field or its reverse.  From there least squares find the
rotation, with what else may be between the two: a constant bias of the gyros and a time by which the
magnetometer is late.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.errors import bad_data
from imumon.filters.slots import SlotGatherer, Slots
from imumon.filters.turns import PAUSE_S
from imumon.lab.calibration.magnetometer import slower_than_white
from imumon.models.magnetometer import MagnetometerModel

_WAYS = Rotation.create_group("O").as_matrix().round() + 0.0  # no negative zeros
WAYS: FloatArray = _WAYS[np.argsort(-np.trace(_WAYS, axis1=1, axis2=2), kind="stable")]
"""The rotations that turn axes into axes, the identity first, (24, 3, 3)."""
LOST = 0.01
"""rad²: variance of a turn for want of samples beyond which it is not compared with the field."""
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
SIGMAS = 4.0
"""An angle is reported as a mounting error from so many of its standard deviations on."""


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


class Turns(NamedTuple):
    """The field before and after turns, over its strength, (n, 3), the rates then, (n, 3), and the turns."""

    before: FloatArray
    after: FloatArray
    rate_before: FloatArray
    rate_after: FloatArray
    rotation: FloatArray
    """From the axes after to those before, (n, 3, 3)."""
    by_bias: FloatArray
    """Angle by a bias of the gyros, s, (n, 3, 3)."""

    def residual(self, way: FloatArray, x: FloatArray) -> FloatArray:
        """Return what is left of the fields, (3n,).

        `x` is the rotation vector from `way`, rad, the bias of the gyros, rad/s, and the lateness of the
        magnetometer, s.  A field that is late by tau is off by tau times its rate, -rate x field.
        """
        bias, late_s = x[3:6], x[6]
        axes = Rotation.from_rotvec(x[:3]).as_matrix() @ way
        before, after = self.before @ axes.T, self.after @ axes.T
        before = before - late_s * np.cross(self.rate_before - bias, before)
        after = after - late_s * np.cross(self.rate_after - bias, after)
        turned = np.einsum("nij,nj->ni", self.rotation, after)
        return np.asarray(before - Rotation.from_rotvec(-self.by_bias @ bias).apply(turned)).reshape(-1)

    def axes(self, noise: float) -> Axes:
        """Return the axes of a magnetometer whose field scatters by `noise` over its strength."""
        way = min(WAYS, key=lambda one: float((self.residual(one, np.zeros(7)) ** 2).sum()))
        solved = least_squares(lambda x: self.residual(way, x), np.zeros(7), x_scale="jac", method="lm")
        left, jacobian = np.asarray(solved.fun), np.asarray(solved.jac)
        variance = float(left @ left) / (len(left) - 7)
        went = float(((self.after - self.before) ** 2).sum()) / len(left)
        follows = variance < MOST_LEFT * went or variance < (BEYOND * noise) ** 2
        # A field that differs from place to place, and errors that go with the turns, are not white.
        slower = max(slower_than_white(axis) for axis in left.reshape(-1, 3).T)
        covariance = variance * slower * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
        sd = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
        rotation = Rotation.from_rotvec(solved.x[:3]).as_matrix() @ way
        return Axes(rotation, float(np.hypot(sd, GYRO_SCALE)), follows)


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
        compared = Turns(field[after - 1], field[after], rate[after - 1], rate[after], rotation, by_bias)
        return compared.axes(model.residual_sd / model.field)


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
    if axes.angle < SIGMAS * axes.sd:
        return []
    return [
        f"the magnetometer is turned by {np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against "
        "the gyros: headings are off by up to as much, and more where the field is steep; the model file "
        "does not hold that"
    ]


def named(way: FloatArray) -> str:
    """Say which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    return " or ".join(
        ", ".join(f"{'-' if sign < 0.0 else '+'}{'xyz'[axis]}" for sign, axis in zip(of, axes, strict=True))
        for of in both
    )
