"""ZUPT and TCZUPT as printed: 12 error states, mechanization, zero velocity.

Error states are attitude (phi, true C = (1 + [phi x]) C), velocity, gyro bias and accelerometer bias, closed
loop, in north-east-down.  After Fontanella, Accardo, Schiano Lo Moriello, Angrisani and De Simone, Sensors
2018, 18(5), 1457, sections 2 and 3.  The standard filter takes gyros that a calibration has corrected, and
its bias walks at random; TCZUPT takes raw ones and adds T_s (db/dT) T' to the bias at every step.

A step takes one sample, or the mean of several: with the noise given as densities the result is the same.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imumon.blocks import Columns, FloatArray, SampleBlock
from imumon.columns import Column, vector_columns
from imumon.filters.turns import cross_matrix, rotation_by
from imumon.geodesy import STANDARD_GRAVITY, body_to_ned, earth_rate_along
from imumon.models.model import BiasModel

from .slot_stage import SlotStage, at_rest, gyro_predictor, inertial

STATES = 12
PHI, VELOCITY, GYRO, ACCEL = (slice(k, k + 3) for k in range(0, STATES, 3))
"""Places of the error states."""
YAW = 2
MEASURED_S = 0.01
"""The standard deviations of the measurements are those of one every 10 ms, as at the paper's 100 Hz."""
SLOT_S = 0.25
LONGEST_GAP_S = 1.25
"""Without samples for longer the unit may have moved; a packet that comes every second may be late."""
ZEROING_S = 60.0
"""s at rest; after a gap as long there is nothing to go on from."""
LEVELLING_S = 1.0
"""s at rest whose mean specific force is the vertical after a motion."""
VELOCITY_RANDOM_WALK = 1e-3
"""m/s/sqrt(s)."""
ACCEL_BIAS_RANDOM_WALK, ACCEL_BIAS_SD = 1e-6 * STANDARD_GRAVITY, 1e-3 * STANDARD_GRAVITY
"""m/s^2/sqrt(s), and m/s^2 at the start."""
ANGLE_SD, VELOCITY_SD = 1e-4, 1e-3
"""Of tilt and yaw (rad) and of the velocity (m/s) at the start."""
MEASURED_SD = np.array([1e-3, 1e-3, 1e-3, 1e-4])
"""Of a velocity measurement every `MEASURED_S`, m/s, and of one of the yaw, rad: velocity alone does not show
the vertical bias."""


@dataclass(frozen=True)
class DenseSettings:
    """Noise and start of the filter, SI units."""

    interval_s: float
    """Between samples."""
    latitude_deg: float | None = 40.93
    heading_deg: float | None = 0.0
    """Of the place, and of the body's x axis clockwise from north.  Without the heading the filter knows
    of the earth rate the vertical part only, without the latitude nothing: the rest is part of the bias."""
    angle_random_walk: float | FloatArray = math.radians(0.28) / 60
    """rad/sqrt(s), (3,)."""
    bias_random_walk: float = math.radians(0.1) / 3600
    bias_sd: float = math.radians(2.2) / 3600
    """K in rad/s/sqrt(s), and the standard deviation p0 of the bias at the start, rad/s."""

    @cached_property
    def earth(self) -> FloatArray:
        """Earth rate north, east, down, as far as it is known, rad/s, (3,)."""
        if self.latitude_deg is None:
            return np.zeros(3)
        north, _, down = np.eye(3)
        known = north * (self.heading_deg is not None)
        return earth_rate_along(-down, known, math.radians(self.latitude_deg))

    @property
    def start(self) -> FloatArray:
        """Covariance at the start, (12, 12); a new one each time, as a filter writes to it."""
        return np.diag(np.repeat(np.square([ANGLE_SD, VELOCITY_SD, self.bias_sd, ACCEL_BIAS_SD]), 3))

    @cached_property
    def noise(self) -> FloatArray:
        """Process noise of a step, (12, 12)."""
        walks = self.angle_random_walk, VELOCITY_RANDOM_WALK, self.bias_random_walk, ACCEL_BIAS_RANDOM_WALK
        return np.diag(np.concatenate([np.broadcast_to(walk, 3) for walk in walks]) ** 2 * self.interval_s)

    @cached_property
    def measured(self) -> tuple[FloatArray, FloatArray]:
        """H and R of a step: three velocities, and the yaw, which is held."""
        h = np.zeros((4, STATES))
        h[:3, VELOCITY], h[3, YAW] = np.eye(3), 1.0
        return h, np.diag(np.square(MEASURED_SD)) * (MEASURED_S / self.interval_s)


@dataclass
class State:
    """What the filter carries from step to step.

    `attitude`, `held` (3, 3): C, body to north-east-down, now and at the start: the yaw that is held.
    `gravity`: m/s².
    `bias`, `accel_bias` (3,): rad/s and m/s², body axes.
    `velocity` (3,): m/s.
    `covariance` (12, 12): of the error states.
    """

    attitude: FloatArray
    held: FloatArray
    gravity: float
    bias: FloatArray
    covariance: FloatArray
    velocity: FloatArray
    accel_bias: FloatArray

    @property
    def bias_sd(self) -> FloatArray:
        """rad/s, (3,)."""
        return np.sqrt(np.diag(self.covariance)[GYRO])


def begin(settings: DenseSettings, force: FloatArray, up: FloatArray | None = None) -> State:
    """Return the state at rest without bias; the specific force (3,) is along `up` by default."""
    up = force if up is None else up
    attitude = body_to_ned(up / np.linalg.norm(up), math.radians(settings.heading_deg or 0.0))
    gravity = float(np.linalg.norm(force))
    bias, velocity, accel_bias = np.zeros((3, 3))
    return State(attitude, attitude, gravity, bias, settings.start, velocity, accel_bias)


def step(
    state: State, settings: DenseSettings, gyro: FloatArray, accel: FloatArray, drift: FloatArray
) -> FloatArray:
    """Go on by one step at rest; return the innovations over their standard deviations, (3,).

    `gyro`, `accel` (3,): rad/s and m/s², body axes; means over the step.
    `drift` (3,): what the thermal model adds to the bias, rad/s: T_s (db/dT) T'; zero for the standard
        filter.
    """
    dt, earth = settings.interval_s, settings.earth
    # Mechanization: the step's rotation half before and half after the specific force.
    state.bias = state.bias + drift
    half = rotation_by(0.5 * dt * (gyro - state.bias - state.attitude.T @ earth))
    state.attitude = state.attitude @ half
    force = state.attitude @ (accel - state.accel_bias)
    state.attitude = state.attitude @ half
    state.velocity = state.velocity + dt * (force + np.array([0.0, 0.0, state.gravity]))
    # F = 1 + A dt, and half (A dt)² from bias to velocity:
    # phi' = -[earth x] phi - C b_g,  v' = -[C f x] phi - C b_a.
    f = np.eye(STATES)
    f[PHI, PHI] -= dt * cross_matrix(earth)
    f[VELOCITY, PHI] = -dt * cross_matrix(force)
    f[PHI, GYRO] = f[VELOCITY, ACCEL] = -dt * state.attitude
    f[VELOCITY, GYRO] = 0.5 * f[VELOCITY, PHI] @ f[PHI, GYRO]
    predicted = f @ state.covariance @ f.T + settings.noise
    h, r = settings.measured
    off = state.held @ state.attitude.T
    z = np.append(-state.velocity, 0.5 * (off[1, 0] - off[0, 1]))
    # The errors are expected to be zero, so that the innovation is the measurement.
    spread = predicted @ h.T
    total = h @ spread + r
    gain = np.linalg.solve(total, spread.T).T
    error, rest = gain @ z, np.eye(STATES) - gain @ h
    state.covariance = rest @ predicted @ rest.T + gain @ r @ gain.T  # Joseph's form
    state.attitude = rotation_by(error[PHI]) @ state.attitude
    state.velocity = state.velocity + error[VELOCITY]
    state.bias = state.bias + error[GYRO]
    state.accel_bias = state.accel_bias + error[ACCEL]
    return (z / np.sqrt(np.diag(total)))[:3]


class DenseZupt(SlotStage):
    """ZUPT on calibrated data, or TCZUPT, as a stage: ``{method}_gyro_bias_{axis}`` of the raw rate, and sd.

    The first minute at rest is the initial zeroing.  In motion the bias is predicted only; after it the unit
    is levelled anew.

    `method`: "dense_zupt" or "dense_tczupt".
    `settings`: its interval is that of the slots.
    `model`: bias over temperature: taken off before dense_zupt, slope of the bias for dense_tczupt, which
        also needs the column ``temperature_rate`` (or one for each axis).
    `assume_rest`: whether the unit is at rest throughout where it is not stated (no column ``at_rest``).
    """

    def __init__(
        self,
        method: str,
        settings: DenseSettings,
        model: BiasModel | None = None,
        assume_rest: bool = False,
    ) -> None:
        super().__init__(10, SLOT_S, 6)
        self._method = method
        self._settings = replace(settings, interval_s=SLOT_S)
        self._predictor, self._axes = gyro_predictor(model)
        self._assume_rest = assume_rest
        self._state: State | None = None
        self._resting: list[FloatArray] = []
        """Mean gyros (3) and accelerometers (3) of the slots of a zeroing or a levelling, and their s."""
        self._slot_ns = 0
        """Begin of the last slot."""

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        name = f"{self._method}_gyro_bias"
        bias = vector_columns(name, "rad/s", "bias of the raw rate by this method")
        return [*bias, *vector_columns(f"{name}_sd", "rad/s", "its sigma")]

    def process(self, block: SampleBlock) -> Columns:
        """Return the new columns of a block, NaN before the zeroing is over.

        Needs ``device_time_ns``, ``segment``, gyros, accelerometers and ``at_rest``.
        """
        curve, warming = self._model(block)
        values = np.column_stack([inertial(block), warming, at_rest(block, self._assume_rest)])
        values[:, :3] -= curve
        slots, breaks = self.slots(block, values)
        results = np.full((len(slots), 6), np.nan)
        for k in range(len(slots)):
            start_ns, length_ns = slots.start_ns[k], self._gatherer.length_ns
            if slots.begins[k]:
                self._slot_ns = start_ns - length_ns
            passed = (start_ns - self._slot_ns) // length_ns
            self._slot_ns += passed * length_ns
            if slots.begins[k] or passed * SLOT_S > ZEROING_S:
                self._state, self._resting = None, []
            self._take(slots.mean[k], slots.smallest[k, 9] == 1.0, passed * SLOT_S)
            if self._state is not None:
                results[k] = *self._state.bias, *self._state.bias_sd
        shown = self.spread(slots.row, results, breaks, len(block))
        shown[:, :3] += curve
        return {column.name: part for column, part in zip(self.columns, shown.T, strict=True)}

    def _take(self, mean: FloatArray, rests: bool, elapsed_s: float) -> None:
        """Take in a slot of gyros (3), accelerometers (3), warming (3) and rest, so long after the last."""
        state, settings = self._state, self._settings
        if elapsed_s != SLOT_S:
            settings = replace(settings, interval_s=elapsed_s)
        drift = elapsed_s * np.nan_to_num(mean[6:9])
        measured = rests and np.isfinite(mean[:6]).all()
        gap = elapsed_s > LONGEST_GAP_S
        if measured and not gap and state is not None and np.isfinite(state.velocity).all():
            # The bias of a step is that at its end.
            step(state, settings, mean[:3] + 0.5 * drift, mean[3:6], drift)
            return
        if state is not None:
            state.bias = state.bias + drift
            state.covariance[GYRO, GYRO] += settings.noise[GYRO, GYRO]
            state.velocity[:] = np.nan
        if gap or not measured:
            self._resting = []
        if not measured:
            return
        # A zeroing or a levelling is under way.  Rates before refer to the bias of now.
        self._resting = [np.concatenate([past[:3] + drift, past[3:]]) for past in self._resting]
        self._resting.append(np.append(mean[:6], SLOT_S if gap else elapsed_s))
        if np.sum(self._resting, axis=0)[6] < (ZEROING_S if state is None else LEVELLING_S):
            return
        means = np.mean(self._resting, axis=0)
        fresh = begin(settings, means[3:6])
        if state is None:
            fresh.bias = means[:3] - fresh.attitude.T @ settings.earth
        else:
            fresh.bias = state.bias
            fresh.covariance[GYRO, GYRO] = state.covariance[GYRO, GYRO]
        self._state, self._resting = fresh, []

    def _model(self, block: SampleBlock) -> tuple[FloatArray, FloatArray]:
        """Return what is taken off the gyros, and how fast the bias moves by the model, rad/s², (n, 3)."""
        curve, warming = np.zeros((len(block), 3)), np.zeros((len(block), 3))
        if self._predictor is None:
            return curve, warming
        predicted = self._predictor.of_block(block)
        if self._method == "dense_zupt":
            curve[:, self._axes] = predicted.bias
        else:
            names = self._predictor.temperature_columns
            rates = [one.replace("_estimate", "").replace("temperature", "temperature_rate") for one in names]
            warming[:, self._axes] = predicted.slope * block.stacked(rates)
        return curve, warming
