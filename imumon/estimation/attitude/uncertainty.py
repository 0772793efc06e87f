"""How far the attitude may be off: tilt by what the accelerometers may be, heading by what the gyros may be.

At rest the specific force shows the vertical but for the accelerometers' error, and the filter may still be
on its way there.  In motion the filter takes accelerations for gravity, nobody knows how much; but
the gyros have carried the vertical of the last rest along, with errors that are known.  So::

    turned    = ∫ C (bias + M ω) dt since the last rest, the bias and the matrix M of scale and misalignment
                staying as they are, and what is lost between samples (`imumon.filters.turns`)
    apart     = the filter's up less the gyros' up = what it has followed of turned, with its time constant,
                and of accelerations
    tilt²     = (accelerometer / g)² + E (turned - apart)², given what apart is
    heading²  = what turned about the vertical: what accelerations have turned the filter by is one of them

Axes and signs may be mixed up, and then M is no small error.  So in each gyro's column of M scale and
misalignment have one of several sizes each (`sizes.Sizes`): what only reverses an axis hardly moves the
vertical.  Which it is says the vertical that the accelerometers show after a motion, and how far the
filter is apart during it.  Until an axis has turned the vertical, its error is in the sigma.

The gyros' part is judged once a second; until then each sample adds what it may have turned wrong since:
bias, scale, half an interval of its rate, as a rate may be the mean of the interval before or that of the
moment, and by what filter and gyros have come apart since.
Heading is an angle about the vertical as it is taken: a tilt that is off turns the heading of an axis that
rises or falls by its tangent.

A magnetometer that is calibrated ties the heading down: its error over the horizontal field, the tilt times
the tangent of the dip, and what the gyros have added, which the filter forgets with its time constant.  Iron
that came after the calibration, at any time, bends the field in a direction that nobody knows: by how much
its strength says, each time that the field is seen from another side of the unit, and by how much it turns
the heading while the gyros show no such turn (`sizes.OnBody`).  As the field's strength does of iron, the
magnitude of gravity tells of the accelerometers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import inner, njit
from imumon.estimation.attitude.angles import matrix, shortest, times
from imumon.estimation.attitude.fusion import TAU_MAG_S
from imumon.estimation.attitude.sizes import ANY_SIZE, Look, OnBody, Sizes, Watched, usual
from imumon.estimation.attitude.turned import BIASES, Followed, Turned, of_vertical
from imumon.filters.turns import Turn
from imumon.geodesy import STANDARD_GRAVITY

GRAVITY_SPREAD = 0.03
"""m/s²: between equator and poles gravity differs by no more from the standard (WGS-84: 9.780 to 9.832)."""
ACCELERATIONS = np.geomspace(0.01, 1.0, 5)
"""Of a motion over gravity, as the filter has followed them: nobody knows how large they are, so sizes are
equally likely (as of `Sizes`)."""
LEAST_BIAS, LARGEST_BIAS = 0.05, 0.8
"""m/s², where it is not declared: data sheets of calibrated MEMS units state 5 mg, those of chips that nobody
has calibrated 20 (BMI088, LSM6DSO), 40 (BMI160) and 80 mg at most (MPU-6050, z)."""
COMES_S = 28800.0
"""Iron comes to the unit, or goes, about once in a working day: a screwdriver, another box on the rack."""
WRONG_AXES, KINDS_OF_AXES = (math.sqrt(1.6), math.sqrt(0.4)), 3
"""Of a diagonal element of M and of another where axes and signs are mixed up: of the six columns that P - 1
may have one is zero, one reversed (-2), and four have -1 and ±1.  Axes are right, or mixed up, or a scale is
wrong by tens of percent: sizes that nothing makes would take from the probability of those that happen."""
UP = np.array([0.0, 0.0, 1.0])
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
CERTAIN = 0.95
"""Probability from which on something is taken for so."""
UNKNOWN = 1.0
"""Beyond so much, rad, an error is no small angle any more, and its standard deviation says nothing."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Standard deviations that are known beforehand.

    Parameters
    ----------
    accel : float or None
        m/s²; None where it is not declared.
    scale : float
        Of the angle turned over itself.
    earth_rate : float
        What of the earth rate the bias does not hold, rad/s.
    magnetometer : float
        Unit of the field; NaN when it is not calibrated.
    field : float
        Its strength where the magnetometer was calibrated.
    accel_error_probability, axes_error_probability, magnet_error_probability : float
        As of `AttitudeParameters`.
    """

    accel: float | None
    scale: float
    earth_rate: float
    magnetometer: float
    field: float
    accel_error_probability: float
    axes_error_probability: float
    magnet_error_probability: float


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
    to_north : float
        At its end, how far the field has turned the heading from where the gyros have it, rad; NaN without.
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
    to_north: float
    follows: float


class Motion(NamedTuple):
    """What samples turned, each since the one before.

    Parameters
    ----------
    angle : array (n, 3)
        In motion, about the body axes, rad.
    ignored : array (n, 3)
        By the gyros, while it was taken for at rest, rad: the beginning of a motion may be in it.
    seconds : array (n,)
        In motion.
    """

    angle: FloatArray
    ignored: FloatArray
    seconds: FloatArray


SINCE = np.dtype([("angle", np.float64, 3), ("ignored", np.float64, 3), ("seconds", np.float64)])
"""Running sums of a motion since a moment."""


@dataclass(slots=True, eq=False)
class Uncertainty:
    """What has come together since the attitude began.

    Parameters
    ----------
    errors : Errors
    levelled : array (4,)
        What the levelling would be at the last rest with the vertical that was measured; NaN before one.
    levelling : array (4,)
        That of the last slot.
    twist, twisted : float
        How far the filter has turned about the vertical against the gyros since that rest, rad, at the end of
        the last slot, and how much of that the heading still has.
    accel_sd : float
        Tilt by the accelerometers, rad; NaN before the first rest.
    since_rest, since_north : Turned
        What the vertical of the last rest has gone through, and the heading since it was last tied down.
    followed : Followed
        What the filter has followed of the first.
    heading_variance : float
        By the bias in the motions before, rad²: each rest measures the bias anew.
    bent : float
        Square of what the field that is followed differs from the calibration's strength, forgotten like it.
    to_north : float
        Of the last slot that had it.
    pulled : float
        By how much that has changed, forgotten like the field.
    gyros : Watched
        What elements of M are like: of each gyro the one on the diagonal, then the others of its column.
    accels, iron : OnBody
        What the accelerometers are off by, and what bends the field.
    magnitude : float
        Of the specific force at the last rest, m/s².
    tilt_sd, heading_sd : float
        At the end of the last slot, rad; NaN where nothing can be said.
    """

    errors: Errors
    gyros: Watched
    accels: OnBody
    iron: OnBody
    levelled: FloatArray = field(default_factory=lambda: np.full(4, np.nan))
    levelling: FloatArray = field(default_factory=lambda: np.full(4, np.nan))
    twist: float = 0.0
    twisted: float = 0.0
    accel_sd: float = math.nan
    since_rest: Turned = field(default_factory=Turned)
    since_north: Turned = field(default_factory=Turned)
    followed: Followed = field(default_factory=Followed)
    heading_variance: float = 0.0
    bent: float = 0.0
    to_north: float = math.nan
    pulled: float = 0.0
    magnitude: float = math.nan
    tilt_sd: float = math.nan
    heading_sd: float = math.nan
    contradicted: bool = False
    """Whether the field has contradicted the gyros: either is wrong, and gravity alone can say which."""

    def anew(self) -> Uncertainty:
        """Return what is known when the attitude begins anew."""
        return Uncertainty(self.errors, self.gyros, self.accels, self.iron, contradicted=self.contradicted)

    def lose_north(self) -> None:
        """Let the heading be free from here: what it may be off is its change since."""
        self.since_north, self.heading_variance, self.twisted = Turned(), 0.0, 0.0
        self.to_north, self.pulled, self.contradicted = math.nan, 0.0, True
        self.heading_sd = self._free()

    def step(self, slot: Slot) -> None:
        """Follow one slot."""
        self.levelling = slot.levelling
        apart, twist = _apart(slot.levelling, self.levelled)
        self.twisted, self.twist = self.twisted + twist - self.twist, twist
        forced = bool(np.isfinite(slot.force).all())
        if slot.rest and forced:
            self._come_to_rest(slot)
        elif math.isfinite(self.accel_sd):
            # By the gyros alone: what accelerations have turned the filter by would make one that stays of a
            # turn to and fro.
            off = times(slot.levelling, self.levelled * CONJUGATE)
            lost = slot.bias_sd, self.errors.earth_rate * slot.seconds, float(slot.ignored @ slot.ignored)
            self.since_rest.add(slot.turn, matrix(off * CONJUGATE) @ slot.attitude, *lost)
            self.since_north.add(slot.turn, slot.attitude, *lost)
            followed_s = slot.seconds * forced
            self.followed.follow(self.since_rest, followed_s)
            carried2 = self._carried(0.5 * apart**2, followed_s)
            self.tilt_sd = _small(math.sqrt(self.accel_sd**2 + carried2))
        if math.isfinite(slot.to_north):
            self.heading_sd = self._magnetic(slot)
        else:
            self.heading_sd = self._free()

    def _free(self) -> float:
        """Return the standard deviation of a free heading; NaN where it may be the gyros that are wrong."""
        known = not self.contradicted or self.gyros.now.usual >= CERTAIN
        return _small(self._drifted()) if known and math.isfinite(self.accel_sd) else math.nan

    def at(
        self, since: Any, rows: range, motion: Motion, bias_sd: FloatArray, levelling: FloatArray,
        variance: FloatArray,
    ) -> None:  # fmt: skip
        """Fill in the variances of tilt and of the turn about the vertical, rad², (2, n), of some rows.

        Parameters
        ----------
        since : array of SINCE (1,)
            Sums since the last slot, which go on.
        rows : range
        motion : Motion
        bias_sd : array (n, 3)
            rad/s.
        levelling : array (n, 4)
            As of `Found`.
        variance : array (2, n)
        """
        known = np.array([self.tilt_sd**2, self.heading_sd**2])
        # About which axis that is nobody asks within a second: as much as any element makes.
        scale2 = self.gyros.now.mean_square.reshape(2, 3).max(0)
        _at(
            since, rows.start, rows.stop, *motion, scale2, bias_sd, levelling, self.levelling, known,
            self.twisted, variance,
        )  # fmt: skip

    def _come_to_rest(self, slot: Slot) -> None:
        """Take the vertical that the accelerometers show, and close the account of a motion."""
        self.magnitude = float(np.linalg.norm(slot.force))
        shown = Look((self.magnitude - STANDARD_GRAVITY) ** 2, GRAVITY_SPREAD**2 / 3.0)
        self.accels.look(slot.force / self.magnitude, shown)
        self.accel_sd = self.accels.sd / STANDARD_GRAVITY
        levelled = _levelled(slot)
        off, _ = _apart(levelled, self.levelled)
        if self.since_rest.parts.any() and np.isfinite(self.since_rest.parts).all() and math.isfinite(off):
            parts, gyros = self.since_rest.parts, self.gyros.now
            without, added = of_vertical(parts, parts, gyros.squares)
            other2 = without + float(self.since_rest.sampled[:2].mean()) + 2.0 * self.accel_sd**2
            self.gyros = Watched(gyros.seen(off**2, other2, added, 2))
        self.levelled = levelled
        on_its_way, _ = _apart(slot.levelling, levelled)
        self.tilt_sd = _small(math.hypot(self.accel_sd, math.sqrt(0.5) * on_its_way))
        drifted = float((self.since_north.parts[2, BIASES] ** 2).sum()) + self.twisted**2
        if math.isfinite(drifted):
            self.heading_variance += drifted
        self.since_north.parts[:, BIASES] = 0.0
        self.twist = self.twisted = 0.0
        self.since_rest, self.followed = Turned(), Followed()

    def _carried(self, apart2: float, seconds: float) -> float:
        """Return the mean square of a component of what gyros and accelerations have turned the vertical by.

        `apart2` is that of how far the filter's up is from the gyros': what it has followed of either, for so
        many `seconds` more.  It says how likely each size is, of M and of accelerations, and with each what
        the error is; NaN where the bias was not known.
        """
        since, followed = self.since_rest.parts, self.followed.parts
        if not (np.isfinite(since).all() and math.isfinite(apart2)):
            return math.nan
        turned, both, seen = (
            without + Sizes.sums(added)
            for without, added in (
                of_vertical(one, other, self.gyros.now.squares)
                for one, other in ((since, since), (since, followed), (followed, followed))
            )
        )
        moved = 2.0 * self.accel_sd**2 + ACCELERATIONS**2
        spread = seen + moved.reshape(-1, *[1] * seen.ndim)
        likely = np.exp(-apart2 / spread) / spread
        alike = likely.sum(0)
        self.gyros.look(np.log(alike), seconds)
        share = both / spread
        left = turned - both * share + apart2 * (1.0 - share) ** 2
        weight = self.gyros.now.probabilities / alike
        return float((weight * (likely * left).sum(0)).sum()) + float(self.since_rest.sampled[:2].mean())

    def _drifted(self) -> float:
        """Return the standard deviation of the heading by the gyros, rad."""
        turned = self.since_north.variance(self.gyros.now.mean_square)
        return math.sqrt(self.heading_variance + float(turned[2]))

    def _magnetic(self, slot: Slot) -> float:
        """Return the standard deviation of a heading that follows the magnetometer, rad."""
        strength = math.sqrt(float(slot.mag @ slot.mag))
        # What the gyros have added is forgotten as the filter follows the field.
        keep = math.exp(-slot.follows * slot.seconds / TAU_MAG_S)
        # It is nothing at first, when the field has shown where north is.
        changed = math.remainder(slot.to_north - self.to_north, math.tau)
        self.pulled = keep * self.pulled + (0.0 if math.isnan(changed) else changed)
        self.to_north = slot.to_north
        self.since_north.forget(keep)
        self.heading_variance *= keep * keep
        self.twisted *= keep
        if slot.follows:
            self.bent += (1.0 - keep) * ((strength - self.errors.field) ** 2 - self.bent)
        vertical = float(slot.mag @ slot.attitude[2])
        horizontal = math.sqrt(max(strength**2 - vertical**2, 0.0))
        if not (horizontal > 0.0 and math.isfinite(self.errors.magnetometer)):
            return math.nan
        # What is fixed to the unit adds to the field in one direction and takes from it in another; and what
        # comes to it turns the field while the gyros show that the unit does not.
        across2 = self.errors.magnetometer**2 + (vertical * self.tilt_sd) ** 2
        self.iron.look(
            slot.mag / strength,
            Look(self.bent, self.errors.magnetometer**2),
            Look((horizontal * self.pulled) ** 2, across2 + (horizontal * self._drifted()) ** 2),
            slot.seconds / COMES_S,
        )
        calibration = math.hypot(self.errors.magnetometer, self.iron.sd)
        tied = math.hypot(calibration, vertical * self.tilt_sd) / horizontal
        return _small(math.hypot(tied, self._drifted()))


def begin(errors: Errors) -> Uncertainty:
    """Return what is known beforehand."""
    gyros = usual(
        errors.scale, np.repeat(WRONG_AXES, 3).tolist(), errors.axes_error_probability, KINDS_OF_AXES
    )
    calibrated = math.isfinite(errors.magnetometer)
    field_sd, strength = (errors.magnetometer, errors.field) if calibrated else (0.0, 0.0)
    iron = OnBody.of(usual(field_sd, [strength], errors.magnet_error_probability))
    if errors.accel is None:
        accels = usual(LEAST_BIAS, [LARGEST_BIAS], ANY_SIZE)
    else:
        accels = usual(errors.accel, [LARGEST_BIAS], errors.accel_error_probability)
    return Uncertainty(errors, Watched(gyros), OnBody.of(accels), iron)


@inner
def _apart(levelling: FloatArray, levelled: FloatArray) -> tuple[float, float]:
    """Return the tilt and the twist, rad, of a levelling after the inverse of another, w, x, y, z each."""
    a, b, c, d = levelling[0], levelling[1], levelling[2], levelling[3]
    w, x, y, z = levelled[0], -levelled[1], -levelled[2], -levelled[3]
    forward, side = a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x
    across = math.sqrt(forward * forward + side * side)
    about, along = a * z + b * y - c * x + d * w, a * w - b * x - c * y - d * z
    twist = math.atan2(math.copysign(1.0, along) * about, abs(along))  # of q and of -q the same
    return 2.0 * math.asin(1.0 if across > 1.0 else across), 2.0 * twist


@njit
def _at(
    since: Any, start: int, stop: int, angle: FloatArray, ignored: FloatArray, seconds: FloatArray,
    scale2: FloatArray, bias_sd: FloatArray, levelling: FloatArray, latest: FloatArray, known: FloatArray,
    twisted: float, variance: FloatArray,
) -> None:  # fmt: skip
    """Fill in what `Uncertainty.at` says."""
    total = since[0]
    for i in range(start, stop):
        total.seconds += seconds[i]
        added = 0.0
        for j in range(3):
            total.angle[j] += angle[i, j]
            total.ignored[j] += ignored[i, j]
            # Even chances from none of the interval to all.
            added += total.angle[j] ** 2 * scale2[j] + total.ignored[j] ** 2 + angle[i, j] ** 2 / 12.0
            if total.seconds > 0.0:
                added += (bias_sd[i, j] * total.seconds) ** 2
        tilt, twist = _apart(levelling[i], latest)
        variance[0, i] = known[0] + 0.5 * tilt**2 + added
        variance[1, i] = known[1] + (twisted + twist) ** 2 + added


def _levelled(slot: Slot) -> FloatArray:
    """Return the levelling with the vertical that the specific force shows."""
    shown = slot.attitude @ slot.force / math.sqrt(float(slot.force @ slot.force))
    return times(shortest(shown, UP), slot.levelling)


def _small(sd: float) -> float:
    return sd if sd < UNKNOWN else math.nan
