"""The alignment of one device, slot by slot: motion detection, the record of each position, and the fits."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import DRIFTS, Drift, PositionFit, fit_position
from imumon.estimation.alignment.motion import CALM_SLOTS, LONGEST_MOTION_S, Motion, Outcome
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.posterior import HeadingPosterior, heading_posterior
from imumon.estimation.alignment.record import (
    SLOT_S,
    Record,
    Slot,
    direction_of,
    first_attitude,
    horizontal_rows,
    upright,
    yaw_between,
)
from imumon.estimation.alignment.report import ANY_ANGLE_SD, Estimate, PositionHeading
from imumon.estimation.alignment.sensor_errors import SensorErrors, sensor_errors
from imumon.filters.turns import Turn, angle_of
from imumon.geodesy import EARTH_RATE

FIRST_FIT_S, LONGEST_REFIT_S = 10.0, 60.0
"""Time at rest of the first fit of a position, and the longest between two fits; in between a position is
fitted anew when its time at rest has grown by a third, which lowers sigma by an eighth."""
RECENT_SHARE = 0.5
"""Sigma is at least the distance to the headings fitted in the last half of the time at rest in a position;
ablation: without it, six of 41 sites were over 7 sigma off once, not two."""
NEW_POSITION = 0.01
"""rad: a turn by less does not separate the bias from the earth rate."""
LONGEST_GAP_S = 30.0
"""A longer gap in the data restarts the alignment."""


@dataclass
class Position:
    """A rest in one attitude.

    `attitude` (3, 3) is from body axes to the reference frame, which is forward, left and up of the first
    position; `azimuth_variance` is that of the angle about the vertical since then, rad².  `number` counts
    from 1 the attitudes that differ by more than NEW_POSITION; `magnetic` (3,) is the sum of the
    magnetometer's means in body axes.
    """

    attitude: FloatArray
    azimuth_variance: float
    number: int
    record: Record
    fit: PositionFit | None = None
    magnetic: FloatArray = field(default_factory=lambda: np.zeros(3))


class Fitted(NamedTuple):
    """A result of the latest fits: time at rest, s; direction of north, counter-clockwise, and sigma, rad."""

    rest_s: float
    north: float
    sd: float


@dataclass
class SinceFit:
    """Rotations about the vertical since the last fit.

    `yaw` is the slow one (creep) by the vertical gyro, rad, counter-clockwise, followed for `creep_s`;
    `azimuth_variance`, rad², is that of turns to other positions.
    """

    yaw: float = 0.0
    creep_s: float = 0.0
    azimuth_variance: float = 0.0


@dataclass
class State:
    """State of the alignment that a restart drops."""

    motion: Motion = field(default_factory=Motion)
    positions: list[Position] = field(default_factory=list)
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    """Body axes to the reference frame, now, (3, 3)."""
    posterior: HeadingPosterior | None = None
    """Of the last fit; None before it."""
    since_fit: SinceFit = field(default_factory=SinceFit)
    means: dict[str, Fitted] = field(default_factory=dict)
    """By means of the gyros, beside the joint fit."""
    history: list[Fitted] = field(default_factory=list)
    """By the joint fit."""
    rest_s: float = 0.0
    """Time at rest."""
    due_s: float = FIRST_FIT_S
    """Time at rest at which the next fit is due."""
    settled_s: float | None = None
    """Time since the first sample at which the heading settled; None if it is not settled."""


class Aligner:
    """The alignment of one device, fed with slots."""

    def __init__(self, parameters: AlignmentParameters, latitude_deg: float) -> None:
        self.parameters = parameters
        self.latitude = math.radians(latitude_deg)
        self.earth_horizontal = EARTH_RATE * math.cos(self.latitude)
        self.earth_vertical = EARTH_RATE * math.sin(self.latitude)
        known = parameters.known_warm_up
        self.drifts: Sequence[Drift] = DRIFTS
        if known is not None and known.amplitude_sd_g is not None:
            self.drifts = (Drift(1.0, DRIFTS[0].walk, known.amplitude_sd_g, known.time_constants_s),)
        self.state = State()
        self.earlier_headings: list[PositionHeading] = []
        """In the positions before the last restart."""
        self.run = 0
        """Number of segments of the device."""
        self.elapsed_s = 0.0
        """Time from the first sample of the segment to the end of the last slot."""
        self.events: list[str] = []
        """Messages that were not reported yet."""

    def begin_run(self) -> None:
        """Begin a segment of the device."""
        self._restart("the device started anew")
        self.elapsed_s = 0.0
        self.run += 1

    def _restart(self, why: str) -> None:
        """Drop all positions, and report the reason."""
        if self.state.positions:
            self.earlier_headings = self.finish()
            self.events.append(f"alignment: {why}: the alignment starts anew")
        self.state = State()

    def step(self, slot: Slot, magnetic: FloatArray, at_rest: bool, turn: Turn) -> None:
        """Process a slot with its mean magnetic field, (3,), the rest detector's flag, and its turn."""
        gap_s = slot.begun_s - self.elapsed_s
        if gap_s > LONGEST_GAP_S:
            self._restart(f"samples are missing at {self.elapsed_s:.1f} s for {gap_s:.1f} s")
        self.elapsed_s = slot.begun_s + SLOT_S
        motion = self.state.motion
        outcome = motion.classify(slot, at_rest)
        if outcome is Outcome.WAITING:
            return
        if outcome is Outcome.FIRST_REST:
            rest = motion.end()
            self._begin_position(first_attitude(_mean_force(rest)), 0.0, 1, rest)
        elif outcome is Outcome.REST:
            self._add_rest_slot(slot)
        else:
            self._follow_motion(outcome, turn)
        if self.state.positions and not self.state.motion.moving:
            if np.isfinite(magnetic).all():
                self.state.positions[-1].magnetic += magnetic
            if self.state.rest_s >= self.state.due_s:
                self._update_heading()

    def _add_rest_slot(self, slot: Slot) -> None:
        """Add a slot at rest to the record, and follow a creep by the vertical gyro."""
        state, here = self.state, self.state.positions[-1]
        here.record.add(slot)
        state.rest_s += slot.length_s
        state.motion.add_rest(slot.rate)
        if here.fit is not None and here.fit.creep_s:
            vertical = float(state.attitude[2] @ slot.rate)
            state.since_fit.yaw += slot.length_s * (vertical - self.earth_vertical)
            state.since_fit.creep_s += slot.length_s

    def _begin_position(
        self, attitude: FloatArray, variance: float, number: int, rest: Sequence[Slot]
    ) -> None:
        """Begin a position whose record starts with these slots."""
        state, first, slots_per_row = self.state, rest[0], 1
        if max(slot.samples for slot in rest) == 1:  # each row must last for two samples: none stays empty
            interval = (rest[-1].index - first.index) / (len(rest) - 1)
            slots_per_row = 1 << math.ceil(math.log2(2.0 * interval))
        record = Record(first.index, slots_per_row)
        state.attitude = attitude
        state.positions.append(Position(attitude, variance, number, record))
        state.due_s = state.rest_s + FIRST_FIT_S
        for slot in rest:
            self._add_rest_slot(slot)

    def _follow_motion(self, outcome: Outcome, turn: Turn) -> None:
        """Rotate the attitude by the slot's turn, and act on the end of the motion."""
        state, motion = self.state, self.state.motion
        state.attitude = state.attitude @ motion.follow(turn)
        if outcome is Outcome.LOST:
            self._restart(f"the unit turned at {motion.pending[0].begun_s:.1f} s for {LONGEST_MOTION_S:g} s")
        elif outcome is Outcome.SAME_ATTITUDE:
            state.attitude = state.positions[-1].attitude
            for slot in motion.end():
                self._add_rest_slot(slot)
        elif outcome is Outcome.TURNED:
            self._end_turn()

    def _end_turn(self) -> None:
        """Begin a position after a turn; restart if the angle of the turn is unknown."""
        state, motion, errors = self.state, self.state.motion, self.errors
        before, rest, begun_s = state.positions[-1], motion.pending[-CALM_SLOTS:], motion.pending[0].begun_s
        force = _mean_force(rest[CALM_SLOTS // 2 :])
        attitude, seconds = upright(state.attitude[0], force), rest[0].begun_s - begun_s
        variance = motion.azimuth_variance(before.attitude, seconds, errors.scale)
        variance += motion.unexplained_variance(
            before.attitude, attitude[2], errors.scale, math.sqrt(2.0) * errors.accel_bias
        )
        if variance > ANY_ANGLE_SD**2:
            self._restart(f"the unit turned at {begun_s:.1f} s by an angle that is not known")
            return
        new = angle_of(motion.turn.rotation) > NEW_POSITION
        angle = math.degrees(-yaw_between(before.attitude, attitude))
        sd = math.degrees(math.sqrt(variance))
        self.events.append(
            f"alignment: the unit turned at {begun_s:.1f} s for {seconds:.1f} s: left out; "
            f"{'a new position, ' if new else ''}turned by {angle:.2f}° ± {sd:.2f}° about the vertical"
        )
        self._fit_position()
        before.record.sums = np.empty((0, 7))
        motion.end()
        motion.recent.clear()
        state.since_fit.azimuth_variance += variance
        self._begin_position(attitude, before.azimuth_variance + variance, before.number + new, rest)

    @property
    def errors(self) -> SensorErrors:
        """Standard deviations of the sensor errors, declared or from the noise of the quietest gyro."""
        fits = [one.fit for one in self.state.positions if one.fit is not None]
        noise = math.sqrt(min((fit.white for fit in fits), default=0.0))
        return sensor_errors(noise, self.parameters, any(fit.creep_s for fit in fits))

    def _fit_position(self) -> PositionFit | None:
        """Fit the present position, and its plain and Hann-weighted mean of the gyros."""
        state, here = self.state, self.state.positions[-1]
        if not here.record.rows()[0].any():
            return None
        data = horizontal_rows(here.record, here.attitude, self.earth_vertical, self.parameters.known_warm_up)
        here.fit = fit_position(data, self.earth_vertical, self.drifts)
        if here.fit is not None:
            rate = data.rate[data.valid]
            bias = state.posterior.bias_size if state.posterior else 0.0
            for name, taper, factor in (("gyro_mean", np.ones, 1.0), ("hann_mean", np.hanning, 1.5)):
                mean = complex(taper(len(rate)) @ rate)
                sd = math.sqrt(factor * here.fit.white / here.record.rest_s + bias**2) / self.earth_horizontal
                state.means[name] = Fitted(state.rest_s, cmath.phase(mean), min(sd, ANY_ANGLE_SD))
        return here.fit

    def _update_heading(self) -> None:
        """Fit the present position, and update the heading by the fits of all positions."""
        state, yaw, rest_s = self.state, self.state.since_fit.yaw, self.state.positions[-1].record.rest_s
        state.due_s = state.rest_s + min(max(rest_s / 3.0, 1.0), LONGEST_REFIT_S)
        last = self._fit_position()
        if last is None:
            return
        fitted = [(one.fit, one.azimuth_variance) for one in state.positions if one.fit]
        fits, variances = zip(*fitted, strict=True)
        rough_north = cmath.phase(last.moments()[0][0])
        if state.posterior is not None:
            rough_north = state.posterior.north - yaw
        new = heading_posterior(fits, np.array(variances), self.latitude, self.errors, rough_north)
        # What no hypothesis explains shows as a heading that moves from fit to fit.  A chart shows 400 fits.
        history = [one._replace(north=one.north - yaw) for one in state.history[-400:]]
        recent = [one.north for one in history if one.rest_s >= state.rest_s - RECENT_SHARE * rest_s]
        moved = max((abs(math.remainder(new.north - north, 2.0 * math.pi)) for north in recent), default=0.0)
        sd = min(max(new.sd, moved), ANY_ANGLE_SD)
        state.history = [*history, Fitted(state.rest_s, new.north, sd)]
        state.posterior, state.since_fit = new._replace(sd=sd), SinceFit()
        # Settled when sigma falls to the wanted one, and no longer when it exceeds 1.25 times that.
        wanted = math.radians(self.parameters.settled_deg)
        if not (self.observable and self.heading_sd <= 1.25 * wanted):
            state.settled_s = None
        elif state.settled_s is None and self.heading_sd <= wanted:
            state.settled_s = self.elapsed_s

    @property
    def heading_sd(self) -> float:
        """Standard deviation of the heading, rad: of the last fit, and of creep and turns since; or NaN."""
        state = self.state
        if state.posterior is None:
            return math.nan
        creep = state.posterior.bias_size * state.since_fit.creep_s
        variance = state.posterior.sd**2 + state.since_fit.azimuth_variance + creep**2
        if state.motion.moving:
            before, seconds = state.positions[-1].attitude, state.motion.moving_s
            variance += state.motion.azimuth_variance(before, seconds, self.errors.scale)
        return min(math.sqrt(variance), ANY_ANGLE_SD)

    @property
    def observable(self) -> bool:
        """Whether the heading is shown: its standard deviation is below `observable_deg`."""
        return self.heading_sd < math.radians(self.parameters.observable_deg)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Headings by the joint fit and the means of the gyros, NaN if not observable; none before a fit."""
        state = self.state
        if state.posterior is None:
            return {}
        joint = Fitted(state.rest_s, state.posterior.north - state.since_fit.yaw, self.heading_sd)
        direction = direction_of(state.attitude) if self.observable else math.nan
        return {
            name: Estimate((one.north - direction) % (2.0 * math.pi), one.sd)
            for name, one in {"joint": joint, **state.means}.items()
        }

    @property
    def magnetic_heading(self) -> float:
        """Heading from magnetic north by the magnetometer's mean in this position, rad; NaN without one."""
        if not self.state.positions or not self.state.positions[-1].magnetic.any():
            return math.nan
        ahead, left, _ = (self.state.attitude @ self.state.positions[-1].magnetic).tolist()
        return (math.atan2(left, ahead) - direction_of(self.state.attitude)) % (2.0 * math.pi)

    @property
    def remaining_s(self) -> float | None:
        """Time until white noise alone would reach the wanted sigma; None if unknown or never."""
        state, posterior = self.state, self.state.posterior
        if posterior is None or not self.observable:
            return None
        wanted = math.radians(self.parameters.settled_deg)
        if self.heading_sd <= wanted:
            return 0.0
        left = wanted**2 - posterior.bias_sd**2
        return max(state.rest_s * (posterior.noise_sd**2 / left - 1.0), 1.0) if left > 0.0 else None

    @property
    def turned(self) -> float:
        """Angle about the vertical since the previous position, rad, clockwise; also during a turn."""
        places, moving = self.state.positions, self.state.motion.moving
        before = [one for one in places if moving or one.number < places[-1].number]
        return -yaw_between(before[-1].attitude, self.state.attitude) if before else 0.0

    def finish(self) -> list[PositionHeading]:
        """Fit the rest since the last fit; return the heading in each position."""
        state, found = self.state, []
        if state.positions:
            self._update_heading()
        if state.posterior is None:
            return self.earlier_headings
        north, now = state.posterior.north, state.positions[-1].azimuth_variance
        for one in reversed(state.positions):
            sd = min(math.sqrt(state.posterior.sd**2 + abs(now - one.azimuth_variance)), ANY_ANGLE_SD)
            shown = north if sd < math.radians(self.parameters.observable_deg) else math.nan
            heading = (shown - direction_of(one.attitude)) % (2.0 * math.pi)
            found.append(PositionHeading(self.run, one.record.begun_s, one.record.ended_s, heading, sd))
            north += one.fit.yaw if one.fit is not None else 0.0
        return self.earlier_headings + found[::-1]


def _mean_force(slots: Sequence[Slot]) -> FloatArray:
    """Return the mean specific force of slots, m/s², (3,)."""
    return np.asarray(np.mean([slot.values[3:] for slot in slots], axis=0))
