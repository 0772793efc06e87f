"""Hard and soft iron from readings in many directions: the ellipsoid that they lie on.

A closed form begins (least squares of a quadric whose trace is fixed, in units in which the readings are of
size one); least squares then fit the strength of the field::

    r_k = |A (m_k - b)| - F,    A symmetric, det A = 1

The covariance is that of least squares, with the scatter that is left, times how much slower than white it
is: a field that differs from place to place does not average as noise does.  Where the two halves of the
turns contradict each other, by a current that was switched on meanwhile, half their difference is added.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.errors import bad_data
from imumon.models.magnetometer import MagnetometerModel

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


@dataclass(frozen=True, slots=True, eq=False)
class MagnetometerFit:
    """A calibration, and what it was made of."""

    model: MagnetometerModel
    readings: FloatArray
    field: FloatArray
    """As sent, and corrected, (n, 3); the readings that counted."""
    residual_before: float
    """Scatter of the strength as sent, in the same unit."""

    @property
    def doubts(self) -> list[str]:
        """Warnings beside it."""
        strength, (low, high) = self.model.field, EARTH_UT
        if self.model.unit != "uT" or 0.5 * low < strength < 2.0 * high:
            return []
        return [
            f"the field is {strength:.3g} uT strong, that of the earth {low:g} to {high:g}: is the unit "
            "right? 1 gauss is 100 uT"
        ]


def fit_magnetometer(blocks: Iterable[SampleBlock], unit: str, source: str) -> MagnetometerFit:
    """Fit hard and soft iron to the magnetometer of samples.

    Raises BAD_DATA when there is no magnetometer, too little was turned, or the readings are on no ellipsoid;
    it states which share of the directions was measured, and what to turn next.

    Parameters
    ----------
    unit : str
        Of the readings.
    source : str
        Name for messages.
    """
    found = [
        np.column_stack([mag, np.full_like(mag, np.nan) if block.accel is None else block.accel])
        for block in blocks
        if (mag := block.mag) is not None
    ]
    both = np.concatenate([np.empty((0, 6)), *found])
    both = both[np.isfinite(both[:, :3]).all(1)]
    if not len(both):
        raise bad_data(f"{source}: there is no magnetometer", "needs mag_x, mag_y, mag_z")
    mag, accel = both[:, :3], both[:, 3:]
    centre, matrix = _closed_form(mag) if len(mag) >= LEAST_POINTS else (mag.mean(0), np.eye(3))
    which = _spread((mag - centre) @ matrix)
    readings = mag[which]
    directions = _unit((readings - centre) @ matrix)
    coverage, seen = covered(directions)
    what = f"{coverage:.0%} of the directions were measured, {LEAST_COVERAGE:.0%} are needed"
    up = accel[which]
    if len(which) >= LEAST_POINTS and coverage >= LEAST_COVERAGE:
        model = _fitted(readings, unit, coverage)
        left, known = (model.residual_sd / model.field, model.fit_sd / model.field) if model else (1.0, 1.0)
        if model is not None and known <= WORST_SD and left <= MOST_LEFT:
            strength = np.linalg.norm(readings, axis=1)
            return MagnetometerFit(model, readings, model.corrected(readings), float(strength.std()))
        # The directions of the field are not known then: those of gravity show what is missing.
        directions = up = _unit(accel[np.isfinite(accel).all(1)])
        share, seen = covered(up)
        what = f"the readings lie on no ellipsoid; gravity was in {share:.0%} of the directions"
        if model is not None:
            what = (
                f"the readings leave {left:.1%} of the field beside an ellipsoid, and hard and soft iron are"
                f" known to {known:.1%}; gravity was in {share:.0%} of the directions"
            )
    advice = "away from iron and cables, draw figure-eights while turning the unit over"
    raise bad_data(f"{source}: {what}", f"{advice}; next: {_next(seen, directions, up)}")


def covered(directions: FloatArray) -> tuple[float, FloatArray]:
    """Return the share of all directions that unit vectors, (n, 3), were in, and which cells, (CELLS,)."""
    counts = np.bincount(np.argmax(directions @ MIDDLES.T, axis=1), minlength=CELLS)
    return float(np.mean(counts > 0)), np.asarray(counts > 0, np.float64)


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _spread(vectors: FloatArray) -> list[int]:
    """Return the rows whose direction differs by `STEP_RAD` from the last that was taken."""
    rows, last, least = list[int](), np.zeros(3), float(np.cos(STEP_RAD))
    for k, direction in enumerate(_unit(vectors)):
        if direction @ last < least:
            rows.append(k)
            last = direction
    return rows


def _closed_form(readings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return centre and matrix of the quadric of least squares; of a sphere where that is no ellipsoid."""
    middle = 0.5 * (readings.max(0) + readings.min(0))
    size = float(np.linalg.norm(readings - middle, axis=1).mean())
    x, y, z = ((readings - middle) / size).T
    # u'Qu + 2 q'u = 1 with the trace of Q as the right side: any ellipsoid has one.
    design = np.column_stack(
        [x * x + y * y - 2 * z * z, x * x + z * z - 2 * y * y, 2 * x * y, 2 * x * z, 2 * y * z,
         2 * x, 2 * y, 2 * z, np.ones_like(x)]
    )  # fmt: skip
    a, b, c, d, e, *linear, constant = np.linalg.lstsq(design, x * x + y * y + z * z, rcond=None)[0]
    quadric = np.array([[a + b - 1, c, d], [c, a - 2 * b - 1, e], [d, e, b - 2 * a - 1]])
    centre = -np.linalg.solve(quadric, np.array(linear))
    level = centre @ quadric @ centre - constant
    values, vectors = np.linalg.eigh(quadric / level)
    if not (values > 0.0).all():
        return middle, np.eye(3) / size
    matrix = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    return middle + size * centre, matrix / size


def _left(parameters: FloatArray, readings: FloatArray) -> FloatArray:
    """Return |A (m - b)| - 1, (n,)."""
    return np.asarray(np.linalg.norm((readings - parameters[:3]) @ _symmetric(parameters[3:]), axis=1) - 1.0)


def _symmetric(triangle: FloatArray) -> FloatArray:
    matrix = np.zeros((3, 3))
    matrix[TRIANGLE] = triangle
    return np.asarray(matrix + np.triu(matrix, 1).T)


def _fitted(readings: FloatArray, unit: str, coverage: float) -> MagnetometerModel | None:
    """Return the model, in the unit of the readings, with standard deviations; None where there is none."""
    from scipy.optimize import least_squares

    centre, matrix = _closed_form(readings)
    start = np.concatenate([centre, matrix[TRIANGLE]])
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
        coverage=coverage,
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
    return np.asarray(np.outer(differ, differ) / 4.0 * beyond)


def slower_than_white(residual: FloatArray) -> float:
    """Return by how much the variance of means of neighbours exceeds that of white noise, at least 1.

    The largest over lengths of means from 1 to a sixteenth of all: of those there are enough.
    """
    n, most, length = len(residual), 1.0, 1
    variance = float(residual @ residual) / n
    while n // length >= 16 and variance > 0.0:
        means = residual[: n - n % length].reshape(-1, length).mean(1)
        most = max(most, length * float(means @ means) / len(means) / variance)
        length *= 2
    return most


def _next(seen: FloatArray, directions: FloatArray, accel: FloatArray) -> str:
    """Return which side of the unit should point along the field, where most is missing."""
    missing = (1.0 - seen) @ MIDDLES
    axis = int(np.argmax(np.abs(missing)))
    side = f"turn the {'-' if missing[axis] < 0.0 else '+'}{'xyz'[axis]} axis"
    vertical = (directions * accel).sum(1)
    if not np.isfinite(vertical).any():
        return f"{side} along the magnetic field"
    # The specific force points up, and the field of the northern hemisphere down.
    return f"{side} {'down' if np.nanmean(vertical) < 0.0 else 'up'}, and around there"
