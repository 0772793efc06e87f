"""The alignment slot by slot: rest and turns, the record, and every second or so a new fit."""

from __future__ import annotations

import cmath
import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.alignment import fit
from imumon.estimation.alignment.account import ANY_ANGLE_SD, Account, Passage, typical_force, typical_scale
from imumon.estimation.alignment.creep import Rest, Usual, upright_turn
from imumon.estimation.alignment.motion import LEAST, Motion, Slot
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.posterior import Heading, Place, heading
from imumon.estimation.alignment.record import Pose, Record
from imumon.estimation.alignment.status import Estimate, Position
from imumon.geodesy import DEG_PER_H, EARTH_RATE, MICRO_G, STANDARD_GRAVITY, forward

SLOT_S = 0.25
RENEWED_SHARE, RENEWED_S = 1.0 / 3.0, (1.0, 60.0)
"""A fit is renewed after so much more of the time that counts in a pose, sigma falling by an eighth; between
these, s."""
LONGEST_S = 120.0
"""After a longer disturbance, or a gap of a quarter of it, the alignment begins anew: an attitude that was
followed for so long has lost what was found."""
SAME_TURN, SAME_LEVEL = 3e-5, 1e-5
"""Angles, rad, below which a unit stands as before; so many cost less than 0.002° of heading."""
TURNED = 0.01
"""rad: less changes a bias by less than a hundredth of itself and tells nothing of it: no new position."""
SIGMAS = 6.0
TYPICAL_BIAS, TYPICAL_ARW, BIAS_POWER = 2.0 * DEG_PER_H, math.radians(0.1) / 60.0, 1.86
SCATTER = 1.5
"""A gyro with the noise N has a bias of about 2 °/h (N / 0.1 °/√h)^1.86; 1.5 is the standard deviation of its
logarithm.  Regression over data sheets, bias and noise in °/h and °/√h: Honeywell HG9900 0.0035 and 0.002,
HG1700 1 and 0.125 (`hg9900_model`, `hg1700_model` of NavToolkit), iMAR FSAS 0.75 and 0.1, Xsens MTi-G 3600
and 3 (Mathematical Problems in Engineering 2013, 435286, table 6)."""
LEAST_ARW, LARGEST_TYPICAL = math.radians(0.002) / 60.0, EARTH_RATE
"""The quietest of them; and a typical bias is not made larger than what leaves no heading anyway."""
SIZES = np.linspace(-4.0, 12.0, 17)
"""Logarithms of the sizes thought of, over the typical one: up to 200 °/h of the best gyros."""
LARGER = int(np.sum(SIZES > 0.0))
WORSE = np.exp([2.0, 4.0, 6.0, 8.0, 10.0])
SOME = np.array([[True, False, False], [False, True, False], [False, False, True]])
SOME = np.concatenate([SOME, ~SOME])
SINGLY = 0.003
"""Gyros that may be worse than the others, by which factors, and the probability of that: up to twice the
earth rate for the best gyros, and as seldom as a normal value beyond three standard deviations."""
UNLIKE = 0.02
"""Probability that a gyro is worse than its class, by any factor, as one that is not calibrated: so little
that it costs nothing where the rates agree with the class, and where they do not, they decide."""
DECLARED = 0.999
"""Probability that a declared bias holds."""


@dataclass
class State:
    """All that is remembered."""

    record: Record = field(default_factory=Record)
    motion: Motion = field(default_factory=Motion)
    poses: list[Pose] = field(default_factory=list)
    attitude: FloatArray = field(default_factory=lambda: np.eye(3))
    """Body axes to the frame of the first pose, now."""
    ahead: float = 0.0
    """Direction of the body in that frame, rad, from its forward to its left."""
    crept: float = 0.0
    """What it has turned about the vertical, unnoticed, since the last fit, rad, counter-clockwise."""
    told_up: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Vertical of the last pose of that fit, body axes."""
    rest: Rest | None = None
    """What the vertical gyro reads at rest, if that is known better than turns ask for."""
    followed_s: float = 0.0
    """Time since that fit in which this was followed."""
    field_sum: list[float] = field(default_factory=lambda: [0.0] * 4)
    """Of the magnetometer in this pose, body axes, and its samples."""
    now_s: float = 0.0
    slot_end_s: float = 0.0
    interval_s: float = 0.0
    counted_s: float = 0.0
    due_s: float = 0.0
    """Time counted at which the next fit is due."""
    shaken_s: float = 0.0
    turns: Account = field(default_factory=Account)
    found: Heading | None = None
    fits: list[fit.PoseFit] = field(default_factory=list)
    means: dict[str, Estimate] = field(default_factory=dict)
    settled_s: float | None = None
    first_angles: tuple[float, float] | None = None
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
        self.state = State()
        self.run = 0
        """How often the device has begun."""
        self.past: list[Position] = []
        """Positions of alignments before this."""

    def snapshot(self) -> State:
        """Return a copy of the state."""
        return copy.deepcopy(self.state)

    def restore(self, saved: State) -> None:
        """Go on from a state that `snapshot` returned."""
        self.state = copy.deepcopy(saved)

    def begin_anew(self, why: str) -> None:
        """Forget all poses; say why, when there were any."""
        self.past, old = self.finish(), self.state
        restarts, events = old.restarts, old.events
        if old.poses:
            restarts += 1
            events.append(f"alignment: {why}: the alignment starts anew")
        self.state = State(
            now_s=old.now_s, slot_end_s=old.slot_end_s, interval_s=old.interval_s, shaken_s=old.shaken_s,
            events=events, disturbed=old.disturbed, restarts=restarts,
        )  # fmt: skip

    def step(self, slot: Slot, magnetic: Sequence[float]) -> None:
        """Go on by a slot, and its mean of the magnetometer, (3,)."""
        state, motion = self.state, self.state.motion
        gap = slot.time_s - 0.5 * slot.length_s - state.slot_end_s
        if state.poses and gap > LONGEST_S / 4.0:
            self.begin_anew(f"samples are missing at {state.slot_end_s:.1f} s for {gap:.1f} s")
            state, motion = self.state, self.state.motion
        elif state.poses and gap > max(SLOT_S, 2.5 * slot.length_s):
            state.record.add(
                state.slot_end_s + 0.5 * gap, 0.0, slot.mean[:3], slot.mean[3:], len(state.poses) - 1
            )
        self._now(slot)
        if not motion.disturbed:
            cause = motion.judge(slot)
            if cause:
                motion.begin(slot, cause)
                self._turns_already()
        if motion.disturbed:
            self._disturbed(slot)
        else:
            motion.go_on(slot)
            self._add(slot, len(state.poses) - 1, counts=True)
        if not motion.disturbed:
            self._at_rest(slot, magnetic)

    def _turns_already(self) -> None:
        """Take the vertical gyro's rate at the last rest for what it reads if it stands."""
        base, up = self.state.motion.base, self.state.attitude[2]
        if base is not None and self.state.rest is not None:
            base += up * (self.state.rest.rate - float(up @ base))

    def _in_another(self, rest: Rest, tilted: FloatArray) -> Rest:
        """Return what is known of rest where up is another by `tilted`, body axes, (3,)."""
        assert self.state.found is not None
        flicker = (self.parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H
        other = float(tilted @ tilted) * self.state.found.supposed_sd**2
        return Rest(rest.rate, rest.variance + other + flicker**2)

    def count(self, slot: Slot, magnetic: Sequence[float]) -> None:
        """Count a slot by which `Motion.rest_on` has gone on."""
        self._now(slot)
        self._add(slot, len(self.state.poses) - 1, counts=True)
        self._at_rest(slot, magnetic)

    def _now(self, slot: Slot) -> None:
        self.state.slot_end_s = slot.time_s + 0.5 * slot.length_s
        self.state.now_s = slot.time_s

    def _at_rest(self, slot: Slot, magnetic: Sequence[float]) -> None:
        """Take the magnetometer of a slot at rest; fit anew when it is time."""
        state = self.state
        if math.isfinite(sum(magnetic)):
            for axis, value in enumerate(magnetic):
                state.field_sum[axis] += slot.samples * value
            state.field_sum[3] += slot.samples
        if state.counted_s >= state.due_s:
            self.evaluate()

    def _stands(self, attitude: FloatArray) -> None:
        """Take a new attitude."""
        self.state.attitude, self.state.ahead = attitude, ahead_of(attitude)
        self._rests()

    def _rests(self) -> None:
        """Note what the vertical gyro reads at rest as the unit lies now."""
        state = self.state
        if state.found is not None:
            rest = self._in_another(state.found.rest, state.attitude[2] - state.told_up)
            state.rest = rest if rest.variance < EARTH_RATE**2 else None

    def _disturbed(self, slot: Slot) -> None:
        """Follow the unit until it rests again."""
        state, motion = self.state, self.state.motion
        self._stands(state.attitude @ motion.follow(slot))
        if not state.poses and not motion.calm:
            motion.passed.clear()
        if state.poses and motion.seconds > LONGEST_S:
            self.begin_anew(f"{motion.cause} at {motion.begun_s:.1f} s for {LONGEST_S:g} s")
        elif motion.rested:
            self._rest()

    def _rest(self) -> None:
        """Begin the first pose, or go on in that of before, or in a new one; count what may count."""
        state, motion = self.state, self.state.motion
        passed, calm = motion.passed, motion.passed[-motion.calm :]
        same = False
        if not state.poses:
            calm = passed = passed[motion.begins() :]
            motion.calm = len(calm)
            up = np.mean([slot.mean[3:] for slot in calm], axis=0)
            up /= np.sqrt(up @ up)
            ahead = forward(up)
            self._stands(np.vstack([ahead, np.cross(up, ahead), up]))
            state.poses.append(Pose(state.attitude, 0.0, state.counted_s))
        else:
            before = len(state.poses) - 1
            same = self._new_pose(calm[-LEAST // 2 :])  # the gyros may be calm before the accelerometers
            if not self.state.poses:
                return
            if not (same and motion.returned):
                state.disturbed += 1
                state.record.leave_out(motion.begun_s - calm[0].length_s)
                state.events.append(self._left_out(same))
                for slot in passed:
                    self._add(slot, before, counts=False)
                passed = []
        motion.rest(same)
        self._settle()
        for slot in passed:
            self._add(slot, len(state.poses) - 1, counts=True)

    def _add(self, slot: Slot, pose: int, counts: bool) -> None:
        """Add a slot to the record of a pose."""
        state = self.state
        weight = float(slot.samples) if counts else 0.0
        state.record.add(slot.time_s, weight, slot.mean[:3], slot.mean[3:], pose)
        if counts:
            state.counted_s += slot.length_s
            if state.rest is not None:
                state.followed_s += slot.length_s
                state.crept += slot.length_s * (float(state.attitude[2] @ slot.mean[:3]) - state.rest.rate)
        else:
            state.shaken_s += slot.length_s

    def _left_out(self, same: bool) -> str:
        """Return what is said of a disturbance that does not count."""
        motion, poses = self.state.motion, self.state.poses
        seconds = motion.seconds - sum(slot.length_s for slot in motion.passed[-motion.calm :])
        said = f"alignment: {motion.cause} at {motion.begun_s:.1f} s for {seconds:.1f} s: left out"
        if same:
            return said
        before, after = poses[-2].attitude, poses[-1].attitude
        new = "a new position, " if rotated(before, after) > TURNED else ""
        angle = -math.degrees(azimuth_between(before, after))
        sd = math.degrees(math.sqrt(poses[-1].passage_variance))
        return f"{said}; {new}turned by {angle:.2f}° ± {sd:.2f}° about the vertical"

    def _new_pose(self, calm: list[Slot]) -> bool:
        """Return whether the unit stands as before a disturbance; else begin a pose.

        Begin anew after a turn that nobody can say the angle of, as where a gyro was saturated.
        """
        state, motion = self.state, self.state.motion
        passage = self._passage(calm[0].time_s)
        usual = motion.usual()
        middle = usual.middle[3:]
        up = np.mean([slot.mean[3:] for slot in calm], axis=0)
        step = np.sqrt(np.sum((up / np.sqrt(up @ up) - middle / np.sqrt(middle @ middle)) ** 2))
        attitude = levelled(state.attitude, up)
        turn = azimuth_between(passage.before, attitude)
        bumped = SIGMAS * float(motion.wander().max()) / STANDARD_GRAVITY
        level = float(usual.spread[3:].max()) / math.sqrt(LEAST) / STANDARD_GRAVITY
        if abs(turn) < max(SAME_TURN, SIGMAS * passage.noise) and step < max(SAME_LEVEL, bumped):
            self._stands(passage.before)
            return True
        self._stands(attitude)
        level_sd = math.hypot(level, math.sqrt(2.0) * self.force_sd)
        scale_sd = self._scale_sd()
        unexplained = passage.unexplained(up / np.sqrt(up @ up), scale_sd, level_sd)
        alone = Account().after(passage, unexplained).azimuth_variance(scale_sd)
        if alone > ANY_ANGLE_SD**2:
            self.begin_anew(f"{motion.cause} at {motion.begun_s:.1f} s, by an angle that is not known")
            return False
        state.turns = state.turns.after(passage, unexplained)
        state.poses.append(Pose(attitude, state.turns.azimuth_variance(scale_sd), state.counted_s, alone))
        state.due_s = state.counted_s
        state.field_sum = [0.0] * 4
        return False

    def _passage(self, until_s: float) -> Passage:
        """Return the turn since the last pose, until a time."""
        motion = self.state.motion
        usual, length_s = motion.usual(), motion.passed[-1].length_s
        seconds = max(until_s - motion.begun_s, length_s)
        noise = float(usual.spread[:3].max()) * math.sqrt(length_s * seconds)
        before = levelled(self.state.poses[-1].attitude, usual.middle[3:])
        return Passage(motion.turned, before, seconds, noise)

    def _scale_sd(self) -> float:
        """Return the standard deviation of the gyros' scale factor, as declared or by their noise."""
        declared = self.parameters.gyro_scale_sd_ppm
        return typical_scale(self._arw) if declared is None else declared * 1e-6

    @property
    def force_sd(self) -> float:
        """Standard deviation of the accelerometers' bias, g, as declared or by the noise of the gyros."""
        declared = self.parameters.accel_bias_sd_ug
        return typical_force(self._arw) if declared is None else declared * 1e-6

    @property
    def _arw(self) -> float:
        return math.sqrt(min((one.quietest for one in self.state.fits), default=0.0))

    def evaluate(self) -> None:
        """Fit anew what may have changed, and renew the heading."""
        state = self.state
        told: list[tuple[Pose, fit.PoseFit, FloatArray]] = []
        for number, pose in enumerate(state.poses):
            own = pose.told or self._fitted(number, pose, told[-1] if told else None)
            if own is not None:
                told.append((pose, *own))
                pose.told = own if number < len(state.poses) - 1 else None
        fits: list[fit.PoseFit] = []
        attitudes: list[FloatArray] = []
        crept = 0.0
        # From now back, in a frame in which the unit lies now as if it had stood in all poses.
        for _, one, attitude in reversed(told):
            back = -crept - one.creep.after
            fits.insert(0, replace(one, mean=one.mean * cmath.exp(1j * back)))
            attitudes.insert(0, upright_turn(back) @ attitude)
            crept += one.creep.before + one.creep.after
        turns = [pose.turn_variance for pose, _, _ in told]
        state.fits = fits
        if fits:
            state.told_up = attitudes[-1][2]
            self._find(fits, attitudes, turns)
            self._rests()
            self._crept(told)
        here_s = state.counted_s - state.poses[-1].counted_s
        # A bias that hides the north goes on to do so until the unit is turned.
        after_s = here_s if self.hidden else min(RENEWED_SHARE * here_s, RENEWED_S[1])
        state.due_s = state.counted_s + max(after_s, RENEWED_S[0])

    def _crept(self, told: Sequence[tuple[Pose, fit.PoseFit, FloatArray]]) -> None:
        """Note how far it has turned unnoticed after each pose."""
        assert self.state.found is not None
        after = 0.0
        for pose, one, _ in reversed(told):
            pose.crept_after = after
            after += one.creep.turned(self.state.found.rest)

    def _find(self, fits: list[fit.PoseFit], attitudes: list[FloatArray], turns: list[float]) -> None:
        """Renew the heading from what the poses tell."""
        state, parameters = self.state, self.parameters
        sizes, log_prior = self._bias_prior(math.sqrt(min(one.quietest for one in fits)))
        place = Place(
            self.latitude, sizes, log_prior, (parameters.gyro_flicker_deg_per_h or 0.0) * DEG_PER_H,
            self.force_sd,
        )  # fmt: skip
        state.found, state.crept, state.followed_s = (
            heading(fits, attitudes, np.array(turns), place),
            0.0,
            0.0,
        )
        self._means()
        self._settle()

    def _fitted(
        self, number: int, pose: Pose, before: tuple[Pose, fit.PoseFit, FloatArray] | None
    ) -> tuple[fit.PoseFit, FloatArray] | None:
        """Return what a pose tells, with the one before, and its attitude with the level of all of it."""
        record = self.state.record
        rows = record.of_pose(number)
        if len(rows) < fit.LEAST_CELLS:
            return None
        weight = record.weight[rows]
        up = weight @ record.force[rows]
        gravity = math.sqrt(up @ up) / weight.sum()
        attitude = levelled(pose.attitude, up)
        time = record.time_s[rows] - record.time_s[rows[0]] + SLOT_S / 2
        level = record.force[rows] @ attitude.T / gravity
        angle = -1j * (level[:, 0] + 1j * level[:, 1]) - self._known(record.time_s[rows], attitude)
        kept = fit.PoseRecord(time, weight, record.rate[rows] @ attitude.T, angle)
        known = None if before is None else self._at_rest_in(attitude, *before[1:])
        found = fit.fit_pose(kept, self._usual(attitude[2]), self._drifts(), known)
        return None if found is None else (found, attitude)

    def _at_rest_in(
        self, attitude: FloatArray, before: fit.PoseFit, attitude_before: FloatArray
    ) -> Rest | None:
        """Return what a pose says of what the vertical gyro reads at rest in the next one."""
        if self.state.found is None:
            return None
        return self._in_another(before.creep.rests.together(), attitude[2] - attitude_before[2])

    def _usual(self, up: FloatArray) -> Usual:
        """Return what a vertical gyro should read at rest; `up` in body axes, (3,)."""
        sizes, log_prior = self._bias_prior(self._arw)
        return Usual(EARTH_RATE * math.sin(self.latitude), sizes**2 @ up**2, log_prior)

    def _known(self, time_s: FloatArray, attitude: FloatArray) -> FloatArray:
        """Return the angle that a known warm-up makes, rad, (n,) complex as the level."""
        warm = self.parameters.known_warm_up
        if warm is None:
            return np.zeros(len(time_s))
        drift = -np.expm1(-time_s[:, None] / np.array(warm.time_constant_s)) * np.array(warm.amplitude_ug)
        seen = drift * MICRO_G / STANDARD_GRAVITY @ attitude.T
        angle: FloatArray = -1j * (seen[:, 0] + 1j * seen[:, 1])
        return angle

    def _drifts(self) -> Mapping[float, float]:
        warm = self.parameters.known_warm_up
        if warm is None or warm.amplitude_sd_ug is None:
            return fit.DRIFTS
        relative = warm.time_constant_sd_s / float(np.mean(warm.time_constant_s))
        return {math.hypot(warm.amplitude_sd_ug, relative * max(map(abs, warm.amplitude_ug))) * 1e-6: 1.0}

    def _bias_prior(self, arw: float) -> tuple[FloatArray, FloatArray]:
        """Return sizes of biases that are thought of, rad/s, (s, 3), and the logs of their probabilities.

        All gyros are of a class, or all are worse, or one or two of them.
        """
        typical = min(TYPICAL_BIAS * (max(arw, LEAST_ARW) / TYPICAL_ARW) ** BIAS_POWER, LARGEST_TYPICAL)
        declared = self.parameters.gyro_bias_sd_deg_per_h
        if declared is None:
            sizes = typical * np.exp(SIZES)
            some = np.where(SOME, (typical * WORSE)[:, None, None], typical).reshape(-1, 3)
            alike = (1.0 - UNLIKE - SINGLY) * _normal(SIZES) + UNLIKE * (SIZES > 0.0) / LARGER
            return np.concatenate([np.tile(sizes[:, None], (1, 3)), some]), np.log(
                np.concatenate([alike, np.full(len(some), SINGLY / len(some))])
            )
        worse = max(typical, declared * DEG_PER_H) * np.exp(SIZES[SIZES > 0.0])
        sizes = np.r_[declared * DEG_PER_H, worse]
        probability = np.r_[DECLARED, np.full(LARGER, (1.0 - DECLARED) / LARGER)]
        return np.tile(sizes[:, None], (1, 3)), np.log(probability)

    def _means(self) -> None:
        """Renew the plain and the Hann-weighted mean of the gyros in the pose of now."""
        state = self.state
        found = state.found
        rows = state.record.of_pose(len(state.poses) - 1)
        if found is None or len(rows) < fit.LEAST_CELLS:
            return
        weight, attitude = state.record.weight[rows], levelled(state.poses[-1].attitude, state.attitude[2])
        rate = state.record.rate[rows] @ attitude.T
        white = state.fits[-1].white / state.fits[-1].seconds
        for name, taper, factor in (("gyro_mean", 1.0, 1.0), ("hann_mean", np.hanning(len(rows)), 1.5)):
            x, y, _ = (weight * taper) @ rate
            sd = math.sqrt(white * factor + found.supposed_sd**2) / self.level_rate
            state.means[name] = Estimate(math.atan2(y, x), min(sd, ANY_ANGLE_SD))

    def _settle(self) -> None:
        state = self.state
        sd = math.inf if state.found is None else self.heading_sd
        wanted = math.radians(self.parameters.settled_deg)
        if state.settled_s is None and sd <= wanted and self.observable:
            state.settled_s = state.now_s
        elif state.settled_s is not None and (sd > STILL_SETTLED * wanted or not self.observable):
            state.settled_s = None

    @property
    def observable(self) -> bool:
        """Whether the bias of the gyros leaves a heading."""
        found = self.state.found
        return found is not None and self.heading_sd < math.radians(self.parameters.observable_deg)

    @property
    def hidden(self) -> bool:
        """Whether the gyros' bias leaves no heading, however long this pose lasts."""
        found = self.state.found
        limit = self.level_rate * math.radians(self.parameters.observable_deg)
        return found is not None and found.bias_sd > limit

    @property
    def heading_sd(self) -> float:
        """Sigma of the heading of now, rad, with that of the turns."""
        state, motion = self.state, self.state.motion
        if state.found is None:
            return math.nan
        variance = state.poses[-1].turn_variance
        if motion.disturbed and motion.passed:
            going_on = state.turns.after(self._passage(state.slot_end_s))
            variance = going_on.azimuth_variance(self._scale_sd())
        if state.rest is not None:
            variance += state.rest.variance * state.followed_s**2
        return min(math.hypot(state.found.sd, math.sqrt(variance)), ANY_ANGLE_SD)

    @property
    def heading(self) -> float:
        """Heading of now, rad, 0 to 2π; NaN while there is none."""
        found = self.state.found
        return self.as_heading(math.nan if found is None else found.north - self.state.crept)

    def finish(self) -> list[Position]:
        """Fit what has come since the last fit; return where the unit stood still until now."""
        state, found = self.state, list(self.past)
        if state.poses:
            self.evaluate()
        for number, pose in enumerate(state.poses):
            times = state.record.time_s[state.record.of_pose(number)]
            if state.found is None or not len(times):
                continue
            sd = min(math.hypot(state.found.sd, math.sqrt(pose.turn_variance)), ANY_ANGLE_SD)
            shown = sd < math.radians(self.parameters.observable_deg)
            north = state.found.north - ahead_of(pose.attitude) + pose.crept_after if shown else math.nan
            found.append(Position(self.run, float(times[0]), float(times[-1]), north % (2.0 * math.pi), sd))
        return found

    @property
    def positions(self) -> list[int]:
        """The poses that are turned against the position before."""
        poses, found = self.state.poses, [0][: len(self.state.poses)]
        for number, pose in enumerate(poses):
            if rotated(poses[found[-1]].attitude, pose.attitude) > TURNED:
                found.append(number)
        return found

    @property
    def turned(self) -> float:
        """Angle of the last turn about the vertical, or of the one that goes on, rad, clockwise."""
        state, poses, last = self.state, self.state.poses, self.positions[-1:]
        if state.motion.disturbed and poses:
            return -azimuth_between(poses[-1].attitude, state.attitude)
        return -azimuth_between(poses[last[0] - 1].attitude, poses[-1].attitude) if any(last) else 0.0

    def as_heading(self, north: float) -> float:
        """Return the heading of the body from the direction of north in the frame of the first pose."""
        return (north - self.state.ahead) % (2.0 * math.pi)


STILL_SETTLED = 1.25
"""A settled heading remains settled until its sigma is larger by this factor."""


def _normal(logarithms: FloatArray) -> FloatArray:
    """Return the probabilities of logarithms of sizes by the scatter of a class."""
    density = np.exp(-0.5 * (logarithms / SCATTER) ** 2)
    return np.asarray(density / density.sum())


def ahead_of(attitude: FloatArray) -> float:
    """Return the direction of a body in the frame of the first pose, rad, from its forward to its left."""
    up = attitude[2]
    ahead = attitude @ forward(up / np.sqrt(up @ up))
    return math.atan2(ahead[1], ahead[0])


def levelled(attitude: FloatArray, up: FloatArray) -> FloatArray:
    """Return an attitude (3, 3) whose vertical is that of a specific force (3,), with the same azimuth."""
    up = up / np.sqrt(up @ up)
    ahead = attitude[0] - (attitude[0] @ up) * up
    ahead /= np.sqrt(ahead @ ahead)
    return np.vstack([ahead, np.cross(up, ahead), up])


def rotated(before: FloatArray, after: FloatArray) -> float:
    """Return about the angle, rad, between two attitudes (3, 3)."""
    return math.sqrt(0.5 * float(np.sum((after - before) ** 2)))


def azimuth_between(before: FloatArray, after: FloatArray) -> float:
    """Return the angle about the vertical by which a body has turned, rad, counter-clockwise from above."""
    turn = after @ before.T
    return math.atan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])
