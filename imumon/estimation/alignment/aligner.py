"""The alignment slot by slot: rest and turns, the record of each position, and now and then a new fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment.hypotheses import DRIFTS, Drift, PositionFit, fit_position
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
)  # fmt: skip
from imumon.estimation.alignment.posterior import Heading, heading_posterior
from imumon.estimation.alignment.prior import SensorErrors, sensor_errors
from imumon.estimation.alignment.record import (
    Record,
    direction_of,
    first_attitude,
    levelled,
    turned_about_vertical,
    upright,
)  # fmt: skip
from imumon.estimation.alignment.status import ANY_ANGLE_SD, Estimate, Position
from imumon.filters.turns import Turns
from imumon.geodesy import EARTH_RATE

SLOT_S = 0.25
FIRST_FIT_S, LONGEST_REFIT_S = 3.0, 60.0
"""A position is fitted when it has so much rest, then when that grew by a third, sigma falling by an eighth,
but at least every minute."""
LONGEST_GAP_S = 30.0
"""After a longer gap the alignment begins anew."""
KNOWN_REST = 0.01
"""Earth rates: error of the vertical gyro's rate at rest, which turns a heading by 0.0025° in the minute
between two fits."""
MOST_POSITIONS = 100
"""The latest positions make the heading, so that a fit takes no ever longer time."""


@dataclass
class State:
    """All that is remembered."""

    motion: Motion = field(default_factory=Motion)
    positions: list[Stance] = field(default_factory=list)
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    """Body axes to the reference frame, now, (3, 3)."""
    direction: float = 0.0
    """Direction of the body in that frame, rad, counter-clockwise."""
    first_vertical: tuple[float, ...] = (math.nan,) * 3
    """Vertical of the first position, body axes."""
    field_sum: list[float] = field(default_factory=lambda: [0.0] * 4)
    """Of the magnetometer in this position, body axes, and its samples."""
    found: Heading | None = None
    found_turns: float = 0.0
    """Turn variance of the last position in it, rad²."""
    sd: float = math.nan
    """Of the heading at the last fit, and of turns since, rad; NaN before a fit."""
    vertical_rest: float = math.nan
    rest_sd: float = 0.0
    """Rate of the vertical gyro at rest by the last fit, and its standard deviation, rad/s."""
    crept: float = 0.0
    followed_s: float = 0.0
    """Angle about the vertical that it has shown since, rad, counter-clockwise, and in which time."""
    means: dict[str, Estimate] = field(default_factory=dict)
    ended_s: float = 0.0
    """End of the last slot, since the first sample."""
    counted_s: float = 0.0
    """Time at rest."""
    due_s: float = FIRST_FIT_S
    """Time at rest at which the next fit is due."""
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
        self.state = State(events=self.state.events, restarts=self.state.restarts)
        self.run += 1

    def begin_anew(self, why: str) -> None:
        """Forget all positions and say why."""
        self.past, old = self.finish(), self.state
        old.events.append(f"alignment: {why}: the alignment starts anew")
        self.state = State(
            ended_s=old.ended_s, shaken_s=old.shaken_s, events=old.events, disturbed=old.disturbed,
            restarts=old.restarts + 1,
        )  # fmt: skip

    def step(self, slot: Slot, magnetic: Sequence[float], at_rest: bool, turns: Turns, k: int) -> None:
        """Go on by a slot, its mean of the magnetometer, (3,), whether it is called rest, and turn k."""
        gap = slot.time_s - 0.5 * slot.length_s - self.state.ended_s
        if self.state.positions and gap > max(SLOT_S, 2.5 * slot.length_s):
            self._bridge(gap, slot)
        state = self.state
        state.ended_s = slot.ended_s
        outcome = state.motion.classify(slot, at_rest)
        if outcome is Outcome.REST:
            self._count(slot)
        elif outcome is Outcome.FIRST_REST:
            held = state.motion.end()
            self._begin_position(
                first_attitude(np.mean([one.values[3:] for one in held], axis=0)), 0.0, 1, held
            )
            state.first_vertical = tuple(state.attitude[2].tolist())
        elif outcome is not Outcome.WAITING:
            self._moved(outcome, turns, k)
        if self.resting:
            if math.isfinite(sum(magnetic)):
                new = *(slot.samples * value for value in magnetic), slot.samples
                self.state.field_sum = [a + b for a, b in zip(self.state.field_sum, new, strict=True)]
            if self.state.counted_s >= self.state.due_s:
                self.evaluate()

    def _bridge(self, gap: float, slot: Slot) -> None:
        """Fill the record where slots are missing, or begin anew."""
        state = self.state
        if gap > LONGEST_GAP_S:
            self.begin_anew(f"samples are missing at {state.ended_s:.1f} s for {gap:.1f} s")
        elif not state.motion.turning:
            missing = max(round(gap / slot.length_s), 1)
            for j in range(missing):
                self._record.add(0.0, slot.values, state.ended_s + gap * (j + 1) / missing, 0.0)

    @property
    def resting(self) -> bool:
        """Whether the unit rests in a position."""
        return bool(self.state.positions) and not self.state.motion.turning

    @property
    def _record(self) -> Record:
        record = self.state.positions[-1].record
        assert record is not None
        return record

    def _count(self, slot: Slot) -> None:
        """Count a slot at rest."""
        state = self.state
        self._record.add(slot.samples, slot.values, slot.ended_s, slot.length_s)
        state.counted_s += slot.length_s
        state.motion.rest(slot.rate)
        if not math.isnan(state.vertical_rest):
            state.crept += slot.length_s * (float(state.attitude[2] @ slot.values[:3]) - state.vertical_rest)
            state.followed_s += slot.length_s

    def _begin_position(self, attitude: FloatArray, turns: float, number: int, rest: Sequence[Slot]) -> None:
        """Begin a position with slots at rest."""
        state, begun_s = self.state, rest[0].ended_s - rest[0].length_s
        self._stand(attitude)
        state.positions.append(Stance(attitude, turns, Record(begun_s), number, begun_s))
        state.due_s = state.counted_s + FIRST_FIT_S
        state.field_sum = [0.0] * 4
        for slot in rest:
            self._count(slot)

    def _stand(self, attitude: FloatArray) -> None:
        self.state.attitude, self.state.direction = attitude, direction_of(attitude)

    def _moved(self, outcome: Outcome, turns: Turns, k: int) -> None:
        """Follow a motion, and end it."""
        state, motion = self.state, self.state.motion
        assert motion.base is not None
        if len(motion.held) == 1 and state.rest_sd < KNOWN_REST * EARTH_RATE and state.found is not None:
            # The unit may creep about the vertical before it is turned.
            up = state.attitude[2]
            motion.base = motion.base + up * (state.vertical_rest - float(up @ motion.base))
        self._stand(state.attitude @ motion.follow(turns.at(k)))
        if outcome is Outcome.LOST:
            self.begin_anew(f"the unit turned at {motion.begun_s:.1f} s for {LONGEST_S:g} s")
        elif outcome is Outcome.BACK:
            self._stand(state.positions[-1].attitude)
            for slot in motion.end():
                self._count(slot)
        elif outcome is Outcome.TURNED:
            self._turned()
        self.state.sd = self._sd()

    def _turned(self) -> None:
        """Begin a position after a turn; begin anew when nobody can say by which angle."""
        state, motion, errors = self.state, self.state.motion, self.errors
        before, rest, begun_s = state.positions[-1], motion.held[-CALM:], motion.begun_s
        force = np.mean([slot.values[3:] for slot in rest[CALM // 2 :]], axis=0)
        attitude, seconds = upright(state.attitude, force), rest[0].ended_s - rest[0].length_s - begun_s
        variance = turn_variance(
            motion.turned, before.attitude, force / math.sqrt(force @ force), seconds, motion.noise,
            errors.scale, math.sqrt(2.0) * errors.level,
        )  # fmt: skip
        if variance > ANY_ANGLE_SD**2:
            self.begin_anew(f"the unit turned at {begun_s:.1f} s by an angle that is not known")
            return
        new = motion.angle > NEW_POSITION
        angle = math.degrees(-turned_about_vertical(before.attitude, attitude))
        sd = math.degrees(math.sqrt(variance))
        state.disturbed += 1
        state.shaken_s += seconds
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
        """What the sensors may be wrong by, as declared or by the noise of the quietest gyro."""
        white = [one.fit.white for one in self.state.positions if one.fit is not None]
        return sensor_errors(math.sqrt(min(white, default=0.0)), self.parameters)

    def _warm_up(self) -> tuple[FloatArray, FloatArray, Sequence[Drift]]:
        """Return time constants, s, and amplitudes, g, of the known warm-up, and drifts beside it."""
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
        """Fit the position of now, and its plain and Hann-weighted mean of the gyros."""
        state, record = self.state, self._record
        if not (record.whole_rows[:, 0] > 0.0).any():
            return
        tau_s, amplitude, drifts = self._warm_up()
        data = levelled(record, state.positions[-1].attitude, self.earth_vertical, tau_s, amplitude)
        fit = state.positions[-1].fit = fit_position(data, self.earth_vertical, drifts)
        if fit is None:
            return
        rate, size = data.rate[data.valid], state.found.size_sd if state.found else 0.0
        for name, taper, factor in (("gyro_mean", np.ones, 1.0), ("hann_mean", np.hanning, 1.5)):
            mean = complex(taper(len(rate)) @ rate)
            sd = math.sqrt(factor * fit.white / record.counted_s + size**2) / self.level_rate
            state.means[name] = Estimate(math.atan2(mean.imag, mean.real), min(sd, ANY_ANGLE_SD))

    def evaluate(self) -> None:
        """Fit the position of now and renew the heading."""
        state = self.state
        self._fit_position()
        fitted = [(one.fit, one.turn_variance) for one in state.positions if one.fit][-MOST_POSITIONS:]
        fits, turns = [one for one, _ in fitted], [turn for _, turn in fitted]
        here_s = self._record.counted_s
        after_s = min(here_s / 3.0, LONGEST_REFIT_S)
        if state.positions[-1].fit is not None:
            state.found = heading_posterior(fits, np.array(turns), self.latitude, self.errors)
            state.found_turns, state.crept = turns[-1], 0.0
            self._take_rest_rate(fits, state.found.size_sd)
            state.sd = self._sd()
            self._settle()
            # A bias that hides the north goes on to do so until the unit is turned.
            if state.found.bias_sd > self.level_rate * math.radians(self.parameters.observable_deg):
                after_s = here_s
        state.due_s = state.counted_s + max(after_s, 1.0)

    def _take_rest_rate(self, fits: Sequence[PositionFit], bias_sd: float) -> None:
        """Note what the vertical gyro reads at rest, by the last position in which it was not turning."""
        state = self.state
        state.vertical_rest, state.rest_sd, state.followed_s = self.earth_vertical, bias_sd, 0.0
        for one in reversed(fits):
            tilted = float(np.sum((one.attitude[2] - state.attitude[2]) ** 2))
            sd = math.sqrt(one.vertical_variance + tilted * bias_sd**2)
            if sd < min(KNOWN_REST * EARTH_RATE, bias_sd):
                state.vertical_rest, state.rest_sd = one.vertical, sd
                return

    def _settle(self) -> None:
        """Note when sigma fell to what is wanted; it remains settled until sigma is larger by a quarter."""
        state, wanted = self.state, math.radians(self.parameters.settled_deg)
        if not (self.observable and state.sd <= 1.25 * wanted):
            state.settled_s = None
        elif state.settled_s is None and state.sd <= wanted:
            state.settled_s = state.ended_s

    @property
    def heading_sd(self) -> float:
        """Standard deviation of the heading of now, rad; NaN before a fit."""
        state = self.state
        return min(math.hypot(state.sd, state.rest_sd * state.followed_s), ANY_ANGLE_SD)

    @property
    def observable(self) -> bool:
        """Whether the heading is known well enough to be shown."""
        return self.heading_sd < math.radians(self.parameters.observable_deg)

    def _sd(self) -> float:
        """Return the standard deviation of the heading with that of turns since the last fit, rad."""
        state, motion = self.state, self.state.motion
        if state.found is None:
            return math.nan
        variance = state.found.sd**2 + max(state.positions[-1].turn_variance - state.found_turns, 0.0)
        if motion.turning:
            variance += turn_variance(
                motion.turned, state.positions[-1].attitude, state.attitude[2], motion.moving_s, motion.noise,
                self.errors.scale, 1.0,
            )  # fmt: skip
        return min(math.sqrt(variance), ANY_ANGLE_SD)

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
        if state.motion.turning:
            return -turned_about_vertical(places[-1].attitude, state.attitude)
        before = [one for one in places if one.number < places[-1].number]
        return -turned_about_vertical(before[-1].attitude, places[-1].attitude) if before else 0.0

    def finish(self) -> list[Position]:
        """Fit what has come since the last fit; return where the unit stood still until now."""
        state, stood = self.state, list(self.past)
        if self.resting:
            self.evaluate()
        if state.found is None:
            return stood
        north, now = state.found.north, state.positions[-1].turn_variance
        for one in reversed(state.positions):
            sd = min(math.sqrt(state.found.sd**2 + abs(now - one.turn_variance)), ANY_ANGLE_SD)
            shown = north if sd < math.radians(self.parameters.observable_deg) else math.nan
            ended_s = one.ended_s if one.record is None else one.record.ended_s
            heading = (shown - direction_of(one.attitude)) % (2.0 * math.pi)
            stood.insert(len(self.past), Position(self.run, one.begun_s, ended_s, heading, sd))
            north += one.fit.crept if one.fit is not None else 0.0
        return stood
