"""The simulated unit: what a device of known errors sends, and the truth behind it.

Angles are roll, pitch and heading in rad, ZYX, of forward-right-down body axes to north-east-down.
"""

from fractions import Fraction

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock, join
from imumon.columns import KNOWN, TEMPERATURES, BodyAxes, Column, vector_columns
from imumon.geodesy import earth_rate_along, quaternions

from .biases import accel_bias, gyro_bias
from .motion import Movement, movement
from .noise import White, generator
from .scenario import Scenario
from .thermal import SensorTemperature, Thermometers

MICROSECOND = Fraction(1000)
"""ns."""
CHUNK = 8192
"""Samples that are computed at once, whatever the calls request: so the calls cannot change a bit."""
MAG_NOISE_UT = 0.08
FIELD_UT = np.array([20.0, 1.0, 43.0])
"""Magnetic field north, east, down, as in central Europe."""

FRD_TO_FLU = np.diag([1.0, -1.0, -1.0])
"""Forward-right-down to forward-left-up."""

TRUTH_COLUMNS: tuple[Column, ...] = (
    *vector_columns("gyro_bias", "rad/s", "total bias without white noise"),
    *vector_columns("accel_bias", "m/s^2", "total bias without white noise"),
    *vector_columns("rate", "rad/s", "true angular rate with the earth's"),
    *(KNOWN[name] for name in TEMPERATURES),
    Column("at_rest", "1", "int64", "1 at rest, 0 in motion"),
)
"""What `SimulatedUnit.run` returns as the truth, besides device_time_ns and segment."""


_CONSTANT = {"status": 7, "supply_voltage": 5.02, "pressure": 101_325.0}
"""What encoders may query and nothing here changes."""


class SimulatedUnit:
    """A unit that plays a scenario; the same seed gives the same samples, to the bit, however the run is cut.

    Sensors see motion, earth rate and gravity in the scenario's axes; bias and noise are added, and a
    second-order low-pass goes over the sum.  After the scenario's duration it goes on as it is.  `tick_ns` is
    the unit in which the device counts its time.
    """

    def __init__(self, scenario: Scenario, seed: int = 0, tick_ns: Fraction = MICROSECOND) -> None:
        unit, rate = scenario.unit, scenario.rate_hz
        self.scenario = scenario
        self._tick_ns = tick_ns
        self._up = np.array([0.0, 0.0, -scenario.gravity_m_per_s2])
        north, _, down = np.eye(3)
        self._earth = earth_rate_along(-down, north, np.deg2rad(scenario.latitude_deg))
        self._temperature = SensorTemperature(scenario.chamber, unit.self_heating)
        self._gyro_bias = gyro_bias(unit, 1.0 / rate, seed)
        self._accel_bias = accel_bias(unit, 1.0 / rate, seed)
        densities = [
            *np.deg2rad(unit.gyro_noise.arw_deg_per_sqrt_h) / 60.0,
            *unit.accel_noise.vrw_m_per_s_per_sqrt_s,
        ]
        self._white = White(np.array(densities) * np.sqrt(rate), generator(seed, "white"))
        self._mag_noise = White([MAG_NOISE_UT] * 3, generator(seed, "magnetometer"))
        self._driver_noise = White(
            [course.noise for course in scenario.drivers.values()], generator(seed, "drivers")
        )
        self._thermometers = Thermometers(unit.thermometer, 4, rate, seed)
        self._low_pass: LowPass | None = None
        self._left = self._chunk(0)
        """What is sent of samples that are computed and not taken yet, and the truth."""
        self._taken = 0

    def samples(self, n: int) -> SampleBlock:
        """Return the next n samples as an encoder takes them, counter and ticks counting from power-on."""
        return self.run(n)[0]

    def run(self, n: int) -> tuple[SampleBlock, SampleBlock]:
        """Return the next n samples, and the truth of them, both with device_time_ns and segment.

        The truth has `TRUTH_COLUMNS`: gyro_bias_{x,y,z} rad/s and accel_bias_{x,y,z} m/s² (everything but
        white noise), rate_{x,y,z} rad/s (angular rate with the earth's), temperature and temperature_{x,y,z}
        °C, at_rest.
        """
        parts, computed = [self._left], len(self._left[0])
        while computed < n:
            parts.append(self._chunk(self._taken + computed))
            computed += CHUNK
        sent, truth = (join(part) for part in zip(*parts, strict=True))
        index = np.arange(self._taken, self._taken + n)
        self._left, self._taken = (sent.rows(n, computed), truth.rows(n, computed)), self._taken + n
        ticks_per_sample = float(1_000_000_000 / self._tick_ns) / self.scenario.rate_hz
        ticks = np.rint(index * ticks_per_sample).astype(np.int64)
        time_ns = ticks * self._tick_ns.numerator // self._tick_ns.denominator
        times = {"device_time_ns": time_ns, "segment": np.zeros(n, np.int64)}
        counted = {**times, "packet_counter": index, "device_ticks": ticks, **sent.rows(0, n).columns}
        return SampleBlock(counted), SampleBlock({**times, **truth.rows(0, n).columns})

    def _chunk(self, first: int) -> tuple[SampleBlock, SampleBlock]:
        """Return what is sent of the next `CHUNK` samples, and the truth."""
        time_s = np.arange(first, first + CHUNK) / self.scenario.rate_hz
        temperature = self._temperature.process(time_s)
        motion = movement(self.scenario.motion, self.scenario.attitude.angles, time_s)
        rate, force, field = self._in_body(motion)
        others = {
            name: np.interp(time_s, course.at_s, course.value)
            for name, course in self.scenario.drivers.items()
        }
        drive = time_s, temperature, force, others
        gyro_bias, accel_bias = self._gyro_bias.process(*drive), self._accel_bias.process(*drive)
        sensed = np.column_stack([rate + gyro_bias, force + accel_bias])
        if self._low_pass is None:
            self._low_pass = LowPass(self.scenario.unit.low_pass_hz, self.scenario.rate_hz, sensed[0])
        measured = self._low_pass.process(sensed + self._white.take(CHUNK))
        board = temperature.mean(axis=1)
        readings = self._thermometers.process(first, np.column_stack([temperature, board]))
        noise = self._driver_noise.take(CHUNK)
        sent = {
            **split("gyro", measured[:, :3]),
            **split("accel", measured[:, 3:]),
            **split("mag", field + self._mag_noise.take(CHUNK)),
            **split("temperature", readings),
            "temperature": readings[:, 3],
            **reported(motion.angles, self.scenario.axes),
            **{name: np.full(CHUNK, value) for name, value in _CONSTANT.items()},
            **{name: values + noise[:, at] for at, (name, values) in enumerate(others.items())},
        }
        truth = {
            **split("gyro_bias", gyro_bias),
            **split("accel_bias", accel_bias),
            **split("rate", rate),
            "temperature": board,
            **split("temperature", temperature),
            "at_rest": (~motion.moving).astype(np.int64),
        }
        return SampleBlock(sent), SampleBlock(truth)

    def _in_body(self, motion: Movement) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return angular rate, specific force and magnetic field in the axes of the unit."""
        angles, turned = motion.angles, FRD_TO_FLU if self.scenario.axes == "FLU" else np.eye(3)
        rate = body_rates(angles, motion.rates) + to_body(angles, self._earth)
        force, field = to_body(angles, self._up + motion.acceleration), to_body(angles, FIELD_UT)
        return rate @ turned, force @ turned, field @ turned


class LowPass:
    """Second-order Butterworth filter (bilinear) on each column, settled on the first deterministic sample.

    At packet rates up to twice its cut-off it does nothing: a unit that sends as slowly as that averages its
    samples over the packet's period, which leaves the density of the noise as it is.  `start`, (k,), is the
    signal before the first sample, without noise.
    """

    def __init__(self, cutoff_hz: float | None, rate_hz: float, start: FloatArray) -> None:
        self._sections: FloatArray | None = None
        if cutoff_hz is not None and rate_hz > 2.0 * cutoff_hz:
            from scipy.signal import butter, sosfilt_zi  # takes 0.3 s, and not every unit has a filter

            self._sections = butter(2, cutoff_hz, fs=rate_hz, output="sos")
            self._carried = sosfilt_zi(self._sections)[:, :, None] * start

    def process(self, values: FloatArray) -> FloatArray:
        """Return the next samples, filtered; both of shape (n, k)."""
        if self._sections is None:
            return values
        from scipy.signal import sosfilt

        out, self._carried = sosfilt(self._sections, values, axis=0, zi=self._carried)
        return np.asarray(out)


def body_rates(angles: FloatArray, rates: FloatArray) -> FloatArray:
    """Turn Euler angle rates (roll, pitch, heading) into angular rates in forward-right-down axes, (n, 3)."""
    roll, pitch = angles[:, 0], angles[:, 1]
    roll_rate, pitch_rate, yaw_rate = rates.T
    return np.column_stack(
        [
            roll_rate - np.sin(pitch) * yaw_rate,
            np.cos(roll) * pitch_rate + np.sin(roll) * np.cos(pitch) * yaw_rate,
            -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate,
        ]
    )


def to_body(angles: FloatArray, vectors: FloatArray) -> FloatArray:
    """Turn north-east-down vectors, (3,) or (n, 3), into forward-right-down axes, (n, 3)."""
    sin_roll, sin_pitch, sin_yaw = np.sin(angles).T
    cos_roll, cos_pitch, cos_yaw = np.cos(angles).T
    north, east, down = vectors.T
    along = cos_yaw * north + sin_yaw * east
    across = cos_yaw * east - sin_yaw * north
    below = sin_pitch * along + cos_pitch * down
    return np.column_stack(
        [
            cos_pitch * along - sin_pitch * down,
            cos_roll * across + sin_roll * below,
            cos_roll * below - sin_roll * across,
        ]
    )


def reported(angles: FloatArray, axes: BodyAxes) -> dict[str, ColumnArray]:
    """Return the columns of the attitude as a device reports it: to NED for FRD, to ENU for FLU."""
    w, x, y, z = quaternions(angles)
    if axes == "FLU":  # half a turn about forward in the body, and about north-east in the world
        w, x, y, z = np.sqrt(0.5) * np.array([w + z, x + y, x - y, w - z])
    w, x, y, z = np.where(w < 0.0, -1.0, 1.0) * np.array([w, x, y, z])
    yaw = np.arctan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))
    pitch = -np.arcsin(np.clip(2.0 * (x * z - w * y), -1.0, 1.0))
    roll = np.arctan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))
    if axes == "FRD":  # a compass heading, 0 to 360 degrees
        yaw = np.mod(yaw, 2 * np.pi)
    return {"q_w": w, "q_x": x, "q_y": y, "q_z": z, "roll": roll, "pitch": pitch, "yaw": yaw}


def split(name: str, values: FloatArray) -> dict[str, ColumnArray]:
    """Return the columns name_x, name_y, name_z of values of shape (n, 3)."""
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
