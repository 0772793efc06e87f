"""Whether a magnetometer has the gyros' axes: the field of a recording beside how the gyros say it turned.

`mounting` finds which of the 24 ways it is; from there Gauss and Newton find the rotation, with what else may
be between the two: a constant bias of the gyros and a time by which the magnetometer is late.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from imumon.blocks import BoolArray, ColumnArray, FloatArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.filters.slots import SlotGatherer, Slots
from imumon.filters.turns import PAUSE_S, rotation_by
from imumon.lab.calibration.mounting import WAYS, Mounting, are_known, named
from imumon.models.magnetometer import MagnetometerModel

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
STEPS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Axes:
    """The rotation from the magnetometer's axes to the gyros'.

    Parameters
    ----------
    rotation : array (3, 3)
    sd : float
        Of its angle, rad.
    follows : bool
        Whether the field went as the gyros turned, in these axes.
    """

    rotation: FloatArray
    sd: float
    follows: bool

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


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """The field before and after turns, over its strength, (n, 3), the rates then, (n, 3), and the turns."""

    before: FloatArray
    after: FloatArray
    rate_before: FloatArray
    rate_after: FloatArray
    rotation: FloatArray
    by_bias: FloatArray

    def __getitem__(self, which: BoolArray) -> _Pairs:
        """Return some of them."""
        return _Pairs(*(getattr(self, one.name)[which] for one in fields(self)))

    def less(self, bias: FloatArray) -> _Pairs:
        """Return the same by gyros without a constant bias, rad/s, (3,): as of `Turn.less`."""
        angles = self.by_bias @ bias
        turned = np.array([rotation_by(-angle) for angle in angles]) @ self.rotation
        rates = self.rate_before - bias, self.rate_after - bias
        return _Pairs(self.before, self.after, *rates, turned, self.by_bias)


class Gathered:
    """What the gyros and the magnetometer of a recording say, slot by slot."""

    def __init__(self) -> None:
        self._gatherer = SlotGatherer(6, SLOT_NS, rates=0)
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
        """Return the axes of a magnetometer that is calibrated; None where the gyros do not tell."""
        if not self._slots:
            return None
        pairs = self._pairs(model)
        return _fitted(pairs, model.residual_sd / model.field) if len(pairs.before) >= LEAST_SLOTS else None

    def _pairs(self, model: MagnetometerModel) -> _Pairs:
        """Return the slots whose turn is known from the end of the one before."""

        def every(one: Callable[[Slots], ColumnArray]) -> ColumnArray:
            return np.concatenate([one(slots) for slots in self._slots])

        last, end_ns = every(lambda slots: slots.last), every(lambda slots: slots.end_ns)
        field = model.corrected(last[:, 3:]) / model.field
        rate = last[:, :3]
        pairs = _Pairs(
            field[:-1], field[1:], rate[:-1], rate[1:],
            every(lambda slots: slots.turns.rotation)[1:], every(lambda slots: slots.turns.by_bias)[1:],
        )  # fmt: skip
        missing_s = 1e-9 * np.diff(end_ns) - every(lambda slots: slots.turns.seconds)[1:]
        known = ~every(lambda slots: slots.begins)[1:] & (np.abs(missing_s) < PAUSE_S)
        known &= every(lambda slots: are_known(slots.turns))[1:] & np.isfinite(last[1:] + last[:-1]).all(1)
        return pairs[known]


def refuse_other_axes(axes: Axes | None, source: str) -> None:
    """Raise BAD_DATA where the magnetometer has other axes than the gyros."""
    if axes is None or not axes.is_significant or axes.way == 0:
        return
    raise ImumonError(
        Reason.BAD_DATA,
        f"{source}: the magnetometer has not the gyros' axes: their x, y, z are its {named(WAYS[axes.way])}",
        "name the columns of mag in this order in the map or device file, and reverse what has a minus (in a "
        "device file by a negative scale); turns do not tell which of the two it is: north of the magnetic "
        "equator the field must point down",
    )


def doubts(axes: Axes | None) -> list[str]:
    """Return what is to be said of the axes."""
    if axes is None:
        return []
    if not axes.follows:
        return [
            "the field did not go as the gyros turned, in any axes: are unit and axes of the gyros right? "
            "The axes of the magnetometer were not checked"
        ]
    if not axes.is_significant or axes.angle < SIGMAS * axes.sd:
        return []
    return [
        f"the magnetometer is turned by {np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against "
        "the gyros: headings are off by up to as much, and more where the field is steep; the model file "
        "does not hold that"
    ]


def _fitted(pairs: _Pairs, noise: float) -> Axes:
    """Return the axes by pairs of fields, whose scatter over their strength is `noise`."""
    mounting = Mounting()
    mounting.add(pairs.before, pairs.after, pairs.rotation)
    rotation, late_s = WAYS[int(mounting.left().argmin())], 0.0
    for _ in range(STEPS):
        left, jacobian = _left(pairs, rotation, late_s)
        step = np.linalg.lstsq(jacobian, -left, rcond=None)[0]
        rotation = rotation_by(np.asarray(step[:3], np.float64)) @ rotation
        pairs, late_s = pairs.less(np.asarray(step[3:6], np.float64)), late_s + float(step[6])
        if np.abs(step[:3]).max() < 1e-9:
            break
    left, jacobian = _left(pairs, rotation, late_s)
    variance = float(left @ left) / (len(left) - jacobian.shape[1])
    went = float(((pairs.after - pairs.before) ** 2).sum()) / len(left)
    follows = variance < MOST_LEFT * went or variance < (BEYOND * noise) ** 2
    sd = np.sqrt(np.linalg.eigvalsh(_covariance(left, jacobian)[:3, :3])[-1])
    return Axes(rotation, float(np.hypot(sd, GYRO_SCALE)), follows)


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


def _left(pairs: _Pairs, rotation: FloatArray, late_s: float) -> tuple[FloatArray, FloatArray]:
    """Return what is left of the fields, (3n,), and its derivatives by the angles of the rotation, rad, the
    bias of the gyros, rad/s, and the lateness of the magnetometer, s, (3n, 7).

    A field that is late by tau is off by tau times its rate, -rate x field.
    """
    before, after = pairs.before @ rotation.T, pairs.after @ rotation.T
    slope = -np.cross(pairs.rate_before, before), -np.cross(pairs.rate_after, after)
    turned = np.einsum("nij,nj->ni", pairs.rotation, after + late_s * slope[1])
    left = before + late_s * slope[0] - turned
    # C less a bias is the rotation by -by_bias bias, and C behind.
    by_bias = _crossed(turned) @ pairs.by_bias
    by_angle = -_crossed(before) + pairs.rotation @ _crossed(after)
    by_late = slope[0] - np.einsum("nij,nj->ni", pairs.rotation, slope[1])
    jacobian = np.concatenate([by_angle, -by_bias, by_late[:, :, np.newaxis]], axis=2)
    return left.reshape(-1), jacobian.reshape(-1, 7)


def _crossed(vectors: FloatArray) -> FloatArray:
    """Return the matrices, (n, 3, 3), that take a vector to the product of these with it."""
    x, y, z = vectors.T
    none = np.zeros_like(x)
    return np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)
