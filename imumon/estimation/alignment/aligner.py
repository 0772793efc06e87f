"""The alignment of one device, slot by slot: its positions, and the fits."""

from __future__ import annotations

import cmath
import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.fit import fit_position
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.position import (
    NO_ERROR,
    SLOT_S,
    AzimuthError,
    Motion,
    Position,
    Slot,
    direction_of,
    upright,
)
from imumon.estimation.alignment.posterior import HeadingPosterior, heading_posterior, sensor_errors
from imumon.estimation.alignment.report import ANY_ANGLE_SD, Estimate, PositionHeading, Status
from imumon.filters.turns import Turn, angle_of
from imumon.geodesy import EARTH_RATE, forward

SAME_ATTITUDE, SHORT_PATH = 1e-3, 20e-3
"""rad: a turn by less (0.06°, the noise of 1 °/√h in 10 s) on a path of less leaves the attitude as it is."""
NEW_POSITION = 0.2
"""rad: a turn by less, as of a table that is bumped, does not separate the bias from the earth rate."""
FIRST_FIT_S, LONGEST_REFIT_S = 10.0, 60.0
"""Time at rest of the first fit of a position, and the longest between two fits; in between a position is
fitted anew when its time at rest has grown by a third, which lowers sigma by an eighth."""
FORGET_S = 60.0
"""A longer record loses its first half while the unit creeps."""
RECENT_SHARE = 0.5
"""Sigma is at least the distance to the headings fitted in the last half of the time at rest in a position;
ablation: without it, six of 41 sites were over 7 sigma off once, not two."""
MOST_FITS = 400
"""Headings that are kept, for the chart and for sigma."""


class Aligner:
    """The alignment of one device since its last restart, fed with slots."""

    def __init__(self, parameters: AlignmentParameters, latitude_deg: float, events: list[str]) -> None:
        """Prepare for the first slot; `events` takes the messages."""
        self.parameters, self.events = parameters, events
        self.latitude = math.radians(latitude_deg)
        self.earth_horizontal = EARTH_RATE * math.cos(self.latitude)
        self.wanted_sd = math.radians(parameters.settled_deg)
        self.motion = Motion()
        self.positions: list[Position] = []
        self.errors = sensor_errors(0.0, parameters)
        """Of the sensors: declared, or by the noise of the quietest gyro in any fit."""
        self.posterior: HeadingPosterior | None = None
        """Of the last fit; None before it."""
        self.history: deque[tuple[float, float, float]] = deque(maxlen=MOST_FITS)
        """Time at rest, s, north and sigma of each fit."""
        self.rest_s, self.due_s = 0.0, FIRST_FIT_S
        """Time at rest, and that at which the next fit is due."""
        self.fitted_error = NO_ERROR
        """Of the present position in the last heading."""
        self.settled_s: float | None = None
        """Time since the first sample at which the heading settled; None if it is not settled."""

    def step(self, slot: Slot, at_rest: bool, turn: Turn) -> None:
        """Process a slot with its turn and the rest detector's flag."""
        rest, turn = self.motion.step(slot, at_rest, turn)
        if not rest:
            return
        if not self.positions:
            force = _mean_force(rest)
            self._begin(Position(rest[0].number, upright(forward(force / np.linalg.norm(force)), force)))
        elif angle_of(turn.rotation) > SAME_ATTITUDE or turn.path > SHORT_PATH:
            self._end_turn(rest, turn)
        else:
            here = self.positions[-1]
            here.azimuth_error = here.azimuth_error.then(AzimuthError(angle_of(turn.rotation) ** 2))
        for one in rest:
            self.positions[-1].add(one)
        self.rest_s += SLOT_S * len(rest)
        if self.rest_s >= self.due_s:
            self._update_heading()

    def _begin(self, position: Position) -> None:
        self.positions.append(position)
        self.due_s = self.rest_s + FIRST_FIT_S

    def _end_turn(self, rest: Sequence[Slot], turn: Turn) -> None:
        """Begin a position with the rest after a turn."""
        before = self.positions[-1]
        self._fit_position()
        by_gyros = before.attitude @ turn.rotation
        attitude = upright(by_gyros[0], _mean_force(rest[len(rest) // 2 :]))
        # Gravity shows how wrong the horizontal axes are; the vertical one may be as wrong.
        lean = (by_gyros @ attitude[2])[:2]
        by_lean = 0.5 * float(lean @ lean) - 2.0 * self.errors.accel_bias**2
        turned = AzimuthError.of(turn, before.attitude[2])
        variance = turned.variance_from(NO_ERROR, self.errors.scale)
        turned = turned._replace(variance=turned.variance + max(by_lean - variance, 0.0))
        new = angle_of(turn.rotation) > NEW_POSITION
        angle = math.degrees(_turned(before.attitude, attitude))
        sd = math.degrees(math.sqrt(max(variance, by_lean)))
        begun_s, what = self.motion.begun_s, "a new position, " if new else ""
        self.events.append(
            f"alignment: the unit turned at {begun_s:.1f} s for {SLOT_S * rest[0].number - begun_s:.1f} s: "
            f"left out; {what}turned by {angle:.2f}° ± {sd:.2f}° about the vertical"
        )
        before.fit = before.fit and before.fit.averaged()
        before.sums = np.empty((0, 7))
        error = before.azimuth_error_now.then(turned)
        self._begin(Position(rest[0].number, attitude, error, before.number + new, before.still_rate))

    @property
    def attitude(self) -> FloatArray:
        """Body axes to the reference frame, now, (3, 3); the identity before the first rest."""
        here = self.positions[-1].attitude if self.positions else np.eye(3)
        return np.asarray(here @ self.motion.turn.rotation)

    def _fit_position(self) -> bool:
        """Fit the present position; return whether its record allows it."""
        here = self.positions[-1]
        fit = fit_position(here, self.latitude, self.parameters.known_warm_up)
        if fit is None:
            if here.rest_s > FORGET_S:
                here.forget_half()
            return False
        here.azimuth_error = here.azimuth_error_now
        here.fit, here.still_rate, here.yaw_since_fit = fit, fit.vertical, 0.0
        white = min(one.fit.white for one in self.positions if one.fit is not None)
        self.errors = sensor_errors(math.sqrt(white), self.parameters)
        return True

    def _update_heading(self) -> None:
        """Fit the present position, and update the heading and whether it has settled."""
        here = self.positions[-1]
        self.due_s = self.rest_s + min(max(here.rest_s / 3.0, 1.0), LONGEST_REFIT_S)
        if self._fit_position():
            self._update_posterior(here)
        # Settled when sigma falls to the wanted one, and no longer when it exceeds 1.25 times that.
        wanted = self.wanted_sd * (1.0 if self.settled_s is None else 1.25)
        settled = self.observable and self.heading_sd <= wanted
        self.settled_s = (self.settled_s or here.ended_s) if settled else None

    def _update_posterior(self, here: Position) -> None:
        """Update the posterior by the fits of all positions, of which the present one is new."""
        fitted = [(one.fit, one.azimuth_error) for one in self.positions if one.fit]
        about = self.posterior.north if self.posterior else cmath.phase(fitted[-1][0].gyro_mean)
        new = heading_posterior(fitted, about, self.latitude, self.errors)
        # What no hypothesis explains shows as a heading that moves from fit to fit.
        since_s = self.rest_s - RECENT_SHARE * here.rest_s
        recent = [north for rest_s, north, _ in self.history if rest_s >= since_s]
        moved = max((abs(math.remainder(new.north - north, math.tau)) for north in recent), default=0.0)
        self.posterior = new._replace(sd=min(max(new.sd, moved), ANY_ANGLE_SD))
        self.fitted_error = here.azimuth_error
        self.history.append((self.rest_s, new.north, self.posterior.sd))

    @property
    def heading_sd(self) -> float:
        """Standard deviation of the heading, rad: of the last fit, turns and creep since; NaN before it."""
        if self.posterior is None:
            return math.nan
        here = self.positions[-1]
        return self._heading_sd_at(
            here.azimuth_error_now.then(AzimuthError.of(self.motion.turn, here.attitude[2]))
        )

    def _heading_sd_at(self, azimuth: AzimuthError) -> float:
        """Return the standard deviation of the heading in another position, rad."""
        assert self.posterior is not None
        moved = azimuth.variance_from(self.fitted_error, self.errors.scale)
        return min(math.sqrt(self.posterior.sd**2 + moved), ANY_ANGLE_SD)

    @property
    def observable(self) -> bool:
        """Whether the heading is shown: its standard deviation is below `observable_deg`."""
        return self.heading_sd < math.radians(self.parameters.observable_deg)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Headings by the joint fit and the means of the gyros, NaN if not observable; none before a fit."""
        if self.posterior is None:
            return {}
        fit = [one.fit for one in self.positions if one.fit][-1]
        found = {"joint": (self.posterior.north, self.heading_sd)}
        for name, mean, factor in (("gyro_mean", fit.gyro_mean, 1.0), ("hann_mean", fit.hann_mean, 1.5)):
            rate_sd = math.sqrt(factor * fit.white / fit.rest_s + self.posterior.bias_size**2)
            found[name] = cmath.phase(mean), min(rate_sd / self.earth_horizontal, ANY_ANGLE_SD)
        direction = direction_of(self.attitude) if self.observable else math.nan
        return {name: Estimate((north - direction) % math.tau, sd) for name, (north, sd) in found.items()}

    @property
    def remaining_s(self) -> float | None:
        """Time until the wanted sigma, if all of sigma that is no bias is noise; None if unknown or never."""
        if self.posterior is None or not self.observable:
            return None
        alone = self.positions[-1].number == 1  # several positions separate the bias from the earth rate
        by_bias = alone * (self.posterior.bias_size / self.earth_horizontal) ** 2
        noise, wanted = self.heading_sd**2 - by_bias, self.wanted_sd**2 - by_bias
        return max(self.rest_s * (noise / wanted - 1.0), 0.0) if wanted > 0.0 else None

    def status(self, elapsed_s: float) -> Status:
        """Return the state so long after the first sample."""
        status = Status(self.wanted_sd, elapsed_s, self.motion.moving)
        if not self.positions:
            return status
        here = self.positions[-1]
        moving, number = status.moving, here.number
        before = [one.attitude for one in self.positions if moving or one.number < number]
        by_noise = here.fit.variance.min() if here.fit else math.inf
        return status._replace(
            estimates=self.estimates,
            settled_s=self.settled_s,
            remaining_s=self.remaining_s,
            rest_s=self.rest_s,
            positions=number,
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
        found = []
        for one in self.positions:
            sd = self._heading_sd_at(one.azimuth_error_now)
            shown = self.posterior.north if sd < math.radians(self.parameters.observable_deg) else math.nan
            heading = (shown - direction_of(one.attitude)) % math.tau
            found.append(PositionHeading(run, one.begun_s, one.ended_s, heading, sd))
        return found


def _mean_force(slots: Sequence[Slot]) -> FloatArray:
    """Return the mean specific force of slots, m/s², (3,)."""
    return np.asarray(np.mean([slot.force for slot in slots], axis=0))


def _turned(before: FloatArray, after: FloatArray) -> float:
    """Return the change of heading between two attitudes, rad, clockwise."""
    return math.remainder(direction_of(before) - direction_of(after), math.tau)
