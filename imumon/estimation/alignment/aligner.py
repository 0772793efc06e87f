"""The alignment of one device, slot by slot: its positions, their fits, and the heading with its sigma.

`stage` calls `Aligner.step` with each slot.  Of the slots that `Motion` returns as rest

- the first ones begin the first position;
- those after a turn begin a position, whose attitude is by the turn about the vertical, and else by gravity;
- all others go on in the present position; a small angle of motion before them is added to sigma.

When its time at rest has grown by a third, `fit` and then `posterior` give north anew.  Sigma is that of the
posterior or, if larger, the distance to earlier headings in this position.  What the unit has turned and
crept since the fit is added, and a constant creep that other positions with the same axis up show.
"""

import cmath
import math
from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.filters.turns import Turn, angle_of
from imumon.geodesy import EARTH_RATE, forward

from .fit import fit_position
from .parameters import AlignmentParameters
from .position import (
    SLOT_S,
    AzimuthError,
    Motion,
    Position,
    PositionFit,
    Slot,
    direction_of,
    upright,
)
from .posterior import HeadingPosterior, heading_posterior, sensor_errors
from .report import ANY_ANGLE_SD, Estimate, PositionHeading, Status

SAME_ATTITUDE, SHORT_PATH = 1e-3, 20e-3
"""rad: a turn by less (0.06°, the noise of 1 °/√h in 10 s) on a path of less leaves the attitude as it is."""
NEW_POSITION = 0.2
"""rad: a turn by less, as of a table that is bumped, does not separate the bias from the earth rate."""
SAME_UP = 0.99  # cosine of the angle between two body axes which count as the same vertical: 8°
FIRST_FIT_S, LONGEST_REFIT_S = 10.0, 60.0
"""Time at rest of the first fit of a position, and the longest between two fits; in between a position is
fitted anew when its time at rest has grown by a third, which lowers sigma by an eighth."""
FORGET_S = 60.0  # a longer record loses its first half while no fit is possible, as where the unit creeps
RECENT_SHARE = 0.5
"""Sigma is at least the distance to headings fitted in this last part of the rest.  Ablation: last row."""


class Aligner:
    """The alignment of one device since its last restart, fed with slots; `events` takes the messages."""

    def __init__(self, parameters: AlignmentParameters, latitude_deg: float, events: list[str]) -> None:
        self.parameters, self.events = parameters, events
        self.latitude = math.radians(latitude_deg)
        self.earth_horizontal = EARTH_RATE * math.cos(self.latitude)
        self.wanted_sd = math.radians(parameters.settled_deg)
        self.motion = Motion()
        self.positions: list[Position] = []
        self.creep_rate = 0.0  # by which the unit may creep about the vertical in this position, rad/s
        self.errors = sensor_errors(0.0, parameters)
        self.posterior: HeadingPosterior | None = None  # of the last fit
        self.history: list[tuple[float, float, float]] = []  # time at rest, s, north and sigma of each fit
        self.rest_s, self.due_s = 0.0, FIRST_FIT_S
        """Time at rest in all positions, and that at which the next fit is due."""
        self.fitted_error = AzimuthError()
        """Of the present position at the last fit; what exceeds it since is added to sigma."""
        self.settled_s: float | None = None

    def step(self, slot: Slot, at_rest: bool, turn: Turn) -> None:
        """Process a slot with its turn and the rest detector's flag."""
        rest, turn = self.motion.step(slot, at_rest, turn)
        if not rest:
            return
        angle = angle_of(turn.rotation)
        if not self.positions:
            force = np.mean([each.force for each in rest], axis=0)
            attitude = upright(forward(force / np.linalg.norm(force)), force)
            self.positions.append(Position(rest[0].begun_s, attitude))
        elif angle > SAME_ATTITUDE or turn.path > SHORT_PATH:
            self._end_turn(rest, turn)
        else:
            here = self.positions[-1]
            here.azimuth_error = here.azimuth_error.then(AzimuthError(angle**2))
        for each in rest:
            self.positions[-1].add(each)
        self.rest_s += SLOT_S * len(rest)
        if self.rest_s >= self.due_s:
            self._update_heading()

    def _end_turn(self, rest: Sequence[Slot], turn: Turn) -> None:
        """Begin a position with the rest after a turn."""
        before = self.positions[-1]
        self._fit_position()
        by_gyros = before.attitude @ turn.rotation
        force = np.mean([slot.force for slot in rest[len(rest) // 2 :]], axis=0)
        attitude = upright(by_gyros[0], force)
        error = AzimuthError.of(turn, before.attitude[2])
        variance = error.variance_from(AzimuthError(), self.errors.scale)
        # By gravity the gyros are off by `lean`, rad, about both level axes, and may be as much about the
        # vertical: the mean square of both, less that of the accelerometers' bias in both positions.
        lean = (by_gyros @ attitude[2])[:2]
        by_lean = 0.5 * float(lean @ lean) - 2.0 * self.errors.accel_bias**2
        error = before.azimuth_error.then(error).then(AzimuthError(max(by_lean - variance, 0.0)))
        angle, sd = np.degrees([_turned(before.attitude, attitude), math.sqrt(max(variance, by_lean))])
        begun_s = self.motion.begun_s
        self.events.append(
            f"alignment: the unit turned at {begun_s:.1f} s for {rest[0].begun_s - begun_s:.1f} s "
            f"by {angle:.2f}° ± {sd:.2f}° about the vertical"
        )
        before.fit = before.fit and before.fit.averaged()
        before.sums = np.empty((0, 7))  # its rows are not needed any more
        # A gyro that was not vertical before has another bias.
        still_rate = before.still_rate if attitude[2] @ before.attitude[2] > SAME_UP else math.nan
        ordinal = before.ordinal + (angle_of(turn.rotation) > NEW_POSITION)
        self.positions.append(Position(rest[0].begun_s, attitude, error, ordinal, still_rate))
        self.due_s = self.rest_s + FIRST_FIT_S

    @property
    def attitude(self) -> FloatArray:
        """Body axes to the reference frame, now, (3, 3); only after the first rest."""
        return self.positions[-1].attitude @ self.motion.turn.rotation

    @property
    def _fits(self) -> list[PositionFit]:
        return [position.fit for position in self.positions if position.fit]

    def _fit_position(self) -> bool:
        """Fit the present position; return whether its record allows it."""
        here = self.positions[-1]
        fit = fit_position(here, self.latitude, self.parameters.known_warm_up)
        if fit is None:
            if here.rest_s > FORGET_S:
                here.forget_half()
            return False
        here.fit = fit
        white = np.median([each.white for each in self._fits])
        self.errors = sensor_errors(math.sqrt(white), self.parameters)
        # Positions with the same axis up, this one too, have one bias; the nearest to the earth rate rests.
        earth_up = EARTH_RATE * math.sin(self.latitude)
        same = [other for other in self._fits if other.attitude[2] @ fit.attitude[2] > SAME_UP]
        still = min(same, key=lambda other: abs(other.vertical - earth_up))
        here.still_rate = still.vertical
        # If not even that one does, the true rate at rest is between the earth rate and its own: the unit may
        # creep by up to their difference, but not by more than the largest difference between positions.
        largest = max(_vertical_change(fit, other) for other in same)
        self.creep_rate = max(_vertical_change(fit, still), min(abs(still.vertical - earth_up), largest))
        return True

    def _update_heading(self) -> None:
        """Fit the present position, and update the heading and whether it has settled."""
        here = self.positions[-1]
        self.due_s = self.rest_s + min(max(here.rest_s / 3.0, 1.0), LONGEST_REFIT_S)
        if self._fit_position():
            about = self.posterior.north if self.posterior else cmath.phase(self._fits[-1].gyro_mean)
            new = heading_posterior(self._fits, about, self.latitude, self.errors)
            # What no hypothesis explains shows as a heading that changes from fit to fit.
            since_s = self.rest_s - RECENT_SHARE * here.rest_s
            recent = [north for rest_s, north, _ in self.history if rest_s >= since_s]
            change = max((abs(math.remainder(new.north - north, math.tau)) for north in recent), default=0.0)
            # A unit that creeps at a constant rate points elsewhere than in the middle of the record.
            creep = 0.5 * self.creep_rate * here.rest_s
            self.posterior = new._replace(sd=min(math.hypot(max(new.sd, change), creep), ANY_ANGLE_SD))
            self.fitted_error = here.azimuth_error
            self.history.append((self.rest_s, new.north, self.posterior.sd))
        # Settled when sigma falls to the wanted one, and no longer when it exceeds 1.25 times that.
        wanted = self.wanted_sd * (1.0 if self.settled_s is None else 1.25)
        heading, sd = self.estimates.get("joint", Estimate())
        settled = sd <= wanted and math.isfinite(heading)
        self.settled_s = (self.settled_s or here.ended_s) if settled else None

    def _heading_at(self, attitude: FloatArray, error: AzimuthError) -> Estimate:
        """Return the heading in an attitude with this azimuth error; NaN above `observable_deg`."""
        assert self.posterior is not None
        since_fit = error.variance_from(self.fitted_error, self.errors.scale)
        sd = min(math.sqrt(self.posterior.sd**2 + since_fit), ANY_ANGLE_SD)
        observable = sd < math.radians(self.parameters.observable_deg)
        north = self.posterior.north if observable else math.nan
        return Estimate((north - direction_of(attitude)) % math.tau, sd)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Headings by the joint fit and the means of the gyros, NaN if not observable; none before a fit."""
        if self.posterior is None:
            return {}
        here = self.positions[-1]
        turning = AzimuthError.of(self.motion.turn, here.attitude[2])
        joint = self._heading_at(self.attitude, here.azimuth_error.then(turning))
        found, fit = {"joint": joint}, self._fits[-1]
        # A Hann-weighted mean has 1.5 times the variance.
        for name, mean, factor in (("gyro_mean", fit.gyro_mean, 1.0), ("hann_mean", fit.hann_mean, 1.5)):
            heading = joint.heading + cmath.phase(mean) - self.posterior.north
            rate_sd = math.sqrt(factor * fit.variance.min() + self.posterior.rate_sd**2)
            found[name] = Estimate(heading % math.tau, min(rate_sd / self.earth_horizontal, ANY_ANGLE_SD))
        return found

    def _remaining_s(self, joint: Estimate) -> float:
        """Return the time until the wanted sigma, if all of sigma that is no bias is noise."""
        if self.posterior is None or math.isnan(joint.heading):
            return math.inf
        by_bias = (self.posterior.rate_sd / self.earth_horizontal) ** 2
        by_bias *= self.positions[-1].ordinal == 1  # several positions separate it from the earth rate
        now, wanted = joint.sd**2 - by_bias, self.wanted_sd**2 - by_bias
        return max(self.rest_s * (now / wanted - 1.0), 0.0) if min(now, wanted) > 0.0 else math.inf

    def status(self, elapsed_s: float) -> Status:
        """Return the state so long after the first sample."""
        status = Status(self.wanted_sd, elapsed_s, self.motion.moving, estimates=self.estimates)
        if not self.positions:
            return status
        here = self.positions[-1]
        before = [each.attitude for each in self.positions if status.moving or each.ordinal < here.ordinal]
        by_noise = here.fit.variance.min() if here.fit else math.inf
        return status._replace(
            settled_s=self.settled_s,
            remaining_s=self._remaining_s(status.shown),
            rest_s=self.rest_s,
            positions=here.ordinal,
            position_s=here.rest_s,
            position_sd=math.sqrt(by_noise) / self.earth_horizontal,
            turned=_turned(before[-1], self.attitude) if before else 0.0,
        )

    def headings(self, run: int) -> list[PositionHeading]:
        """Fit the rest since the last fit; return the heading in each position of a segment."""
        if self.positions:
            self._update_heading()
        if self.posterior is None:
            return []
        return [
            PositionHeading(run, at.begun_s, at.ended_s, *self._heading_at(at.attitude, at.azimuth_error))
            for at in self.positions
        ]


def _vertical_change(fit: PositionFit, other: PositionFit) -> float:
    """Return how far the vertical gyros of two fits differ beyond three standard deviations, rad/s."""
    noise = math.sqrt(fit.vertical_variance + other.vertical_variance)
    return max(abs(fit.vertical - other.vertical) - 3.0 * noise, 0.0)


def _turned(before: FloatArray, after: FloatArray) -> float:
    """Return the change of heading between two attitudes, rad, clockwise."""
    return math.remainder(direction_of(before) - direction_of(after), math.tau)
