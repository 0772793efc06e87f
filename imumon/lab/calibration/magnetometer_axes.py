"""Whether a magnetometer has the gyros' axes: the field of a recording beside the turns of the gyros.

The field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later one, and
P the matrix that takes the magnetometer's axes to the gyros'::

    P field_0 = C P field_1

Of the 24 rotations that turn axes into axes the one is taken that leaves least; P and -P leave the same, as
no turn shows whether a magnetometer has the field or its reverse.  From there least squares find the
rotation, with what else may be between the two: a constant bias of the gyros and a time by which the
magnetometer is late.
"""

from __future__ import annotations

from collections.abc import Iterable
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
"""A rotation that is known to no better does not determine axes, which are 90° apart."""
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
        """Whether the gyros determine which axes these are."""
        return self.follows and self.sd < WORST_SD

    @property
    def angle(self) -> float:
        """By how much the magnetometer is turned against the gyros, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def axes_of(blocks: Iterable[SampleBlock], model: MagnetometerModel) -> Axes | None:
    """Return the axes of a magnetometer that is calibrated; None where the gyros do not determine them.

    Slots count whose turn is known from the end of the one before.
    """
    gatherer, slots = SlotGatherer(6, SLOT_NS, turns=True), list[Slots]()
    for block in blocks:
        gyro, mag = block.gyro, block.mag
        if gyro is not None and mag is not None and "device_time_ns" in block:
            values = np.column_stack([gyro, mag])
            slots.append(gatherer.process(block["device_time_ns"], block["segment"], values))
    turns = [turn for each in slots for turn in each.turns]
    if len(turns) <= LEAST_SLOTS:
        return None
    last, end_ns, begins = (
        np.concatenate([getattr(each, name) for each in slots]) for name in ("last", "end_ns", "begins")
    )
    seconds = np.array([turn.seconds for turn in turns])
    uncertain = np.array([turn.coning @ turn.coning + turn.fast**2 + turn.missed for turn in turns])
    known = ~begins[1:] & (np.abs(1e-9 * np.diff(end_ns) - seconds[1:]) < PAUSE_S)
    known &= (uncertain[1:] < LOST) & np.isfinite(last[1:] + last[:-1]).all(1)
    if known.sum() < LEAST_SLOTS:
        return None
    after = np.flatnonzero(known) + 1
    both = np.column_stack([after - 1, after])
    field, rate = model.corrected(last[:, 3:]) / model.field, last[:, :3]
    rotation, by_bias = (np.array([getattr(turns[k], n) for k in after]) for n in ("rotation", "by_bias"))
    return fitted_axes(field[both], rate[both], rotation, by_bias, model.residual_sd / model.field)


def fitted_axes(
    field: FloatArray, rate: FloatArray, rotation: FloatArray, by_bias: FloatArray, noise: float
) -> Axes:
    """Return the axes of a magnetometer by n turns of the gyros.

    Parameters
    ----------
    field, rate : array (n, 2, 3)
        Field over its strength and rate of turn, rad/s, before and after each turn.
    rotation, by_bias : array (n, 3, 3)
        From the axes after a turn to those before, and its angle by a bias of the gyros, s.
    noise : float
        Scatter of the field over its strength.
    """

    def residual(x: FloatArray, way: FloatArray) -> FloatArray:
        """Return what is left of the fields, (3n,), by rotation from `way`, bias and lateness, (7,).

        A field that is late by tau is off by tau times its rate, -rate x field.
        """
        bias, late_s = x[3:6], x[6]
        seen = field @ (Rotation.from_rotvec(x[:3]).as_matrix() @ way).T
        before, after = np.moveaxis(seen - late_s * np.cross(rate - bias, seen), 1, 0)
        turned = np.einsum("nij,nj->ni", rotation, after)
        return np.asarray(before - Rotation.from_rotvec(-by_bias @ bias).apply(turned)).reshape(-1)

    way = min(WAYS, key=lambda one: float((residual(np.zeros(7), one) ** 2).sum()))
    solved = least_squares(residual, np.zeros(7), args=(way,), x_scale="jac", method="lm")
    left, jacobian = np.asarray(solved.fun), np.asarray(solved.jac)
    variance = float(left @ left) / (len(left) - 7)
    went = float(((field[:, 1] - field[:, 0]) ** 2).sum()) / len(left)
    follows = variance < MOST_LEFT * went or variance < (BEYOND * noise) ** 2
    # A field that differs from place to place, and errors that go with the turns, are not white.
    slower = max(slower_than_white(axis) for axis in left.reshape(-1, 3).T)
    covariance = variance * slower * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    sd = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    return Axes(
        Rotation.from_rotvec(solved.x[:3]).as_matrix() @ way, float(np.hypot(sd, GYRO_SCALE)), follows
    )


def doubts(axes: Axes | None, source: str) -> list[str]:
    """Return warnings about the axes.

    Raises BAD_DATA where the magnetometer has other axes than the gyros.
    """
    if axes is not None and not axes.follows:
        what = "the field did not go as the gyros turned, in any axes"
        return [f"{what}, which are not checked: are unit and axes of the gyros right?"]
    if axes is None or not axes.is_significant:
        return []
    if axes.way:
        raise bad_data(
            f"{source}: the magnetometer has not the gyros' axes: their x, y, z are its "
            + named(WAYS[axes.way]),
            "name the columns of mag in this order in the map or device file, and reverse what has a minus "
            "(in a device file by a negative scale); turns do not show which of the two it is: north of the "
            "magnetic equator the field must point down",
        )
    if axes.angle < SIGMAS * axes.sd:
        return []
    turned = f"{np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against the gyros"
    what = f"the magnetometer is turned by {turned}, which the model file does not hold"
    return [f"{what}: headings are off by up to as much, and more where the field is steep"]


def named(way: FloatArray) -> str:
    """Return which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    names = [[f"{sign:+.0f}"[0] + "xyz"[axis] for sign, axis in zip(of, axes, strict=True)] for of in both]
    return " or ".join(map(", ".join, names))
