"""The alignment slot by slot: rest and turns, the record of each position, and from time to time a new fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import DRIFTS, Drift, fit_position
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.positions import (
    CALM,
    LONGEST_S,
    NEW_POSITION,
    Motion,
    Outcome,
    Slot,
    Stance,
    turn_variance,
)
from imumon.estimation.alignment.posterior import Heading, heading_posterior
from imumon.estimation.alignment.prior import SensorErrors, sensor_errors
from imumon.estimation.alignment.record import (
    Record,
    direction_of,
    first_attitude,
    levelled,
    turned_about_vertical,
    upright,
)
from imumon.estimation.alignment.status import ANY_ANGLE_SD, Estimate, Position
from imumon.filters.turns import Turns
from imumon.geodesy import DEG_PER_H, EARTH_RATE

SLOT_S = 0.25
REFIT_SHARE, REFIT_S, FIRST_FIT_S = 1.0 / 3.0, (1.0, 60.0), 3.0
"""A position is fitted anew when its time at rest grew by a third, sigma falling by an eighth; between these, s."""
LONGEST_GAP_S = 30.0
"""After a longer gap the alignment begins anew."""
MOST_POSITIONS = 100
"""The latest positions make the heading."""
STILL_SETTLED = 1.25
"""A settled heading remains settled until its sigma is larger by this factor."""


@dataclass
class State:
    """All that is remembered.

    Parameters
    ----------
    attitude : array, (3, 3)
        Body axes to the reference frame, now.
    direction : float
        Direction of the body in that frame, rad, counter-clockwise.
    crept : float
        Angle about the vertical that the vertical gyro has shown since the last fit, rad, counter-clockwise.
    vertical_rest : float
        What it reads at rest, rad/s.
    field_sum : list of float
        Of the magnetometer in this position, body axes, and its samples.
    ended_s : float
        End of the last slot.
    due_s : float
        Time counted at which the next fit is due.
    disturbed, restarts : int
        How often something was left out, and how often the alignment began anew.
    """

    motion: Motion = field(default_factory=Motion)
    positions: list[Stance] = field(default_factory=list)
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    direction: float = 0.0
    crept: float = 0.0
    vertical_rest: float = math.nan
    vertical: tuple[float, float, float] = (0.0, 0.0, 1.0)
    field_sum: list[float] = field(default_factory=lambda: [0.0] * 4)
    found: Heading | None = None
    found_variance: float = 0.0
    heading_sd: float = math.nan
    first_vertical: tuple[float, float, float] | None = None
    means: dict[str, Estimate] = field(default_factory=dict)
    now_s: float = 0.0
    ended_s: float = 0.0
    slot_s: float = 0.0
    counted_s: float = 0.0
    counted_before_s: float = 0.0
    due_s: float = FIRST_FIT_S
    shaken_s: float = 0.0
    settled_s: float | None = None
    events: list[str] = field(default_factory=list)
    disturbed: int = 0
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
        """How often the device has begun."""
        self.past: list[Position] = []
        """Where the unit stood before the alignment began anew."""

    def begin_run(self) -> None:
        """Begin a segment of the device."""
        if self.state.positions:
            self.begin_anew("the device started anew")
        old = self.state
        self.run += 1
        self.state = State(events=old.events, restarts=old.restarts)

    def begin_anew(self, why: str) -> None:
        """Forget all positions; say why, when there were any."""
        self.past, old = self.finish(), self.state
        self.state = State(
            now_s=old.now_s, ended_s=old.ended_s, slot_s=old.slot_s, shaken_s=old.shaken_s, events=old.events,
            disturbed=old.disturbed, restarts=old.restarts,
        )  # fmt: skip
        if old.positions:
            self.state.restarts += 1
            self.state.events.append(f"alignment: {why}: the alignment starts anew")

    def step(self, slot: Slot, magnetic: Sequence[float], at_rest: bool, turns: Turns, k: int) -> None:
        """Go on by a slot, its mean of the magnetometer (3,), and turn k."""
        self._bridge(slot)
        state = self.state
        state.now_s, state.ended_s, state.slot_s = (
            slot.time_s,
            slot.time_s + 0.5 * slot.length_s,
            slot.length_s,
        )
        outcome = state.motion.classify(slot, at_rest)
        if outcome is Outcome.REST:
            self._count(slot)
        elif outcome is Outcome.FIRST_REST:
            self._first_rest()
        elif outcome is not Outcome.WAITING:
            self._moved(outcome, turns, k)
        if self.resting:
            self._rest(slot, magnetic)

    def _bridge(self, slot: Slot) -> None:
        """Fill the record where slots are missing, or begin anew."""
        state = self.state
        gap = slot.time_s - 0.5 * slot.length_s - state.ended_s
        if not state.positions or gap <= max(SLOT_S, 2.5 * slot.length_s):
            return
        if gap > LONGEST_GAP_S:
            self.begin_anew(f"samples are missing at {state.ended_s:.1f} s for {gap:.1f} s")
        elif not state.motion.turning:
            missing = max(round(gap / slot.length_s), 1)
            for j in range(missing):
                self._leave_out(state.ended_s + gap * (j + 1) / missing, slot)

    @property
    def resting(self) -> bool:
        """Whether the unit rests in a position."""
        return bool(self.state.positions) and not self.state.motion.turning

    def _record(self) -> Record:
        record = self.state.positions[-1].record
        assert record is not None
        return record

    def _leave_out(self, ended_s: float, slot: Slot) -> None:
        self._record().add(0.0, slot.values, ended_s, slot.length_s)

    def _count(self, slot: Slot) -> None:
        """Count a slot at rest."""
        state = self.state
        record = self._record()
        record.add(slot.samples, slot.values, slot.time_s + 0.5 * slot.length_s, slot.length_s)
        state.counted_s += slot.length_s
        state.motion.rest(slot.rate)
        if state.vertical_rest == state.vertical_rest:
            (x, y, z), (a, b, c) = slot.rate, state.vertical
            state.crept += slot.length_s * (a * x + b * y + c * z - state.vertical_rest)

    def _rest(self, slot: Slot, magnetic: Sequence[float]) -> None:
        state = self.state
        if math.isfinite(sum(magnetic)):
            for axis, value in enumerate(magnetic):
                state.field_sum[axis] += slot.samples * value
            state.field_sum[3] += slot.samples
        if state.counted_s >= state.due_s:
            self.evaluate()

    def _stand(self, attitude: FloatArray) -> None:
        self.state.attitude, self.state.direction = attitude, direction_of(attitude)
        x, y, z = attitude[2].tolist()
        self.state.vertical = x, y, z

    def _begin_position(self, attitude: FloatArray, variance: float, number: int, begun_s: float) -> None:
        """Begin a record; the rows of the position before are no longer needed."""
        state = self.state
        self._stand(attitude)
        state.positions.append(Stance(attitude, variance, Record(begun_s), number, begun_s))
        state.counted_before_s = state.counted_s
        state.due_s = state.counted_s + FIRST_FIT_S
        state.field_sum, state.vertical_rest = [0.0] * 4, math.nan

    def _first_rest(self) -> None:
        held = self.state.motion.settle()
        up = np.mean([slot.values[3:] for slot in held], axis=0)
        self._begin_position(first_attitude(up), 0.0, 1, held[0].time_s - 0.5 * held[0].length_s)
        self.state.first_vertical = self.state.vertical
        for slot in held:
            self._count(slot)

    def _moved(self, outcome: Outcome, turns: Turns, k: int) -> None:
        """Follow a motion, and end it."""
        state, motion = self.state, self.state.motion
        if len(motion.held) == 1 and state.vertical_rest == state.vertical_rest:
            # The unit may creep about the vertical before it is turned.
            assert motion.base is not None
            up = state.attitude[2]
            motion.base = motion.base + up * (state.vertical_rest - float(up @ motion.base))
        self._stand(state.attitude @ motion.follow(turns.at(k)))
        if outcome is Outcome.LOST:
            self.begin_anew(f"the unit turned at {motion.begun_s:.1f} s for {LONGEST_S:g} s")
        elif outcome is Outcome.BACK:
            self._stand(state.positions[-1].attitude)
            for slot in motion.settle():
                self._count(slot)
        elif outcome is Outcome.TURNED:
            self._turned()
        self.state.heading_sd = self._sd()

    def _turned(self) -> None:
        """Begin a position after a turn; begin anew when nobody can say by which angle."""
        state, motion = self.state, self.state.motion
        before, calm, errors = state.positions[-1], motion.held[-CALM // 2 :], self.errors
        force = np.mean([slot.values[3:] for slot in calm], axis=0)
        attitude = upright(state.attitude, force)
        seconds = motion.moving_s - sum(slot.length_s for slot in motion.held[-CALM:])
        variance = turn_variance(
            motion.turned, before.attitude, force / math.sqrt(force @ force), seconds, motion.noise,
            errors.scale, math.sqrt(2.0) * errors.level,
        )  # fmt: skip
        begun_s = motion.begun_s
        if variance > ANY_ANGLE_SD**2:
            self.begin_anew(f"the unit turned at {begun_s:.1f} s by an angle that is not known")
            return
        number = before.number + (motion.angle > NEW_POSITION)
        angle, sd = -turned_about_vertical(before.attitude, attitude), math.sqrt(variance)
        state.disturbed += 1
        state.events.append(
            f"alignment: the unit turned at {begun_s:.1f} s for {seconds:.1f} s: left out; "
            f"{'a new position, ' if number > before.number else ''}"
            f"turned by {math.degrees(angle):.2f}° ± {math.degrees(sd):.2f}° about the vertical"
        )
        self._evaluate_position()
        before.record, before.ended_s = None, begun_s
        held = motion.settle()
        state.shaken_s += seconds
        rest = held[-CALM:]
        self._begin_position(
            attitude, before.turn_variance + variance, number, rest[0].time_s - 0.5 * rest[0].length_s
        )
        state.motion.recent.clear()
        for slot in rest:
            self._count(slot)

    @property
    def errors(self) -> SensorErrors:
        """What the sensors may be wrong by, as declared or by the noise of the quietest gyro."""
        white = [one.fit.white for one in self.state.positions if one.fit is not None]
        return sensor_errors(math.sqrt(min(white, default=0.0)), self.parameters)

    def _warm_up(self) -> tuple[FloatArray, FloatArray, Sequence[Drift]]:
        """Return time constants, s, and amplitudes, g, of the known warm-up, and drifts beside it."""
        known = self.parameters.known_warm_up
        drifts: Sequence[Drift] = DRIFTS
        if known is None:
            return np.ones(3), np.zeros(3), drifts
        if known.amplitude_sd_ug is not None:
            relative = known.time_constant_sd_s / float(np.mean(known.time_constant_s))
            largest = max(map(abs, known.amplitude_ug))
            size = math.hypot(known.amplitude_sd_ug, relative * largest) * 1e-6
            drifts = [Drift(1.0, DRIFTS[0].walk, size)]
        return np.array(known.time_constant_s), np.array(known.amplitude_ug) * 1e-6, drifts

    def _evaluate_position(self) -> None:
        """Fit the position of now."""
        position, record = self.state.positions[-1], self._record()
        if not (record.whole_rows[:, 0] > 0.0).any():
            return
        tau_s, amplitude, drifts = self._warm_up()
        data = levelled(record, position.attitude, self.earth_vertical, tau_s, amplitude)
        position.fit = fit_position(data, self.earth_vertical, drifts)
        if position.fit is not None:
            self._means(data.rate[data.valid], position.fit.white / record.counted_s)

    def _means(self, rate: FloatArray, variance: float) -> None:
        """Renew the plain and the Hann-weighted mean of the gyros in this position."""
        size = self.state.found.size_sd if self.state.found else 0.0
        for name, taper, factor in (("gyro_mean", np.ones, 1.0), ("hann_mean", np.hanning, 1.5)):
            mean = complex(taper(len(rate)) @ rate)
            sd = math.sqrt(factor * variance + size**2) / self.level_rate
            self.state.means[name] = Estimate(math.atan2(mean.imag, mean.real), min(sd, ANY_ANGLE_SD))

    def evaluate(self) -> None:
        """Fit the position of now and renew the heading."""
        state = self.state
        self._evaluate_position()
        last = state.positions[-1]
        if last.fit is not None:
            self._find()
        here_s = state.counted_s - state.counted_before_s
        # A bias that hides the north goes on to do so until the unit is turned.
        after_s = here_s if self.hidden else min(REFIT_SHARE * here_s, REFIT_S[1])
        state.due_s = state.counted_s + max(after_s, REFIT_S[0])

    def _find(self) -> None:
        state = self.state
        fitted = [one for one in state.positions if one.fit is not None][-MOST_POSITIONS:]
        fits = [one.fit for one in fitted if one.fit is not None]
        turned = np.array([one.turn_variance for one in fitted])
        state.found = heading_posterior(fits, turned, self.latitude, self.errors)
        state.found_variance = fitted[-1].turn_variance
        last = fits[-1]
        state.crept = 0.0
        trusted = last.vertical_variance < (EARTH_RATE * 1e-2) ** 2
        state.vertical_rest = last.vertical if trusted else math.nan
        state.heading_sd = self._sd()
        self._settle()

    def _settle(self) -> None:
        state = self.state
        wanted, sd = math.radians(self.parameters.settled_deg), self.heading_sd
        if state.settled_s is None and sd <= wanted and self.observable:
            state.settled_s = state.now_s
        elif state.settled_s is not None and not (sd <= STILL_SETTLED * wanted and self.observable):
            state.settled_s = None

    @property
    def observable(self) -> bool:
        """Whether the heading is known well enough to be shown."""
        return self.state.found is not None and self.heading_sd < math.radians(self.parameters.observable_deg)

    @property
    def hidden(self) -> bool:
        """Whether the gyros' bias leaves no heading, however long this position lasts."""
        found = self.state.found
        limit = self.level_rate * math.radians(self.parameters.observable_deg)
        return found is not None and found.bias_sd > limit

    @property
    def heading_sd(self) -> float:
        """Standard deviation of the heading of now, rad; NaN before a fit."""
        return self.state.heading_sd

    def _sd(self) -> float:
        """Return the standard deviation of the heading with that of turns since the last fit, rad."""
        state, motion = self.state, self.state.motion
        if state.found is None:
            return math.nan
        variance = state.positions[-1].turn_variance - state.found_variance
        if motion.turning and motion.held:
            before, up = state.positions[-1].attitude, state.attitude[2]
            variance += turn_variance(
                motion.turned, before, up, motion.moving_s, motion.noise, self.errors.scale, 1.0
            )
        return min(math.hypot(state.found.sd, math.sqrt(max(variance, 0.0))), ANY_ANGLE_SD)

    @property
    def heading(self) -> float:
        """Heading of now, rad, 0 to 2π; NaN while there is none."""
        found = self.state.found
        return self.as_heading(math.nan if found is None else found.north - self.state.crept)

    def as_heading(self, north: float) -> float:
        """Return the heading of the body from the direction of north in the reference frame."""
        return (north - self.state.direction) % (2.0 * math.pi)

    @property
    def turned(self) -> float:
        """Angle of the last turn about the vertical, or of the one that goes on, rad, clockwise."""
        state, places = self.state, self.state.positions
        if state.motion.turning and places:
            return -turned_about_vertical(places[-1].attitude, state.attitude)
        last = places[-1].number if places else 0
        before = [one for one in places if one.number < last]
        return -turned_about_vertical(before[-1].attitude, places[-1].attitude) if before else 0.0

    def finish(self) -> list[Position]:
        """Fit what has come since the last fit; return where the unit stood still until now."""
        state, stood = self.state, list(self.past)
        if self.resting:
            self.evaluate()
        after = 0.0
        for one in reversed(state.positions):
            if state.found is None:
                break
            variance = abs(state.positions[-1].turn_variance - one.turn_variance)
            sd = min(math.hypot(state.found.sd, math.sqrt(variance)), ANY_ANGLE_SD)
            north = state.found.north if sd < math.radians(self.parameters.observable_deg) else math.nan
            heading = (north + after - direction_of(one.attitude)) % (2.0 * math.pi)
            ended_s = one.ended_s if one.record is None else one.record.ended_s
            stood.insert(len(self.past), Position(self.run, one.begun_s, ended_s, heading, sd))
            after += one.fit.crept if one.fit is not None else 0.0
        return stood
