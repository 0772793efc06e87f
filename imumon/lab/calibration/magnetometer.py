"""Hard and soft iron from readings in many directions, and whether a magnetometer has the gyros' axes.

From a sphere least squares fit the strength of the field::

    r_k = |A (m_k - b)| - F,    A symmetric, det A = 1

The covariance is that of least squares, with the scatter that is left, times how much slower than white it
is: a field that differs from place to place does not average as noise does.  Where the two halves of the
turns contradict each other, by a current that was switched on meanwhile, half their difference is added.

The axes: the field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later
one, and P the matrix that takes the magnetometer's axes to the gyros'::

    P field_0 = C P field_1

Of the 24 rotations that turn axes into axes the one is taken that leaves least; P and -P leave the same, as
no turn shows whether a magnetometer has the field or its reverse.  From there least squares find the
rotation, with what else may be between the two: a constant bias of the gyros and a time by which the
magnetometer is late.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.errors import bad_data
from imumon.filters.slots import SlotGatherer
from imumon.filters.turns import PAUSE_S
from imumon.models.model import MagnetometerModel

STEP_RAD = np.radians(1.0)
"""A reading counts when its direction differs by so much from the last that did: rest must not weigh more."""
CELLS = 60
_K = np.arange(CELLS) + 0.5
_Z, _TURN = 1.0 - 2.0 * _K / CELLS, np.pi * (1.0 + np.sqrt(5.0)) * _K
MIDDLES = np.column_stack([*(np.sqrt(1.0 - _Z**2) * (np.cos(_TURN), np.sin(_TURN))), _Z])
"""Directions are counted in so many cells of equal area, each about 30° wide, whose middles, (CELLS, 3), are
on a spiral by the golden angle."""
LEAST_COVERAGE = 0.5
"""Of the cells.  With points on one side only, an ellipsoid's far side is extrapolated."""
LEAST_POINTS = 100
"""For nine numbers and what is left over."""
WORST_SD = 0.01
"""Of the field's strength: an error of 0.6° of the heading where the field is level, 1.5° in Europe."""
MOST_LEFT = 0.1
"""Of the strength: what scatters more is another field at every place."""
EARTH_UT = (22.0, 67.0)
"""Strength of the earth's field, from Paraguay to Siberia (IGRF-13); in a house half or twice that."""
BY_CHANCE = 3.0
"""Times its mean: a square of nine normal differences is larger once in 1e4 times."""
TRIANGLE = np.triu_indices(3)

_WAYS = Rotation.create_group("O").as_matrix().round() + 0.0  # no negative zeros
WAYS: FloatArray = _WAYS[np.argsort(-np.trace(_WAYS, axis1=1, axis2=2), kind="stable")]
"""The rotations that turn axes into axes, the identity first, (24, 3, 3)."""
LOST = 0.01
"""rad²: variance of a turn by missing samples beyond which it is not compared with the field."""
SLOT_NS = 500_000_000
"""A hand turns a unit by tenths of a radian meanwhile, and by less than half a circle."""
LEAST_SLOTS = 20
"""For seven numbers and what is left over: ten seconds of turns."""
GYRO_SCALE = 0.01
"""Of gyros without calibration, each element of scale and misalignment, as in `AttitudeParameters`: what is
fitted to such gyros is known to no better, rad."""
WORST_AXES_SD = np.radians(10.0)
"""A rotation that is known to no better does not determine axes, which are 90° apart."""
MOST_UNFOLLOWED, BEYOND = 0.25, 3.0
"""Of the squares of how the field went, and of what the fit of its strength left: what is left beyond both
has not gone as the gyros turned, in any axes."""
SIGMAS = 4.0
"""An angle is reported as a mounting error from so many of its standard deviations on."""


class MagnetometerFit(NamedTuple):
    """A calibration, and what it was made of."""

    model: MagnetometerModel
    readings: FloatArray
    """As sent, (n, 3); those that counted."""
    residual_before: float
    """Scatter of the strength as sent, in the unit of the readings."""


def fit_magnetometer(blocks: Iterable[SampleBlock], unit: str, source: str) -> MagnetometerFit:
    """Fit hard and soft iron to the magnetometer of samples.

    Raises BAD_DATA when there is no magnetometer, too little was turned, or the readings are on no ellipsoid;
    it states which share of the directions was measured, and what to turn next.

    `unit` is that of the readings, `source` their name in messages.
    """
    found = [np.empty((0, 6))]
    for block in blocks:
        if (mag := block.mag) is not None:
            accel = np.full_like(mag, np.nan) if block.accel is None else block.accel
            found.append(np.hstack([mag, accel])[np.isfinite(mag).all(1)])
    mag, accel = np.hsplit(np.concatenate(found), 2)
    if not len(mag):
        raise bad_data(f"{source}: there is no magnetometer", "needs mag_x, mag_y, mag_z")
    middle = 0.5 * (mag.max(0) + mag.min(0))
    field, model = mag - middle, None
    for _ in range(2):  # first by the directions of the readings, then by those of the field
        which = _spread(field)
        readings, what = mag[which], f"{len(which)} readings in other directions, {LEAST_POINTS} are needed"
        model = _fitted(readings, middle, unit) if len(which) >= LEAST_POINTS else None
        if model is None:
            break
        field = model.corrected(mag)
    if model is not None:
        left, known = model.residual_sd / model.field, model.fit_sd / model.field
        if known <= WORST_SD and left <= MOST_LEFT and model.coverage >= LEAST_COVERAGE:
            return MagnetometerFit(model, readings, float(np.linalg.norm(readings, axis=1).std()))
        what = (
            f"{model.coverage:.0%} of the directions were measured, {LEAST_COVERAGE:.0%} are needed;"
            f" {left:.1%} of the field is left, and hard and soft iron are known to {known:.1%}"
        )
    advice = "away from iron and cables, draw figure-eights while turning the unit over"
    # The directions of the field are hardly known then: those of gravity show what is missing.
    if len(up := accel[np.isfinite(accel).all(1)]):
        seen = covered(up)
        what += f"; gravity was in {seen.mean():.0%} of the directions"
        missing = ~seen @ MIDDLES
        axis = int(np.argmax(np.abs(missing)))
        side = f"{'-' if missing[axis] < 0.0 else '+'}{'xyz'[axis]}"
        advice += f"; next: turn the {side} axis up, and around there"
    raise bad_data(f"{source}: {what}", advice)


def covered(directions: FloatArray) -> BoolArray:
    """Return the cells that vectors of any length, (n, 3), were in, (CELLS,)."""
    return np.bincount(np.argmax(directions @ MIDDLES.T, axis=1), minlength=CELLS) > 0


def _spread(field: FloatArray) -> list[int]:
    """Return the rows whose direction differs by `STEP_RAD` from the last that was taken."""
    rows, last, least = list[int](), np.zeros(3), float(np.cos(STEP_RAD))
    with np.errstate(invalid="ignore"):  # where there is no field there is no direction
        directions = field / np.linalg.norm(field, axis=1, keepdims=True)
    for k, direction in enumerate(directions):
        if direction @ last < least:
            rows.append(k)
            last = direction
    return rows


def _left(parameters: FloatArray, readings: FloatArray) -> FloatArray:
    """Return |A (m - b)| - 1, (n,)."""
    return np.asarray(np.linalg.norm((readings - parameters[:3]) @ _symmetric(parameters[3:]), axis=1) - 1.0)


def _symmetric(triangle: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[TRIANGLE] = triangle
    return matrix + np.triu(matrix, 1).T


def _fitted(readings: FloatArray, middle: FloatArray, unit: str) -> MagnetometerModel | None:
    """Return the model, in the unit of the readings, with standard deviations; None where there is none.

    `middle`, (3,): of the sphere from which the fit begins.
    """
    size = float(np.linalg.norm(readings - middle, axis=1).mean())
    start = np.concatenate([middle, np.eye(3)[TRIANGLE] / size])
    solved = least_squares(_left, start, args=(readings,), x_scale="jac", method="lm")
    parameters, jacobian, residual = (np.asarray(part) for part in (solved.x, solved.jac, solved.fun))
    matrix = _symmetric(parameters[3:])
    if not solved.success or np.linalg.eigvalsh(matrix).min() <= 0.0:
        return None
    variance = float(residual @ residual) / (len(residual) - len(parameters))
    scatter = variance * slower_than_white(residual)
    normal = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True, rcond=1e-15)
    covariance = normal * scatter + _changed(jacobian, residual, scatter)
    field = float(np.linalg.det(matrix)) ** (-1.0 / 3.0)
    # A = F W with F = det(W)^(-1/3): the derivative of A for each element of W.
    inverse = np.linalg.inv(matrix)
    slopes = np.array([_symmetric(row) for row in np.eye(6)])
    change = field * (slopes - np.einsum("kij,ji->k", slopes, inverse)[:, None, None] / 3.0 * matrix)
    soft_variance = np.einsum("kij,kl,lij->ij", change, covariance[3:, 3:], change)
    return MagnetometerModel(
        unit=unit,
        hard_iron=parameters[:3].tolist(),
        hard_iron_sd=np.sqrt(np.diag(covariance)[:3]).tolist(),
        soft_iron=(field * matrix).tolist(),
        soft_iron_sd=np.sqrt(soft_variance).tolist(),
        field=field,
        residual_sd=field * float(np.sqrt(variance)),
        coverage=float(covered((readings - parameters[:3]) @ matrix).mean()),
    )


def _changed(jacobian: FloatArray, residual: FloatArray, scatter: float) -> FloatArray:
    """Return the covariance, (9, 9), by what has changed between the halves of the turns.

    It is the square of half their difference, less the share of it that scatter makes in the mean.
    """
    differ, covariance = np.zeros(9), np.zeros((9, 9))
    for sign, rows in zip((1.0, -1.0), np.array_split(np.arange(len(residual)), 2), strict=True):
        normal = np.linalg.pinv(jacobian[rows].T @ jacobian[rows], hermitian=True)
        differ += sign * (normal @ jacobian[rows].T @ residual[rows])
        covariance += normal * scatter
    square = float(differ @ np.linalg.pinv(covariance, hermitian=True) @ differ)
    beyond = max(0.0, 1.0 - len(differ) * BY_CHANCE / max(square, 1e-300))
    return np.outer(differ, differ) / 4.0 * beyond


def slower_than_white(residual: FloatArray) -> float:
    """Return by how much the variance of means of neighbours exceeds that of white noise, at least 1.

    The largest over lengths of means from 1 to a sixteenth of all: of those there are enough.
    """
    n, length, most = len(residual), 1, 1.0
    variance = float(residual @ residual) / n
    while n // length >= 16 and variance > 0.0:
        means = residual[: n - n % length].reshape(-1, length).mean(1)
        most = max(most, length * float(means @ means) / len(means) / variance)
        length *= 2
    return most


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
        return self.follows and self.sd < WORST_AXES_SD

    @property
    def angle(self) -> float:
        """By how much the magnetometer is turned against the gyros, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def axes_of(blocks: Iterable[SampleBlock], model: MagnetometerModel) -> Axes | None:
    """Return the axes of a magnetometer that is calibrated; None where the gyros do not determine them.

    Slots count whose turn is known from the end of the one before.
    """
    gatherer = SlotGatherer(6, SLOT_NS, turns=True)
    slots = [
        gatherer.process(block["device_time_ns"], block["segment"], np.hstack([gyro, mag]))
        for block in blocks
        if (gyro := block.gyro) is not None and (mag := block.mag) is not None and "device_time_ns" in block
    ]
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

    `field`, `rate` (n, 2, 3): field over its strength and rate of turn, rad/s, before and after each turn.
    `rotation`, `by_bias` (n, 3, 3): from the axes after a turn to those before, and its angle by a bias of
        the gyros, s.
    `noise`: scatter of the field over its strength.
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
    follows = variance < MOST_UNFOLLOWED * went or variance < (BEYOND * noise) ** 2
    # A field that differs from place to place, and errors that go with the turns, are not white.
    slower = max(slower_than_white(axis) for axis in left.reshape(-1, 3).T)
    covariance = variance * slower * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    sd = float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    found = Rotation.from_rotvec(solved.x[:3]).as_matrix() @ way
    return Axes(found, float(np.hypot(sd, GYRO_SCALE)), follows)


def doubts(model: MagnetometerModel, axes: Axes | None, source: str) -> list[str]:
    """Return warnings about a calibration.

    Raises BAD_DATA where the magnetometer has other axes than the gyros.
    """
    found, (low, high) = list[str](), EARTH_UT
    if model.unit == "uT" and not 0.5 * low < model.field < 2.0 * high:
        what = f"the field is {model.field:.3g} uT strong, that of the earth {low:g} to {high:g}"
        found.append(f"{what}: is the unit right? 1 gauss is 100 uT")
    if axes is not None and not axes.follows:
        what = "the field did not go as the gyros turned, in any axes"
        return [*found, f"{what}, which are not checked: are unit and axes of the gyros right?"]
    if axes is None or not axes.is_significant:
        return found
    if axes.way:
        what = f"the magnetometer has not the gyros' axes: their x, y, z are its {named(WAYS[axes.way])}"
        raise bad_data(
            f"{source}: {what}",
            "name the columns of mag in this order in the map or device file, and reverse what has a minus "
            "(in a device file by a negative scale); turns do not show which of the two it is: north of the "
            "magnetic equator the field must point down",
        )
    if axes.angle >= SIGMAS * axes.sd:
        turned = f"{np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against the gyros"
        what = f"the magnetometer is turned by {turned}, which the model file does not hold"
        found.append(f"{what}: headings are off by up to as much, and more where the field is steep")
    return found


def named(way: FloatArray) -> str:
    """Return which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    names = [[f"{sign:+.0f}"[0] + "xyz"[axis] for sign, axis in zip(of, axes, strict=True)] for of in both]
    return " or ".join(map(", ".join, names))
