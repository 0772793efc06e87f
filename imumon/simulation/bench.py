"""A unit on a bench: it rests, is turned by hand, warms up, and has bias, noise and a magnetic field."""

from __future__ import annotations

from fractions import Fraction
from typing import Literal

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.simulation.frames import FIELD_UT, FRD_TO_FLU, body_rates, reported, split, to_body

MICROSECOND = Fraction(1000)
AMBIENT_DEGC = 24.0
WARM_UP_DEGC = np.array([8.5, 7.0, 9.5])
WARM_UP_S = 240.0
"""Rise of each gyro's temperature above ambient, and its time constant."""
GYRO_BIAS_DPS = np.array([0.12, -0.20, 0.08])
GYRO_SLOPE_DPS_PER_DEGC = np.array([0.010, -0.014, 0.006])
GYRO_ARW_DPS = 0.02
ACCEL_NOISE = 0.012
MAG_NOISE_UT = 0.08
"""White noise: deg/s/sqrt(Hz), and a sample's standard deviation in m/s² and µT."""

# Turns of one round, in degrees: (start, duration, roll, pitch, yaw) s; between them the unit rests.
_TURNS = (
    (4.0, 2.0, 30.0, 0.0, 0.0),
    (8.0, 3.0, -60.0, 0.0, 0.0),
    (13.0, 2.0, 30.0, 20.0, 0.0),
    (17.0, 2.5, 0.0, -20.0, 90.0),
    (22.0, 3.5, 0.0, 0.0, -90.0),
)
_ROUND_S = 30.0
_START_DEG = (0.0, 0.0, 40.0)


class BenchUnit:
    """Deterministic samples of a unit on a bench, in consecutive blocks.

    Parameters
    ----------
    rate_hz : float
        Samples per second.
    axes : "FLU" or "FRD"
        Body axes; attitude is reported to ENU for FLU and to NED for FRD.
    seed : int
        Seed of all noise; the blocks may be of any size, the samples are the same to rounding.
    tick_ns : Fraction
        Unit in which the device counts its time.
    """

    def __init__(
        self,
        rate_hz: float,
        axes: Literal["FLU", "FRD"],
        seed: int = 0,
        tick_ns: Fraction = MICROSECOND,
    ) -> None:
        self._rate_hz = rate_hz
        self._tick_ns = tick_ns
        self._axes = axes
        self._random = np.random.default_rng(seed)
        self._next = 0

    def samples(self, n: int) -> SampleBlock:
        """Return the next n samples, with packet_counter and device_ticks counting from power-on."""
        index = np.arange(self._next, self._next + n)
        self._next += n
        t = index / self._rate_hz
        angles, rates = _motion(t)
        noise = self._random.standard_normal((n, 9))  # one draw a sample: independent of the block size
        temperature = AMBIENT_DEGC + WARM_UP_DEGC * -np.expm1(-t[:, np.newaxis] / WARM_UP_S)
        bias = GYRO_BIAS_DPS + GYRO_SLOPE_DPS_PER_DEGC * (temperature - AMBIENT_DEGC)
        gyro = body_rates(angles, rates) + np.deg2rad(
            bias + GYRO_ARW_DPS * np.sqrt(self._rate_hz / 2) * noise[:, 0:3]
        )
        accel = to_body(angles, np.array([0.0, 0.0, -STANDARD_GRAVITY])) + ACCEL_NOISE * noise[:, 3:6]
        mag = to_body(angles, FIELD_UT) + MAG_NOISE_UT * noise[:, 6:9]
        if self._axes == "FLU":
            gyro, accel, mag = gyro @ FRD_TO_FLU, accel @ FRD_TO_FLU, mag @ FRD_TO_FLU
        return SampleBlock(
            {
                "packet_counter": index,
                "device_ticks": np.rint(t * float(1_000_000_000 / self._tick_ns)).astype(np.int64),
                **split("gyro", gyro),
                **split("accel", accel),
                **split("mag", mag),
                **split("temperature", temperature),
                "temperature": temperature.mean(axis=1),
                **reported(angles, self._axes),
                "status": np.full(n, 7, np.int64),
                "supply_voltage": np.full(n, 5.02),
                "pressure": np.full(n, 101_325.0),
            }
        )


def _motion(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return roll, pitch, yaw (n, 3) in rad and their rates in rad/s: minimum-jerk turns and rests."""
    phase = np.mod(t, _ROUND_S)
    angles, rates = np.tile(np.deg2rad(_START_DEG), (len(t), 1)), np.zeros((len(t), 3))
    for start, duration, *turn in _TURNS:
        s = np.clip((phase - start) / duration, 0.0, 1.0)
        amount = np.deg2rad(turn)
        angles += np.outer(s**3 * (10 - 15 * s + 6 * s**2), amount)
        rates += np.outer(30 * s**2 * (1 - s) ** 2 / duration, amount)
    return angles, rates
