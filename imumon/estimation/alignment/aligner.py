"""The alignment of one device, slot by slot: motion detection, the record of each position, and the fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import DRIFTS, Drift, fit_position
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.positions import (
    CALM_SLOTS,
    LONGEST_MOTION_S,
    NEW_POSITION,
    Motion,
    Outcome,
    Position,
    Slot,
    turn_variance,
)
from imumon.estimation.alignment.posterior import (
    HeadingPosterior,
    SensorErrors,
    heading_posterior,
    sensor_errors,
)
from imumon.estimation.alignment.record import (
    Record,
    direction_of,
    first_attitude,
    levelled,
    turned_about_vertical,
    upright,
)
from imumon.estimation.alignment.report import ANY_ANGLE_SD, Estimate, PositionHeading
from imumon.filters.turns import Turns
from imumon.geodesy import EARTH_RATE

SLOT_S = 0.25
FIRST_FIT_S, LONGEST_REFIT_S = 10.0, 60.0
"""Time at rest of the first fit of a position, and the longest between two fits; in between a position is
fitted anew when its time at rest has grown by a third, which lowers sigma by an eighth."""
LONGEST_GAP_S = 30.0
"""A longer gap in the data restarts the alignment."""
MOST_POSITIONS, MOST_SIGMAS = 100, 400
"""Only the latest positions enter a fit, which bounds its time; and so many sigmas the chart."""


@dataclass
class State:
    """State of the alignment."""

    motion: Motion = field(default_factory=Motion)
    positions: list[Position] = field(default_factory=list)
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    """Body axes to the reference frame, now, (3, 3)."""
    direction: float = 0.0
    """Direction of the body in that frame, rad, counter-clockwise."""
    first_vertical: tuple[float, ...] = (math.nan,) * 3
    """Vertical of the first position, body axes."""
    field_sum: list[float] = field(default_factory=lambda: [0.0] * 4)
    """Sum of the magnetometer in this position, body axes, and its number of samples."""
    posterior: HeadingPosterior | None = None
    """Of the last fit; None before it."""
    fitted_turn_variance: float = 0.0
    """Turn variance of the last position in that fit, rad²."""
    norths: list[tuple[float, float]] = field(default_factory=list)
    """Time at rest in this position, s, and direction of north, rad, of the fits since half of that time."""
    yaw_since_fit: float = 0.0
    creep_since_fit_s: float = 0.0
    """Rotation about the vertical since the last fit by the vertical gyro, rad, counter-clockwise, and time
    over which it is integrated; 0 for a unit that does not creep."""
    means: dict[str, Estimate] = field(default_factory=dict)
    sigmas: list[tuple[float, float]] = field(default_factory=list)
    """Time at rest, s, and sigma, rad, of each fit."""
    elapsed_s: float = 0.0
    """From the first sample to the end of the last slot."""
    rest_s: float = 0.0
    """Time at rest."""
    due_s: float = FIRST_FIT_S
    """Time at rest at which the next fit is due."""
    disturbed_s: float = 0.0
    settled_s: float | None = None
    events: list[str] = field(default_factory=list)
    disturbances: int = 0
    restarts: int = 0


class Aligner:
    """The alignment of one device, fed with slots.

    Parameters
    ----------
    parameters : AlignmentParameters
    latitude_deg : float
    """

    def __init__(self, parameters: AlignmentParameters, latitude_deg: float) -> None:
        self.parameters = parameters
        self.latitude = math.radians(latitude_deg)
        self.level_rate = EARTH_RATE * math.cos(self.latitude)
        self.earth_vertical = EARTH_RATE * math.sin(self.latitude)
        self.state = State()
        self.run = 0
        """Number of segments of the device so far."""
        self.earlier_headings: list[PositionHeading] = []
        """Headings of the positions before the last restart."""

    def begin_run(self) -> None:
        """Begin a segment of the device."""
        if self.state.positions:
            self.restart("the device started anew")
        self.state = State(events=self.state.events, restarts=self.state.restarts)
        self.run += 1

    def restart(self, why: str) -> None:
        """Drop all positions, and report the reason."""
        self.earlier_headings, old = self.finish(), self.state
        old.events.append(f"alignment: {why}: the alignment starts anew")
        self.state = State(
            elapsed_s=old.elapsed_s,
            disturbed_s=old.disturbed_s,
            events=old.events,
            disturbances=old.disturbances,
            restarts=old.restarts + 1,
        )

    def step(self, slot: Slot, magnetic: Sequence[float], at_rest: bool, turns: Turns, k: int) -> None:
        """Process a slot with its mean magnetic field, (3,), the rest detector's flag, and turn k."""
        gap = slot.time_s - 0.5 * slot.length_s - self.state.elapsed_s
        if self.state.positions and gap > max(SLOT_S, 2.5 * slot.length_s):
            self._fill_gap(gap, slot)
        state = self.state
        state.elapsed_s = slot.ended_s
        outcome = state.motion.classify(slot, at_rest)
        if outcome is Outcome.REST:
            self._add_rest_slot(slot)
        elif outcome is Outcome.FIRST_REST:
            held = state.motion.end()
            self._begin_position(
                first_attitude(np.mean([one.values[3:] for one in held], axis=0)), 0.0, 1, held
            )
            state.first_vertical = tuple(state.attitude[2].tolist())
        elif outcome is not Outcome.WAITING:
            self._follow_motion(outcome, turns, k)
        if self.resting:
            if math.isfinite(sum(magnetic)):
                new = *(slot.samples * value for value in magnetic), slot.samples
                self.state.field_sum = [a + b for a, b in zip(self.state.field_sum, new, strict=True)]
            if self.state.rest_s >= self.state.due_s:
                self.evaluate()

    def _fill_gap(self, gap: float, slot: Slot) -> None:
        """Add invalid rows for missing slots, as rows are equally spaced; restart after a long gap."""
        state = self.state
        if gap > LONGEST_GAP_S:
            self.restart(f"samples are missing at {state.elapsed_s:.1f} s for {gap:.1f} s")
        elif not state.motion.turning:
            missing = max(round(gap / slot.length_s), 1)
            for j in range(missing):
                self._record.add(0.0, slot.values, state.elapsed_s + gap * (j + 1) / missing, 0.0)

    @property
    def resting(self) -> bool:
        """Whether the unit rests in a position."""
        return bool(self.state.positions) and not self.state.motion.turning

    @property
    def _record(self) -> Record:
        record = self.state.positions[-1].record
        assert record is not None
        return record

    def _add_rest_slot(self, slot: Slot) -> None:
        """Add a slot at rest to the record, and follow a creep by the vertical gyro."""
        state = self.state
        self._record.add(slot.samples, slot.values, slot.ended_s, slot.length_s)
        state.rest_s += slot.length_s
        state.motion.add_rest(slot.rate)
        fit = state.positions[-1].fit
        if fit is not None and fit.yaw:
            vertical = float(state.attitude[2] @ slot.rate)
            state.yaw_since_fit += slot.length_s * (vertical - self.earth_vertical)
            state.creep_since_fit_s += slot.length_s

    def _begin_position(self, attitude: FloatArray, turns: float, number: int, rest: Sequence[Slot]) -> None:
        """Begin a position whose record starts with these slots."""
        state, begun_s = self.state, rest[0].ended_s - rest[0].length_s
        self._set_attitude(attitude)
        state.positions.append(Position(attitude, turns, Record(begun_s), number, begun_s))
        state.due_s = state.rest_s + FIRST_FIT_S
        state.field_sum, state.norths = [0.0] * 4, []
        for slot in rest:
            self._add_rest_slot(slot)

    def _set_attitude(self, attitude: FloatArray) -> None:
        self.state.attitude, self.state.direction = attitude, direction_of(attitude)

    def _follow_motion(self, outcome: Outcome, turns: Turns, k: int) -> None:
        """Rotate the attitude by the slot's turn, and act on the end of the motion."""
        state, motion = self.state, self.state.motion
        self._set_attitude(state.attitude @ motion.follow(turns.at(k)))
        if outcome is Outcome.LOST:
            self.restart(f"the unit turned at {motion.begun_s:.1f} s for {LONGEST_MOTION_S:g} s")
        elif outcome is Outcome.SAME_ATTITUDE:
            self._set_attitude(state.positions[-1].attitude)
            for slot in motion.end():
                self._add_rest_slot(slot)
        elif outcome is Outcome.TURNED:
            self._end_turn()

    def _end_turn(self) -> None:
        """Begin a position after a turn; restart if the angle of the turn is unknown."""
        state, motion, errors = self.state, self.state.motion, self.errors
        before, rest, begun_s = state.positions[-1], motion.held[-CALM_SLOTS:], motion.begun_s
        force = np.mean([slot.values[3:] for slot in rest[CALM_SLOTS // 2 :]], axis=0)
        attitude, seconds = upright(state.attitude, force), rest[0].ended_s - rest[0].length_s - begun_s
        variance = turn_variance(
            motion.turned,
            before.attitude,
            force / math.sqrt(force @ force),
            seconds,
            motion.noise,
            errors.scale,
            math.sqrt(2.0) * errors.level,
        )
        if variance > ANY_ANGLE_SD**2:
            self.restart(f"the unit turned at {begun_s:.1f} s by an angle that is not known")
            return
        new = motion.angle > NEW_POSITION
        angle = math.degrees(-turned_about_vertical(before.attitude, attitude))
        sd = math.degrees(math.sqrt(variance))
        state.disturbances += 1
        state.disturbed_s += seconds
        state.events.append(
            f"alignment: the unit turned at {begun_s:.1f} s for {seconds:.1f} s: left out; "
            f"{'a new position, ' if new else ''}turned by {angle:.2f}° ± {sd:.2f}° about the vertical"
        )
        self._fit_position()
        before.record, before.ended_s = None, begun_s
        motion.end()
        motion.recent.clear()
        self._begin_position(attitude, before.turn_variance + variance, before.number + new, rest)

    @property
    def errors(self) -> SensorErrors:
        """Standard deviations of the sensor errors, declared or from the noise of the quietest gyro."""
        fits = [one.fit for one in self.state.positions if one.fit is not None]
        noise = math.sqrt(min((fit.white for fit in fits), default=0.0))
        return sensor_errors(noise, self.parameters, any(fit.yaw for fit in fits))

    def _warm_up(self) -> tuple[FloatArray, FloatArray, Sequence[Drift]]:
        """Return time constants, s, and amplitudes, g, of the declared warm-up, and drift models."""
        known = self.parameters.known_warm_up
        if known is None:
            return np.ones(3), np.zeros(3), DRIFTS
        drifts: Sequence[Drift] = DRIFTS
        if known.amplitude_sd_ug is not None:
            relative = known.time_constant_sd_s / float(np.mean(known.time_constant_s))
            size = math.hypot(known.amplitude_sd_ug, relative * max(map(abs, known.amplitude_ug)))
            drifts = [Drift(1.0, DRIFTS[0].walk, size * 1e-6)]
        return np.array(known.time_constant_s), np.array(known.amplitude_ug) * 1e-6, drifts

    def _fit_position(self) -> None:
        """Fit the present position, and its plain and Hann-weighted mean of the gyros."""
        state, record = self.state, self._record
        if not (record.whole_rows[:, 0] > 0.0).any():
            return
        tau_s, amplitude, drifts = self._warm_up()
        data = levelled(record, state.positions[-1].attitude, self.earth_vertical, tau_s, amplitude)
        fit = state.positions[-1].fit = fit_position(data, self.earth_vertical, drifts)
        if fit is None:
            return
        rate, size = data.rate[data.valid], state.posterior.bias_size if state.posterior else 0.0
        for name, taper, factor in (("gyro_mean", np.ones, 1.0), ("hann_mean", np.hanning, 1.5)):
            mean = complex(taper(len(rate)) @ rate)
            sd = math.sqrt(factor * fit.white / record.rest_s + size**2) / self.level_rate
            state.means[name] = Estimate(math.atan2(mean.imag, mean.real), min(sd, ANY_ANGLE_SD))

    def evaluate(self) -> None:
        """Fit the present position, and update the heading."""
        state, here = self.state, self.state.positions[-1]
        self._fit_position()
        fitted = [(one.fit, one.turn_variance) for one in state.positions if one.fit][-MOST_POSITIONS:]
        after_s = min(self._record.rest_s / 3.0, LONGEST_REFIT_S)
        if here.fit is not None:
            fits, turns = [one for one, _ in fitted], np.array([turn for _, turn in fitted])
            new = heading_posterior(fits, turns, self.latitude, self.errors)
            rest_s, yaw = self._record.rest_s, state.yaw_since_fit
            state.norths = [(at_s, north - yaw) for at_s, north in state.norths if at_s >= 0.5 * rest_s]
            state.norths.append((rest_s, new.north))
            moved = [abs(math.remainder(new.north - north, 2.0 * math.pi)) for _, north in state.norths]
            state.posterior = new = new._replace(sd=min(max(new.sd, *moved, 0.0), ANY_ANGLE_SD))
            state.fitted_turn_variance = here.turn_variance
            state.yaw_since_fit = state.creep_since_fit_s = 0.0
            state.sigmas = [*state.sigmas[-MOST_SIGMAS:], (state.rest_s, self.heading_sd)]
            self._update_settled()
            # A bias that hides the north hides it until the unit is turned, so fits may be rare.
            if new.level_bias_sd > self.level_rate * math.radians(self.parameters.observable_deg):
                after_s = self._record.rest_s
        state.due_s = state.rest_s + max(after_s, 1.0)

    def _update_settled(self) -> None:
        """Set `settled_s` when sigma falls to the wanted one; unset it when sigma exceeds 1.25 times that."""
        state, wanted = self.state, math.radians(self.parameters.settled_deg)
        if not (self.observable and self.heading_sd <= 1.25 * wanted):
            state.settled_s = None
        elif state.settled_s is None and self.heading_sd <= wanted:
            state.settled_s = state.elapsed_s

    @property
    def heading_sd(self) -> float:
        """Standard deviation of the heading with what turned it since the last fit, rad; NaN before a fit."""
        state, motion = self.state, self.state.motion
        if state.posterior is None:
            return math.nan
        here, creep = state.positions[-1], state.posterior.bias_size * state.creep_since_fit_s
        turned = max(here.turn_variance - state.fitted_turn_variance, 0.0)
        variance = state.posterior.sd**2 + turned + creep**2
        if motion.turning:
            variance += turn_variance(
                motion.turned, here.attitude, state.attitude[2], motion.moving_s, motion.noise,
                self.errors.scale, 1.0,
            )  # fmt: skip
        return min(math.sqrt(variance), ANY_ANGLE_SD)

    @property
    def observable(self) -> bool:
        """Whether the heading is known well enough to be shown (`observable_deg`)."""
        return self.heading_sd < math.radians(self.parameters.observable_deg)

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Headings by the joint fit and the means of the gyros, NaN if not observable; none before a fit."""
        state = self.state
        if state.posterior is None:
            return {}
        joint = Estimate(state.posterior.north - state.yaw_since_fit, self.heading_sd)
        observable = self.observable
        return {
            name: Estimate(self.as_heading(one.heading) if observable else math.nan, one.sd)
            for name, one in {"joint": joint, **state.means}.items()
        }

    @property
    def magnetic_heading(self) -> float:
        """Heading from magnetic north by the magnetometer's mean in this position, rad; NaN without one."""
        *field_sum, samples = self.state.field_sum
        if not samples or not self.state.positions:
            return math.nan
        ahead, left, _ = (self.state.attitude @ field_sum).tolist()
        return self.as_heading(math.atan2(left, ahead))

    @property
    def remaining_s(self) -> float | None:
        """Time until white noise alone would reach the wanted sigma; None if unknown or never."""
        state, posterior = self.state, self.state.posterior
        if posterior is None or not self.observable:
            return None
        wanted = math.radians(self.parameters.settled_deg)
        if self.heading_sd <= wanted:
            return 0.0
        left = wanted**2 - (posterior.level_bias_sd / self.level_rate) ** 2
        return max(state.rest_s * (posterior.noise_sd**2 / left - 1.0), 1.0) if left > 0.0 else None

    def as_heading(self, north: float) -> float:
        """Return the heading of the body from the direction of north in the reference frame."""
        return (north - self.state.direction) % (2.0 * math.pi)

    @property
    def turned(self) -> float:
        """Angle about the vertical since the previous position, rad, clockwise; also during a turn."""
        state, places = self.state, self.state.positions
        if state.motion.turning:
            return -turned_about_vertical(places[-1].attitude, state.attitude)
        before = [one for one in places if one.number < places[-1].number]
        return -turned_about_vertical(before[-1].attitude, places[-1].attitude) if before else 0.0

    def finish(self) -> list[PositionHeading]:
        """Fit the rest since the last fit; return the heading in each position."""
        state, headings = self.state, list(self.earlier_headings)
        if self.resting:
            self.evaluate()
        if state.posterior is None:
            return headings
        north, now = state.posterior.north, state.positions[-1].turn_variance
        for one in reversed(state.positions):
            sd = min(math.sqrt(state.posterior.sd**2 + abs(now - one.turn_variance)), ANY_ANGLE_SD)
            shown = north if sd < math.radians(self.parameters.observable_deg) else math.nan
            ended_s = one.ended_s if one.record is None else one.record.ended_s
            heading = (shown - direction_of(one.attitude)) % (2.0 * math.pi)
            headings.insert(
                len(self.earlier_headings), PositionHeading(self.run, one.begun_s, ended_s, heading, sd)
            )
            north += one.fit.yaw if one.fit is not None else 0.0
        return headings
