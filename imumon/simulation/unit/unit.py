"""The simulated unit: what a device of known errors sends, and the truth behind it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.simulation.frames import (
    FIELD_UT,
    FRD_TO_FLU,
    body_rates,
    earth_rate,
    reported,
    split,
    to_body,
)
from imumon.simulation.unit.curves import axis_values
from imumon.simulation.unit.filters import Lag, LowPass
from imumon.simulation.unit.hysteresis import HysteresisLoop
from imumon.simulation.unit.motion import Movement, is_static, movement
from imumon.simulation.unit.noise import GaussMarkov, RandomWalk, White, generator
from imumon.simulation.unit.scenario import Scenario
from imumon.simulation.unit.thermal import SensorTemperature, Thermometers

MICROSECOND = Fraction(1000)
CHUNK = 8192
"""Samples that are computed at once, whatever the calls ask for: so the calls cannot change a bit."""
DEG_PER_H = np.pi / 180 / 3600
MG, UG = 9.80665e-3, 9.80665e-6
"""rad/s, and m/s²."""

TRUTH_COLUMNS: tuple[Column, ...] = (
    *(Column(f"gyro_bias_{a}", "rad/s", description=f"total bias without white noise, {a}") for a in "xyz"),
    *(Column(f"accel_bias_{a}", "m/s^2", description=f"total bias without white noise, {a}") for a in "xyz"),
    *(Column(f"rate_{a}", "rad/s", description=f"true angular rate with the earth's, {a}") for a in "xyz"),
    *(KNOWN[name] for name in ("temperature", "temperature_x", "temperature_y", "temperature_z")),
    Column("at_rest", "1", "int64", "1 at rest, 0 in motion"),
)
"""What `SimulatedUnit.run` returns as the truth, besides device_time_ns and segment."""


class SimulatedUnit:
    """A unit that plays a scenario; the same seed gives the same samples, to the bit, however the run is cut.

    Sensors see motion, earth rate and gravity in the scenario's axes; bias and noise are added, and a
    second-order low-pass goes over the sum.  After the scenario's duration it goes on as it is.

    Parameters
    ----------
    scenario : Scenario
    seed : int
        Seed of all noise and of the turn-on biases.
    tick_ns : Fraction
        Unit in which the device counts its time.
    """

    def __init__(self, scenario: Scenario, seed: int = 0, tick_ns: Fraction = MICROSECOND) -> None:
        self.scenario = scenario
        self._tick_ns = tick_ns
        self._sensors = _Sensors(scenario, seed)
        self._chunk: dict[str, ColumnArray] = {}
        self._used = CHUNK
        self._computed = 0

    @property
    def position(self) -> int:
        """Number of samples taken so far."""
        return self._computed - (CHUNK - self._used)

    def samples(self, n: int) -> SampleBlock:
        """Return the next n samples as an encoder takes them, counter and ticks counting from power-on."""
        return self._take(n)[0]

    def run(self, n: int) -> tuple[SampleBlock, SampleBlock]:
        """Return the next n samples with device_time_ns and segment, and the truth of the same samples.

        The first block has what `samples` returns as well.  The truth has device_time_ns, segment and
        `TRUTH_COLUMNS`: gyro_bias_{x,y,z} rad/s and accel_bias_{x,y,z} m/s² (everything but white noise),
        rate_{x,y,z} rad/s (angular rate with the earth's), temperature and temperature_{x,y,z} °C, at_rest.
        """
        sent, truth = self._take(n)
        times = {
            "device_time_ns": sent["device_ticks"] * self._tick_ns.numerator // self._tick_ns.denominator,
            "segment": np.zeros(n, np.int64),
        }
        return SampleBlock({**times, **sent.columns}), SampleBlock({**times, **truth.columns})

    def _take(self, n: int) -> tuple[SampleBlock, SampleBlock]:
        index = np.arange(self.position, self.position + n)
        ticks_per_sample = float(1_000_000_000 / self._tick_ns) / self.scenario.rate_hz
        columns: dict[str, ColumnArray] = {
            "packet_counter": index,
            "device_ticks": np.rint(index * ticks_per_sample).astype(np.int64),
        }
        if not self._chunk:
            self._next_chunk()
        columns |= {name: np.empty(n, values.dtype) for name, values in self._chunk.items()}
        done = 0
        while done < n:
            if self._used == CHUNK:
                self._next_chunk()
            size = min(n - done, CHUNK - self._used)
            for name, values in self._chunk.items():
                columns[name][done : done + size] = values[self._used : self._used + size]
            done, self._used = done + size, self._used + size
        truth = {name: columns.pop(_TRUE + name) for name in (column.name for column in TRUTH_COLUMNS)}
        return SampleBlock(columns), SampleBlock(truth)

    def _next_chunk(self) -> None:
        self._chunk = self._sensors.chunk(self._computed)
        self._computed, self._used = self._computed + CHUNK, 0


_TRUE = "true_"


class _Sensors:
    """Everything between a scenario and the numbers of a chunk."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        unit = scenario.unit
        self._scenario, self._unit, self._step_s = scenario, unit, 1.0 / scenario.rate_hz
        attitude = scenario.attitude
        self._angles = np.deg2rad([attitude.roll_deg, attitude.pitch_deg, attitude.heading_deg])
        self._up = np.array([0.0, 0.0, -scenario.gravity_m_per_s2])
        self._earth = earth_rate(scenario.latitude_deg)
        self._temperature = SensorTemperature(scenario.chamber, unit.self_heating, self._step_s)
        start = self._temperature.start_degc
        self._gyro_lag = Lag(unit.gyro_lag_s, self._step_s, start)
        self._loop = HysteresisLoop(unit.gyro_hysteresis, start) if unit.gyro_hysteresis else None
        self._thermometers = Thermometers(unit.thermometer, 4, scenario.rate_hz, seed)
        self._mag_noise = White([0.08] * 3, generator(seed, "magnetometer"))
        self._draw(seed)
        self._low_pass: LowPass | None = None

    def _draw(self, seed: int) -> None:
        """Set up what is random, one generator for each."""
        unit, step = self._unit, self._step_s
        gyro, accel = unit.gyro_noise, unit.accel_noise
        root_rate = np.sqrt(self._scenario.rate_hz)
        self._gyro_white = White(
            np.deg2rad(gyro.arw_deg_per_sqrt_h) / 60.0 * root_rate, generator(seed, "angular random walk")
        )
        self._accel_white = White(
            np.array(accel.vrw_m_per_s_per_sqrt_s) * root_rate, generator(seed, "velocity random walk")
        )
        self._gyro_drifts: list[GaussMarkov | RandomWalk] = []
        for i, process in enumerate(gyro.flicker):
            sd = np.array(process.sd_deg_per_h) * DEG_PER_H
            self._gyro_drifts.append(
                GaussMarkov(sd, process.tau_s, step, generator(seed, f"gyro flicker {i}"))
            )
        walk = np.array(gyro.random_walk_deg_per_h_per_sqrt_s) * DEG_PER_H
        self._gyro_drifts.append(RandomWalk(walk, step, generator(seed, "gyro random walk")))
        self._accel_drifts = [
            GaussMarkov(np.array(part.sd_ug) * UG, part.tau_s, step, generator(seed, f"accel flicker {i}"))
            for i, part in enumerate(accel.flicker)
        ]
        on = unit.gyro_turn_on
        drawn = White(on.sd_deg_per_h, generator(seed, "gyro turn-on")).take(1)[0]
        self._gyro_constant = (on.offset_deg_per_h + drawn) * DEG_PER_H
        drawn = White(unit.accel_turn_on.sd_mg, generator(seed, "accel turn-on")).take(1)[0]
        self._accel_constant = (unit.accel_turn_on.offset_mg + drawn) * MG

    def chunk(self, first: int) -> dict[str, ColumnArray]:
        """Return the columns of the next `CHUNK` samples, the truth under names that begin with true_."""
        time_s = np.arange(first, first + CHUNK) / self._scenario.rate_hz
        temperature = self._temperature.process(time_s)
        gyro_bias = self._gyro_bias(temperature)
        accel_bias = self._accel_bias(time_s, temperature)
        motion, attitude = self._motion(time_s)
        rate = body_rates(motion.angles, motion.rates) + to_body(motion.angles, self._earth)
        force = to_body(motion.angles, self._up + motion.acceleration)
        mag = to_body(motion.angles, FIELD_UT)
        if self._scenario.axes == "FLU":
            rate, force, mag = rate @ FRD_TO_FLU, force @ FRD_TO_FLU, mag @ FRD_TO_FLU
        sensed = np.column_stack([rate + gyro_bias, force + accel_bias])
        if self._low_pass is None:
            self._low_pass = LowPass(self._unit.low_pass_hz, self._scenario.rate_hz, sensed[0])
        noise = np.column_stack([self._gyro_white.take(CHUNK), self._accel_white.take(CHUNK)])
        sent = self._low_pass.process(sensed + noise)
        board = temperature.mean(axis=1)
        readings = self._thermometers.process(first, np.column_stack([temperature, board]))
        return {
            **split("gyro", sent[:, :3]),
            **split("accel", sent[:, 3:]),
            **split("mag", mag + self._mag_noise.take(CHUNK)),
            **split("temperature", readings),
            "temperature": readings[:, 3],
            **attitude,
            "status": np.full(CHUNK, 7, np.int64),
            "supply_voltage": np.full(CHUNK, 5.02),
            "pressure": np.full(CHUNK, 101_325.0),
            **split(f"{_TRUE}gyro_bias", gyro_bias),
            **split(f"{_TRUE}accel_bias", accel_bias),
            **split(f"{_TRUE}rate", rate),
            **split(f"{_TRUE}temperature", temperature),
            f"{_TRUE}temperature": board,
            f"{_TRUE}at_rest": (~motion.moving).astype(np.int64),
        }

    def _gyro_bias(self, temperature: FloatArray) -> FloatArray:
        inside = self._gyro_lag.process(temperature)
        bias = np.deg2rad(axis_values(self._unit.gyro_bias_deg_per_s, inside)) + self._gyro_constant
        if self._loop is not None and self._unit.gyro_hysteresis is not None:
            width = np.array(self._unit.gyro_hysteresis.half_width_deg_per_h) * DEG_PER_H
            bias += width * self._loop.process(inside)
        for drift in self._gyro_drifts:
            bias += drift.take(CHUNK)
        return np.asarray(bias)

    def _accel_bias(self, time_s: FloatArray, temperature: FloatArray) -> FloatArray:
        bias = axis_values(self._unit.accel_bias_mg, temperature) * MG + self._accel_constant
        warm_up = self._unit.accel_warm_up
        if warm_up is not None:
            grown = -np.expm1(-time_s / warm_up.tau_s)
            bias += np.outer(grown, np.array(warm_up.amplitude_ug) * UG)
        for drift in self._accel_drifts:
            bias += drift.take(CHUNK)
        return np.asarray(bias)

    def _motion(self, time_s: FloatArray) -> tuple[Movement, dict[str, ColumnArray]]:
        """Return the motion and the attitude that the device reports, which at rest is computed once."""
        events, axes = self._scenario.motion, self._scenario.axes
        if not is_static(events, time_s[0], time_s[-1]):
            moving = movement(events, self._angles, time_s)
            return moving, reported(moving.angles, axes)
        still = movement(events, self._angles, time_s[-1:])
        attitude = {name: np.repeat(value, CHUNK) for name, value in reported(still.angles, axes).items()}
        return Movement(
            np.tile(still.angles, (CHUNK, 1)),
            np.zeros((CHUNK, 3)),
            np.zeros((CHUNK, 3)),
            np.zeros(CHUNK, bool),
        ), attitude
