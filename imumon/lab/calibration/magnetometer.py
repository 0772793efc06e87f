"""Hard and soft iron from readings in many directions, and whether a magnetometer has the gyros' axes.

With b the hard iron, and W = A / F of the soft iron A and the strength F of the field, least squares fit the
readings m_k to a sphere of radius 1::

    r_k = |W (m_k - b)| - 1,    A symmetric, det A = 1,    so F = det(W)^(-1/3)

The covariance is that of least squares, with the variance of the residuals, times how much slower than white
they are: a field that differs from place to place does not average as noise does.  Where the two halves of
the turns contradict each other, by a current that was switched on meanwhile, half their difference is added.

The axes: the field stays where it is while the unit turns.  With C the gyros' turn from one moment to a later
one, and P the matrix that takes the magnetometer's axes to the gyros'::

    P field_0 = C P field_1

Of the 24 rotations that turn axes into axes the one is taken with the least residual; that of P and -P is the
same, as no turn shows whether a magnetometer has the field or its reverse.  From there least squares find the
rotation, with what else may be between the two: a constant bias of the gyros and a time by which the
magnetometer is late.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.errors import ImumonError, bad_data
from imumon.filters.slots import SlotGatherer
from imumon.filters.turns import PAUSE_S
from imumon.models.model import MagnetometerModel
from imumon.recordings.map import triple

# Directions are counted in so many cells of equal area, each about 30° wide.  Their middles, (CELLS, 3), are
# on a spiral: equal steps of z are equal areas, and the longitude goes on by 2 pi times the golden ratio.
CELLS = 60
_STEP = np.arange(CELLS) + 0.5
_LONGITUDE = np.pi * (1.0 + np.sqrt(5.0)) * _STEP
_Z = 1.0 - 2.0 * _STEP / CELLS
_RADIUS = np.sqrt(1.0 - _Z**2)
MIDDLES = np.column_stack([_RADIUS * np.cos(_LONGITUDE), _RADIUS * np.sin(_LONGITUDE), _Z])
LEAST_COVERAGE = 0.5  # of the cells.  With points on one side an ellipsoid's far side is extrapolated.
LEAST_POINTS = 100  # for nine numbers and their residual.  Assumed.
MOST_SD = 0.01  # of the field: an error of the heading of 0.6° where the field is level, of 1.5° in Europe
MOST_RESIDUAL = 0.1  # of the field: what scatters by more is another field at every place
MOST_CHI_SQUARE = 27.0  # of nine numbers that only scatter it is 9 on average, and more once in 700 times

# An axis map is a rotation that turns axes into axes.  The identity is first, (24, 3, 3); no zero is -0.
AXIS_MAPS: FloatArray = np.array(
    sorted(Rotation.create_group("O").as_matrix().round() + 0.0, key=lambda axis_map: -np.trace(axis_map))
)
LEAST_SLOTS = 20  # for seven numbers and their residual: ten seconds of turns.  Assumed.


class MagnetometerFit(NamedTuple):
    """A calibration, and what it was made of, in the unit of the readings."""

    model: MagnetometerModel
    readings: FloatArray  # those that counted, as sent, (n, 3)
    residual_before: float  # scatter of their strength


def fit_magnetometer(blocks: Iterable[SampleBlock], unit: str, source: str) -> MagnetometerFit:
    """Fit hard and soft iron to the magnetometer of samples.

    Raises BAD_DATA when there is no magnetometer, too little was turned, or the readings are on no ellipsoid;
    it states which share of the directions was measured, and what to turn next.

    `unit` is that of the readings, `source` their name in messages.
    """
    parts = [np.empty((0, 6))]  # for samples without any magnetometer
    for block in blocks:
        rows = block.stacked((*triple("mag"), *triple("accel")))  # gravity is for the advice of `_error`
        parts.append(rows[np.isfinite(rows[:, :3]).all(axis=1)])
    mag, accel = np.hsplit(np.concatenate(parts), 2)
    if not len(mag):
        raise bad_data(f"{source}: there is no magnetometer", "needs mag_x, mag_y, mag_z")
    middle = 0.5 * (mag.max(0) + mag.min(0))
    field = mag - middle  # of directions that hard and soft iron still distort
    for _ in range(2):  # the second time by the directions of the corrected field
        readings = mag[_spread(field)]
        if len(readings) < LEAST_POINTS:
            raise _error(
                source, f"{len(readings)} readings in other directions, {LEAST_POINTS} are needed", accel
            )
        if (fitted := _fitted(readings, middle, unit)) is None:
            raise _error(source, f"the {len(readings)} readings are on no ellipsoid", accel)
        model = fitted
        field = model.corrected(mag)
    residual, sd = model.residual_sd / model.field, model.fit_sd / model.field
    if sd <= MOST_SD and residual <= MOST_RESIDUAL and model.coverage >= LEAST_COVERAGE:
        return MagnetometerFit(model, readings, np.linalg.norm(readings, axis=1).std())
    raise _error(
        source,
        f"{model.coverage:.0%} of the directions were measured, {LEAST_COVERAGE:.0%} are needed;"
        f" {residual:.1%} of the field is left, and hard and soft iron are known to {sd:.1%}",
        accel,
    )


def _error(source: str, what: str, accel: FloatArray) -> ImumonError:
    # The directions of the field are hardly known then: those of gravity show what is missing.
    advice = "away from iron and cables, draw figure-eights while turning the unit over"
    if len(up := accel[np.isfinite(accel).all(1)]):
        measured = covered(up)
        what += f"; gravity was in {measured.mean():.0%} of the directions"
        missing = ~measured @ MIDDLES  # the sum of the directions without a reading: where most of them are
        axis = np.argmax(np.abs(missing))
        sign = "-" if missing[axis] < 0.0 else "+"
        advice += f"; next: turn the {sign}{'xyz'[axis]} axis up, and around there"
    return bad_data(f"{source}: {what}", advice)


def covered(directions: FloatArray) -> BoolArray:
    """Return the cells that vectors of any length, (n, 3), were in, (CELLS,)."""
    return np.bincount(np.argmax(directions @ MIDDLES.T, axis=1), minlength=CELLS) > 0


def _spread(field: FloatArray) -> list[int]:
    """Return the rows whose direction is 1° from the last one taken: rest counts no more than motion."""
    rows, last = list[int](), np.zeros(3)
    cos_same = np.cos(np.radians(1.0))  # assumed
    with np.errstate(invalid="ignore"):  # where there is no field there is no direction
        directions = field / np.linalg.norm(field, axis=1, keepdims=True)
    for k, direction in enumerate(directions):
        if direction @ last < cos_same:
            rows.append(k)
            last = direction
    return rows


def _symmetric(triangle: FloatArray) -> FloatArray:
    # Of upper triangles row by row, (..., 6), the symmetric matrices, (..., 3, 3).
    return triangle[..., [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


def _residual(parameters: FloatArray, readings: FloatArray) -> FloatArray:
    """Return |W (m - b)| - 1, (n,), by b and the upper triangle of W, (9,)."""
    return np.asarray(np.linalg.norm((readings - parameters[:3]) @ _symmetric(parameters[3:]), axis=1) - 1.0)


def _fitted(readings: FloatArray, middle: FloatArray, unit: str) -> MagnetometerModel | None:
    """Return the model, in the unit of the readings, with standard deviations; None where there is none.

    `middle`, (3,): of the sphere from which the fit begins.
    """
    size = np.linalg.norm(readings - middle, axis=1).mean()
    start = np.concatenate([middle, np.eye(3)[np.triu_indices(3)] / size])
    solved = least_squares(_residual, start, args=(readings,), x_scale="jac", method="lm")
    parameters, jacobian, residual = solved.x, solved.jac, solved.fun
    w = _symmetric(parameters[3:])
    if not solved.success or np.linalg.eigvalsh(w).min() <= 0.0:
        return None
    variance = residual @ residual / (len(residual) - len(parameters))
    scatter = variance * slower_than_white(residual)
    inverse = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    covariance = inverse * scatter + _covariance_of_change(jacobian, residual, scatter)
    field = float(np.linalg.det(w)) ** (-1.0 / 3.0)
    # By each element of the triangle, (6, 3, 3): A = F W has dA = F dW + dF W, and F = det(W)^(-1/3) has
    # dF = -F/3 trace(dW W^-1), by Jacobi's formula.
    dw = _symmetric(np.eye(6))
    trace = np.einsum("kij,ji->k", dw, np.linalg.inv(w))[:, None, None]
    da = field * (dw - trace / 3.0 * w)
    return MagnetometerModel(
        unit=unit,
        hard_iron=parameters[:3].tolist(),
        hard_iron_sd=np.sqrt(np.diag(covariance)[:3]).tolist(),
        soft_iron=(field * w).tolist(),
        soft_iron_sd=np.sqrt(np.einsum("kij,kl,lij->ij", da, covariance[3:, 3:], da)).tolist(),
        field=field,
        residual_sd=field * float(np.sqrt(variance)),
        coverage=float(covered((readings - parameters[:3]) @ w).mean()),
    )


def _covariance_of_change(jacobian: FloatArray, residual: FloatArray, scatter: float) -> FloatArray:
    """Return the covariance, (9, 9), by what has changed between the halves of the turns.

    It is the square of half their difference, times the share of its chi-square beyond what scatter explains.
    """
    halves = np.array_split(np.arange(len(residual)), 2)
    inverses = [np.linalg.pinv(jacobian[rows].T @ jacobian[rows], hermitian=True) for rows in halves]
    # A Gauss-Newton step by each half alone, from the solution by both; its sign is lost in the square.
    first, second = (
        inverse @ jacobian[rows].T @ residual[rows] for inverse, rows in zip(inverses, halves, strict=True)
    )
    difference = first - second
    covariance = scatter * inverses[0] + scatter * inverses[1]
    chi_square = float(difference @ np.linalg.pinv(covariance, hermitian=True) @ difference)
    if chi_square <= MOST_CHI_SQUARE:
        return np.zeros((9, 9))
    return (1.0 - MOST_CHI_SQUARE / chi_square) * np.outer(difference, difference) / 4.0


def slower_than_white(residual: FloatArray) -> float:
    """Return the factor by which the variance of means of neighbours exceeds that of white noise.

    It is the largest over means of 1, 2, 4 and so on as long as there are 16 (assumed): at least 1.
    """
    n, length, most = len(residual), 1, 1.0
    variance = residual @ residual / n
    while n // length >= 16 and variance > 0.0:
        means = residual[: n - n % length].reshape(-1, length).mean(1)
        most = max(most, length * (means @ means) / len(means) / variance)
        length *= 2
    return most


class MagnetometerAxes(NamedTuple):
    """Where the magnetometer's axes are against the gyros'."""

    rotation: FloatArray  # P, from its axes to theirs, (3, 3)
    sd: float  # standard deviation of its angle, rad
    follows: bool  # whether the field went as the gyros turned, in these axes

    @property
    def nearest(self) -> int:
        """Index of the nearest of `AXIS_MAPS`."""
        return int(np.einsum("kij,ij->k", AXIS_MAPS, self.rotation).argmax())

    @property
    def is_significant(self) -> bool:
        """Whether the gyros determine which axes these are: they are 90° apart, known to 10°."""
        return self.follows and self.sd < np.radians(10.0)

    @property
    def angle(self) -> float:
        """By how much the magnetometer is turned against the gyros, rad."""
        return float(np.arccos(np.clip(0.5 * (np.trace(self.rotation) - 1.0), -1.0, 1.0)))


def axes_of(blocks: Iterable[SampleBlock], model: MagnetometerModel) -> MagnetometerAxes | None:
    """Return the axes of a magnetometer that is calibrated; None where the gyros do not determine them."""
    # The last slot is not finished: there are enough.
    # In half a second, here in ns, a hand turns a unit by tenths of a radian, and by less than half a circle.
    gatherer = SlotGatherer(6, 500_000_000, turns=True)
    slots = [
        gatherer.process(block["device_time_ns"], block["segment"], np.hstack([block.gyro, block.mag]))
        for block in blocks
        if block.gyro is not None and block.mag is not None and "device_time_ns" in block
    ]
    if not slots:
        return None
    # Turn k is from the end of slot k to that of slot k + 1; before the first slot there is none.
    turns = [turn for part in slots for turn in part.turns][1:]
    # The last value of a magnetometer slower than the gyros is older than the slot's end.  `late_s` of
    # `fitted_axes` takes up the mean age; by how much it differs from slot to slot is part of the residual.
    last = np.concatenate([part.last for part in slots])
    end_ns = np.concatenate([part.end_ns for part in slots])
    begins = np.concatenate([part.begins for part in slots])
    seconds = np.array([turn.seconds for turn in turns])
    # Coning and fast motion are standard deviations, rad; what samples are missing is a variance.
    variance = np.array([turn.coning @ turn.coning + turn.fast**2 + turn.missed for turn in turns])
    is_continuous = ~begins[1:] & (np.abs(1e-9 * np.diff(end_ns) - seconds) < PAUSE_S)
    is_complete = np.isfinite(last).all(1)
    # Turns that are known to 6°, 0.01 rad², between slots that have gyros and field.  Assumed.
    known = np.flatnonzero(is_complete[1:] & is_complete[:-1] & is_continuous & (variance < 0.01))
    if len(known) < LEAST_SLOTS:
        return None
    both = np.column_stack([known, known + 1])  # slots before and after the turn
    field, rate = model.corrected(last[:, 3:]) / model.field, last[:, :3]
    return fitted_axes(
        field[both],
        rate[both],
        rotation=np.array([turns[k].rotation for k in known]),
        by_bias=np.array([turns[k].by_bias for k in known]),
        noise=model.residual_sd / model.field,
    )


def fitted_axes(
    field: FloatArray, rate: FloatArray, rotation: FloatArray, by_bias: FloatArray, noise: float
) -> MagnetometerAxes:
    """Return the axes of a magnetometer by n turns of the gyros.

    `field`, `rate` (n, 2, 3): field over its strength and rate of turn, rad/s, before and after each turn.
    `rotation`, `by_bias` (n, 3, 3): from the axes after a turn to those before, and its angle by a bias of
        the gyros, s.
    `noise`: scatter of the field over its strength.
    """

    def residual(x: FloatArray, axis_map: FloatArray) -> FloatArray:
        # Of the fields, (3n,), by rotation from `axis_map`, bias and lateness, (7,).
        # A field that is late by tau is off by tau times its rate, -rate x field.
        bias, late_s = x[3:6], x[6]
        in_body = field @ (Rotation.from_rotvec(x[:3]).as_matrix() @ axis_map).T
        on_time = in_body - late_s * np.cross(rate - bias, in_body)
        before, after = on_time.swapaxes(0, 1)
        turned = np.einsum("nij,nj->ni", rotation, after)
        return np.asarray(before - Rotation.from_rotvec(-by_bias @ bias).apply(turned)).reshape(-1)

    axis_map = min(AXIS_MAPS, key=lambda one: (residual(np.zeros(7), one) ** 2).sum())
    solved = least_squares(residual, np.zeros(7), args=(axis_map,), x_scale="jac", method="lm")
    error, jacobian = solved.fun, solved.jac
    variance = error @ error / (len(error) - 7)
    change = ((field[:, 1] - field[:, 0]) ** 2).sum() / len(error)
    # The field followed where less than half of its change is left (rms), or less than three times the noise.
    # Assumed.
    follows = variance < 0.25 * change or variance < (3.0 * noise) ** 2
    # A field that differs from place to place, and errors that go with the turns, are not white.
    slower = max(slower_than_white(axis) for axis in error.reshape(-1, 3).T)
    covariance = variance * slower * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    sd = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])
    to_gyros = Rotation.from_rotvec(solved.x[:3]).as_matrix() @ axis_map
    # Nor is the angle known better than the gyros' scale and misalignment, which are 0.01 (rad) without
    # calibration, as in `AttitudeParameters`.
    return MagnetometerAxes(to_gyros, np.hypot(sd, 0.01), follows)


def doubts(model: MagnetometerModel, axes: MagnetometerAxes | None, source: str) -> list[str]:
    """Return warnings about a calibration.

    Raises BAD_DATA where the magnetometer has other axes than the gyros.
    """
    warnings = list[str]()
    low, high = 22.0, 67.0  # from Paraguay to Siberia (IGRF-13); in a house half or twice that
    if model.unit == "uT" and not 0.5 * low < model.field < 2.0 * high:
        warnings.append(
            f"the field is {model.field:.3g} uT strong, that of the earth {low:g} to {high:g}: is the unit"
            " right? 1 gauss is 100 uT"
        )
    if axes and not axes.follows:
        warnings.append(
            "the field did not go as the gyros turned, in any axes, which are not checked: are unit and axes"
            " of the gyros right?"
        )
    if not axes or not axes.is_significant:
        return warnings
    if axes.nearest != 0:  # the first of `AXIS_MAPS` is the identity
        raise bad_data(
            f"{source}: the magnetometer has not the gyros' axes: their x, y, z are its"
            f" {axis_map_as_text(AXIS_MAPS[axes.nearest])}",
            "name the columns of mag in this order in the map or device file, and reverse what has a minus "
            "(in a device file by a negative scale); turns do not show which of the two it is: north of the "
            "magnetic equator the field must point down",
        )
    if axes.angle >= 4.0 * axes.sd:  # assumed
        warnings.append(
            f"the magnetometer is turned by {np.degrees(axes.angle):.1f} ± {np.degrees(axes.sd):.1g}° against"
            " the gyros, which the model file does not hold: headings are off by up to as much, and more"
            " where the field is steep"
        )
    return warnings


def axis_map_as_text(axis_map: FloatArray) -> str:
    """Return which axes of the magnetometer the gyros' x, y, z are, by an axis map and by its reverse."""
    axes = np.abs(axis_map).argmax(axis=1)
    signs = axis_map.sum(axis=1)  # a row has one element, 1 or -1, and zeros
    names = [
        ", ".join(("+" if sign > 0.0 else "-") + "xyz"[axis] for sign, axis in zip(row, axes, strict=True))
        for row in (signs, -signs)
    ]
    return " or ".join(names if signs.sum() > 0.0 else reversed(names))  # first that of more plus
