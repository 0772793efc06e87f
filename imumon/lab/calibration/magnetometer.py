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
TRIANGLE = np.triu_indices(3)

_WAYS = Rotation.create_group("O").as_matrix().round() + 0.0  # no negative zeros
WAYS: FloatArray = _WAYS[np.argsort(-np.trace(_WAYS, axis1=1, axis2=2), kind="stable")]
"""The rotations that turn axes into axes, the identity first, (24, 3, 3)."""
LEAST_SLOTS = 20
"""For seven numbers and what is left over: ten seconds of turns."""


class MagnetometerFit(NamedTuple):
    """A calibration, and what it was made of: the readings as sent that counted, (n, 3), and the scatter of
    the strength as sent, in their unit."""

    model: MagnetometerModel
    readings: FloatArray
    residual_before: float


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
        if len(which) < LEAST_POINTS:
            model = None
            break
        model, what = _fitted(readings, middle, unit), f"the {len(which)} readings are on no ellipsoid"
        if not model:
            break
        field = model.corrected(mag)
    if model:
        left, known = model.residual_sd / model.field, model.fit_sd / model.field
        # 1 % makes an error of 0.6° of the heading where the field is level, of 1.5° in Europe; what scatters
        # by more than 10 % is another field at every place.
        if known <= 0.01 and left <= 0.1 and model.coverage >= LEAST_COVERAGE:
            return MagnetometerFit(model, readings, np.linalg.norm(readings, axis=1).std())
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
        axis = np.argmax(np.abs(missing))
        advice += (
            f"; next: turn the {'-' if missing[axis] < 0.0 else '+'}{'xyz'[axis]} axis up, and around there"
        )
    raise bad_data(f"{source}: {what}", advice)


def covered(directions: FloatArray) -> BoolArray:
    """Return the cells that vectors of any length, (n, 3), were in, (CELLS,)."""
    return np.bincount(np.argmax(directions @ MIDDLES.T, axis=1), minlength=CELLS) > 0


def _spread(field: FloatArray) -> list[int]:
    """Return the rows whose direction differs by 1° from the last that was taken: rest weighs no more."""
    rows, last, least = list[int](), np.zeros(3), np.cos(np.radians(1.0))
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
    size = np.linalg.norm(readings - middle, axis=1).mean()
    start = np.concatenate([middle, np.eye(3)[TRIANGLE] / size])
    solved = least_squares(_left, start, args=(readings,), x_scale="jac", method="lm")
    parameters, jacobian, residual = solved.x, solved.jac, solved.fun
    matrix = _symmetric(parameters[3:])
    if not solved.success or np.linalg.eigvalsh(matrix).min() <= 0.0:
        return None
    variance = residual @ residual / (len(residual) - len(parameters))
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
    # A square of nine normal differences is larger than thrice its mean once in 700 times.
    beyond = max(0.0, 1.0 - len(differ) * 3.0 / max(square, 1e-300))
    return np.outer(differ, differ) / 4.0 * beyond


def slower_than_white(residual: FloatArray) -> float:
    """Return by how much the variance of means of neighbours exceeds that of white noise, at least 1.

    The largest over lengths of means from 1 to a sixteenth of all: of those there are enough.
    """
    n, length, most = len(residual), 1, 1.0
    variance = residual @ residual / n
    while n // length >= 16 and variance > 0.0:
        means = residual[: n - n % length].reshape(-1, length).mean(1)
        most = max(most, length * (means @ means) / len(means) / variance)
        length *= 2
    return most


class Axes(NamedTuple):
    """The rotation from the magnetometer's axes to the gyros', (3, 3), the standard deviation of its angle,
    rad, and whether the field went as the gyros turned, in these axes."""

    rotation: FloatArray
    sd: float
    follows: bool

    @property
    def way(self) -> int:
        """Which of `WAYS` is next to it."""
        return int(np.einsum("kij,ij->k", WAYS, self.rotation).argmax())

    @property
    def is_significant(self) -> bool:
        """Whether the gyros determine which axes these are: they are 90° apart, known to 10°."""
        return self.follows and self.sd < np.radians(10.0)

    @property
    def angle(self) -> float:
        """By how much the magnetometer is turned against the gyros, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def axes_of(blocks: Iterable[SampleBlock], model: MagnetometerModel) -> Axes | None:
    """Return the axes of a magnetometer that is calibrated; None where the gyros do not determine them.

    Slots count whose turn is known from the end of the one before, with a variance by missing samples below
    0.01 rad².
    """
    # In half a second a hand turns a unit by tenths of a radian, and by less than half a circle.
    gatherer = SlotGatherer(6, 500_000_000, turns=True)
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
    known &= (uncertain[1:] < 0.01) & np.isfinite(last[1:] + last[:-1]).all(1)
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

    way = min(WAYS, key=lambda one: (residual(np.zeros(7), one) ** 2).sum())
    solved = least_squares(residual, np.zeros(7), args=(way,), x_scale="jac", method="lm")
    left, jacobian = solved.fun, solved.jac
    variance = left @ left / (len(left) - 7)
    went = ((field[:, 1] - field[:, 0]) ** 2).sum() / len(left)
    # What is left beyond a quarter of how the field went, and beyond three times what the fit of its strength
    # left, has not gone as the gyros turned, in any axes.
    follows = variance < 0.25 * went or variance < (3.0 * noise) ** 2
    # A field that differs from place to place, and errors that go with the turns, are not white.
    slower = max(slower_than_white(axis) for axis in left.reshape(-1, 3).T)
    covariance = variance * slower * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    sd = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    found = Rotation.from_rotvec(solved.x[:3]).as_matrix() @ way
    # Of gyros without calibration each element of scale and misalignment is 0.01, as in `AttitudeParameters`:
    # what is fitted to them is known to no better, rad.
    return Axes(found, np.hypot(sd, 0.01), follows)


def doubts(model: MagnetometerModel, axes: Axes | None, source: str) -> list[str]:
    """Return warnings about a calibration.

    Raises BAD_DATA where the magnetometer has other axes than the gyros.
    """
    found = list[str]()
    low, high = 22.0, 67.0  # from Paraguay to Siberia (IGRF-13); in a house half or twice that
    if model.unit == "uT" and not 0.5 * low < model.field < 2.0 * high:
        found.append(
            f"the field is {model.field:.3g} uT strong, that of the earth {low:g} to {high:g}: is the unit"
            " right? 1 gauss is 100 uT"
        )
    if axes and not axes.follows:
        return [
            *found,
            "the field did not go as the gyros turned, in any axes, which are not checked: are unit and axes"
            " of the gyros right?",
        ]
    if not axes or not axes.is_significant:
        return found
    if axes.way:
        raise bad_data(
            f"{source}: the magnetometer has not the gyros' axes: their x, y, z are its"
            f" {named(WAYS[axes.way])}",
            "name the columns of mag in this order in the map or device file, and reverse what has a minus "
            "(in a device file by a negative scale); turns do not show which of the two it is: north of the "
            "magnetic equator the field must point down",
        )
    if axes.angle >= 4.0 * axes.sd:
        found.append(
            f"the magnetometer is turned by {np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against"
            " the gyros, which the model file does not hold: headings are off by up to as much, and more"
            " where the field is steep"
        )
    return found


def named(way: FloatArray) -> str:
    """Return which axes of the magnetometer the gyros' x, y, z are by one of `WAYS`, and by its reverse."""
    axes = np.abs(way).argmax(axis=1)
    signs = np.sign(way[range(3), axes])
    both = sorted((signs, -signs), key=lambda of: -of.sum())
    names = [[f"{sign:+.0f}"[0] + "xyz"[axis] for sign, axis in zip(of, axes, strict=True)] for of in both]
    return " or ".join(map(", ".join, names))
