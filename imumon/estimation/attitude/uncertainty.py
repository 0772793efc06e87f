"""How far the attitude may be off: tilt by what the accelerometers may be, heading by what the gyros may be.

At rest the specific force shows the vertical but for the accelerometers' error, and the filter may still be
on its way there.  In motion the filter takes accelerations for gravity, nobody knows how much; but
the gyros have carried the vertical of the last rest along, with errors that are known.  So::

    tilt²     = (accelerometer / g)² + turned² + (filter's up less the gyros' up)²
    turned    = ∫ C (bias + M ω) dt since the last rest, the bias and the matrix M of scale and misalignment
                staying as they are, and what is lost between samples (`imumon.filters.turns`)
    heading²  = their parts about the vertical: what accelerations have turned the filter by is one of them

Where the vertical that the gyros carried through a motion is not the one that the accelerometers show after
it, beyond what else may be off, M is as large as that says (least squares over all motions so far).

The gyros' part is judged once a second; until then each sample adds what it may have turned wrong since:
bias, scale, and half an interval of its rate, as a rate may be the mean of the interval before or that of the
moment.  How far filter and gyros are apart is seen at each sample.
Heading is an angle about the vertical as it is taken: a tilt that is off turns the heading of an axis that
rises or falls by its tangent.

A magnetometer that is calibrated ties the heading down: its error over the horizontal field, the tilt times
the tangent of the dip, and what the gyros have added, which the filter forgets with its time constant.  A
field that is not as strong as where it was calibrated is bent by so much at least, in whatever direction.
In a long motion this is a bound: nobody knows how far the accelerometers have kept the tilt better than the
gyros.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.attitude.angles import shortest, times
from imumon.estimation.attitude.fusion import TAU_MAG_S
from imumon.filters.turns import Turn
from imumon.geodesy import STANDARD_GRAVITY

GRAVITY_SPREAD = 0.03
"""m/s²: between equator and poles gravity differs by no more from the standard (WGS-84: 9.780 to 9.832)."""
UP = np.array([0.0, 0.0, 1.0])
UNKNOWN = 1.0
"""Beyond so much, rad, an error is no small angle any more, and its standard deviation says nothing."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard deviations that are known beforehand.

    Parameters
    ----------
    accel : float
        m/s².
    scale : float
        Of the angle turned over itself.
    earth_rate : float
        What of the earth rate the bias does not hold, rad/s.
    magnetometer : float
        Unit of the field; NaN when it is not calibrated.
    field : float
        Its strength where the magnetometer was calibrated.
    """

    accel: float
    scale: float
    earth_rate: float
    magnetometer: float
    field: float


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """A second: its length, and whether it was at rest.

    Parameters
    ----------
    turn : Turn
        How it turned.
    force : array (3,)
        Mean in body axes, m/s²; NaN where there is none.
    mag : array (3,)
        At its end, in the unit of the field.
    bias_sd : array (3,)
        At its end, rad/s; NaN where the bias is not known.
    attitude : array (3, 3)
        At its end, from body axes to level axes.
    levelling : array (4,)
        At its end: as of `Found`.
    ignored : array (3,)
        Turned, by the gyros, while it was taken for at rest, rad.
    north : bool
        Whether the heading is by the magnetometer.
    follows : float
        How fast it follows the field: 1 as usual, 0 not at all.
    """

    seconds: float
    rest: bool
    turn: Turn
    force: FloatArray
    mag: FloatArray
    bias_sd: FloatArray
    attitude: FloatArray
    levelling: FloatArray
    ignored: FloatArray
    north: bool
    follows: float


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What samples turned, each since the one before, or running sums of that; (n, 3) and (n,).

    Parameters
    ----------
    angle : array (n, 3)
        In motion, about the body axes, rad.
    ignored : array (n, 3)
        By the gyros, while it was taken for at rest, rad: the beginning of a motion may be in it.
    seconds : array (n,)
        In motion.
    """

    angle: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))
    ignored: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))
    seconds: FloatArray = field(default_factory=lambda: np.zeros(1))

    def then(self, later: Motion, part: slice) -> Motion:
        """Return running sums that go on from the last of these, over a part of later samples."""
        return Motion(
            _summed(self.angle, later.angle[part]),
            _summed(self.ignored, later.ignored[part]),
            _summed(self.seconds, later.seconds[part]),
        )


@dataclass(slots=True, eq=False)
class Turned:
    """Error of the angles since some moment, east, north, up, for each error of the gyros that stays.

    Parameters
    ----------
    bias : array (3, 3)
        ∫ C sd dt: by the bias of each gyro, rad.
    scale : array (3, 3, 3)
        ∫ C ω dt: by each element of the matrix of scale and misalignment; what turns back takes it back.
    earth : float
        By the earth rate that the bias does not hold, rad.
    coning : array (3,)
    fast, missed : float
        For want of samples: as of `Turn`.
    """

    bias: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    scale: FloatArray = field(default_factory=lambda: np.zeros((3, 3, 3)))
    earth: float = 0.0
    coning: FloatArray = field(default_factory=lambda: np.zeros(3))
    fast: float = 0.0
    missed: float = 0.0

    def add(self, slot: Slot, errors: Errors) -> None:
        """Add a slot."""
        turn = slot.turn
        begun = slot.attitude @ turn.rotation.T
        self.missed += float(slot.ignored @ slot.ignored)
        self.bias += begun @ turn.by_bias * slot.bias_sd
        self.scale += (begun @ turn.by_scale.reshape(3, 9)).reshape(3, 3, 3)
        self.coning += begun @ turn.coning
        self.fast += turn.fast
        self.missed += turn.missed
        self.earth += errors.earth_rate * slot.seconds

    def forget(self, keep: float) -> None:
        """Keep a share."""
        self.bias *= keep
        self.scale *= keep
        self.earth *= keep
        self.coning *= keep
        self.fast *= keep
        self.missed *= keep * keep

    def variance(self, errors: Errors) -> FloatArray:
        """Return the variance of the angles about east, north and up, rad², (3,)."""
        scale = errors.scale**2 * (self.scale**2).sum((1, 2))
        sampled = self.coning**2 + self.fast**2 + self.missed
        return np.asarray((self.bias**2).sum(1) + scale + self.earth**2 + sampled)


@dataclass(slots=True, eq=False)
class Uncertainty:
    """What has come together since the attitude began.

    Parameters
    ----------
    levelled : array (4,)
        What the levelling would be at the last rest with the vertical that was measured; NaN before one.
    twist, twisted : float
        How far the filter has turned about the vertical against the gyros since that rest, rad, at the end of
        the last slot, and how much of that the heading still has.
    accel_sd : float
        Tilt by the accelerometers, rad.
    since_rest, since_north : Turned
        What the vertical of the last rest has gone through, and the heading since it was last tied down.
    heading_variance : float
        By the bias in the motions before, rad²: each rest measures the bias anew.
    bent : float
        Square of what the field that is followed differs from the calibration's strength, forgotten like it.
    wrong, turned : float
        Sums over motions: square of how far the vertical was carried wrong, less what else may be off, and
        what M of one would have done, rad².
    magnitude : float
        Of the specific force at the last rest, m/s².
    tilt_sd, heading_sd : float
        By accelerometers, gyros and field, rad; NaN where nothing can be said.
    """

    levelled: FloatArray = field(default_factory=lambda: np.full(4, np.nan))
    twist: float = 0.0
    twisted: float = 0.0
    accel_sd: float = math.nan
    since_rest: Turned = field(default_factory=Turned)
    since_north: Turned = field(default_factory=Turned)
    heading_variance: float = 0.0
    bent: float = 0.0
    wrong: float = 0.0
    turned: float = 0.0
    magnitude: float = math.nan
    tilt_sd: float = math.nan
    heading_sd: float = math.nan

    def step(self, slot: Slot, errors: Errors) -> None:
        """Follow one slot."""
        errors = replace(errors, scale=self.scale(errors))
        twist = float(self._apart(slot.levelling[np.newaxis])[1][0])
        self.twisted, self.twist = self.twisted + twist - self.twist, twist
        if slot.rest and np.isfinite(slot.force).all():
            self._come_to_rest(slot, errors)
        elif math.isfinite(self.accel_sd):
            self.since_rest.add(slot, errors)
            self.since_north.add(slot, errors)
        turned = math.sqrt(float(self.since_rest.variance(errors)[:2].mean()))
        self.tilt_sd = _small(math.hypot(self.accel_sd, turned))
        if slot.north:
            self.heading_sd = self._magnetic(slot, errors)
        else:
            self.heading_sd = _small(self._drifted(errors)) if math.isfinite(self.accel_sd) else math.nan

    def scale(self, errors: Errors) -> float:
        """Return the standard deviation of the elements of M: as declared, or what motions have shown."""
        return math.sqrt(max(errors.scale**2, self.wrong / self.turned if self.turned > 0.0 else 0.0))

    def at(self, since: Motion, bias_sd: FloatArray, levelling: FloatArray, errors: Errors) -> FloatArray:
        """Return the variances of tilt and of the turn about the vertical, rad², (2, n).

        Parameters
        ----------
        since : Motion
            Sums since the last slot, n + 1: the first is before the samples.
        bias_sd : array (n, 3)
            rad/s.
        levelling : array (n, 4)
            As of `Found`.
        errors : Errors
        """
        angle, seconds = since.angle, since.seconds[1:]
        added = self.scale(errors) ** 2 * _squares(angle[1:]) + _squares(since.ignored[1:])
        added += _squares(angle[1:] - angle[:-1]) / 12.0  # even chances from none of the interval to all
        if seconds[-1] > 0.0:
            added += np.where(seconds > 0.0, _squares(bias_sd) * seconds**2, 0.0)
        tilted, twist = self._apart(levelling)
        twisted = self.twisted + twist - self.twist
        return np.array([self.tilt_sd**2 + tilted**2, self.heading_sd**2 + twisted**2]) + added

    def _apart(self, levelling: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by how much filter and gyros differ since the last rest, rad: up, and about it; (n,) each."""
        w, x, y, z = times(levelling, self.levelled * [1.0, -1.0, -1.0, -1.0]).T
        off = 2.0 * np.arcsin(np.minimum(np.sqrt(x * x + y * y), 1.0))
        return np.asarray(off), np.asarray(2.0 * np.arctan(z / w))

    def _come_to_rest(self, slot: Slot, errors: Errors) -> None:
        """Take the vertical that the accelerometers show, and close the account of a motion."""
        self.magnitude = float(np.linalg.norm(slot.force))
        contradiction = max(abs(self.magnitude - STANDARD_GRAVITY) - GRAVITY_SPREAD, 0.0)
        self.accel_sd = max(errors.accel, contradiction) / STANDARD_GRAVITY
        # The measured vertical, in the filter's level axes.
        measured = slot.attitude @ slot.force / self.magnitude
        levelled = times(shortest(measured, UP), slot.levelling)
        self._compare(levelled, errors)
        self.levelled = levelled
        drifted = float((self.since_north.bias[2] ** 2).sum()) + self.twisted**2
        if math.isfinite(drifted):
            self.heading_variance += drifted
        self.since_north.bias[:] = 0.0
        self.twist = self.twisted = 0.0
        self.since_rest = Turned()

    def _compare(self, levelled: FloatArray, errors: Errors) -> None:
        """See how far the gyros have carried the vertical wrong through the motion that ends here."""
        turned = float((self.since_rest.scale[:2] ** 2).sum())
        off = float(self._apart(levelled[np.newaxis])[0][0])
        if turned > 0.0 and math.isfinite(off):
            without = replace(errors, scale=0.0)
            other = float(self.since_rest.variance(without)[:2].sum()) + 4.0 * self.accel_sd**2
            self.wrong += max(off**2 - other, 0.0)
            self.turned += turned

    def _drifted(self, errors: Errors) -> float:
        """Return the standard deviation of the heading by the gyros, rad."""
        return math.sqrt(self.heading_variance + float(self.since_north.variance(errors)[2]))

    def _magnetic(self, slot: Slot, errors: Errors) -> float:
        """Return the standard deviation of a heading that follows the magnetometer, rad."""
        strength = math.sqrt(float(slot.mag @ slot.mag))
        # What the gyros have added is forgotten as the filter follows the field.
        keep = math.exp(-slot.follows * slot.seconds / TAU_MAG_S)
        self.since_north.forget(keep)
        self.heading_variance *= keep * keep
        self.twisted *= keep
        if slot.follows:
            self.bent += (1.0 - keep) * ((strength - errors.field) ** 2 - self.bent)
        vertical = float(slot.mag @ slot.attitude[2])
        horizontal = math.sqrt(max(strength**2 - vertical**2, 0.0))
        if not horizontal > 0.0:
            return math.nan
        calibration = math.sqrt(max(errors.magnetometer**2, self.bent))
        tied = math.hypot(calibration, vertical * self.tilt_sd) / horizontal
        return _small(math.hypot(tied, self._drifted(errors)))


def _summed(before: FloatArray, added: FloatArray) -> FloatArray:
    """Return running sums that go on from the last row of others, in the same order whatever the blocks."""
    return np.cumsum(np.concatenate([before[-1:], added]), axis=0)


def _squares(vectors: FloatArray) -> FloatArray:
    """Return the squared lengths of vectors, (n,)."""
    return np.asarray(np.einsum("ni,ni->n", vectors, vectors))


def _small(sd: float) -> float:
    return sd if sd < UNKNOWN else math.nan
