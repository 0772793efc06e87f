"""Simulated temperature records: an inertial unit that heats itself, wobbles, or drifts steadily."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, IntArray

FINAL_DEGC = 67.3
BASE_CONSTANT_S = 90 * 60.0
# Amplitudes of exp(-m t / 90 min), m = 1..6, in °C; the record begins at 34.3 °C with 49 °C/h.
HEATING_DEGC = np.array([-18.0, -9.0, -3.5, 0.0, -1.0, -1.5])
WOBBLE_DEGC, WOBBLE_S = 0.25, 20 * 60.0
PER_HOUR = 3600.0


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Readings with the temperature and rate that they come from (NaN where the truth is not known).

    Arrays of shape (n,): ns, °C, °C, °C/s.
    """

    name: str
    time_ns: IntArray
    reading: FloatArray
    temperature: FloatArray
    rate: FloatArray

    @property
    def minutes(self) -> FloatArray:
        """Minutes since the first sample."""
        return self.seconds / 60.0

    @property
    def seconds(self) -> FloatArray:
        """Seconds since the first sample."""
        elapsed: FloatArray = (self.time_ns - self.time_ns[0]).astype(np.float64)
        return elapsed * 1e-9


def heating(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return temperature and rate of self-heating as in the paper's figure 2: six exponentials to 67.3 °C."""
    m = np.arange(1, 7)[:, np.newaxis]
    terms = HEATING_DEGC[:, np.newaxis] * np.exp(-m * t / BASE_CONSTANT_S)
    temperature: FloatArray = FINAL_DEGC + terms.sum(0)
    rate: FloatArray = (-m / BASE_CONSTANT_S * terms).sum(0)
    return temperature, rate


def wobbling(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return self-heating with a wobble of 0.25 °C and 20 min upon it."""
    temperature, rate = heating(t)
    w = 2 * np.pi / WOBBLE_S
    return temperature + WOBBLE_DEGC * np.sin(w * t), rate + WOBBLE_DEGC * w * np.cos(w * t)


def steady(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return 0.5 °C/h."""
    return 30.013 + 0.5 / PER_HOUR * t, np.full(t.size, 0.5 / PER_HOUR)


def lively(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an accelerometer that heats twice as fast, its rate varying by ±1 °C/h within 10 min.

    As in the paper's figures 4 and 6 (bottom); the others are of a laser gyro.
    """
    temperature, rate = heating(2.0 * t)
    rate = 2.0 * rate
    minutes, w = t / 60.0, 2 * np.pi / 1200.0
    depth = 1.0 / PER_HOUR
    for start in (60.0, 100.0, 120.0, 160.0):
        inside = (minutes >= start) & (minutes < start + 20.0)
        since = np.where(inside, t - start * 60.0, 0.0)
        # A full period: the rate leaves and comes back without a corner in the temperature.
        rate = rate + depth * np.sin(w * since)
        temperature = temperature + depth / w * (1.0 - np.cos(w * since))
    return temperature, rate


SHAPES = {"lively": lively, "heating": heating, "wobble": wobbling, "steady": steady}


def simulate(
    shape: str, noise: float, seed: int = 1, step: float = 0.05, rate_hz: float = 10.0, hours: float = 3.0
) -> Record:
    """Return a record of a shape, quantized after white noise of this standard deviation in °C."""
    n = int(hours * PER_HOUR * rate_hz)
    time_ns = np.arange(n, dtype=np.int64) * int(1e9 / rate_hz)
    temperature, rate = SHAPES[shape](time_ns.astype(np.float64) * 1e-9)
    noisy = temperature + noise * np.random.default_rng(seed).standard_normal(n)
    return Record(f"{shape}, noise {noise:g} °C", time_ns, step * np.round(noisy / step), temperature, rate)


def centred(time_ns: IntArray, reading: FloatArray, half_s: float) -> tuple[FloatArray, FloatArray]:
    """Return temperature and rate of local cubic fits to all readings within ±`half_s`."""
    t = (time_ns - time_ns[0]) * 1e-9
    temperature, rate = np.empty(len(t)), np.empty(len(t))
    for i in range(len(t)):
        middle = min(max(t[i], half_s), t[-1] - half_s)
        a, b = np.searchsorted(t, [middle - half_s, middle + half_s])
        u = (t[a:b] - middle) / half_s
        fit = np.polynomial.polynomial.polyfit(u, reading[a:b], 3)
        v = (t[i] - middle) / half_s
        temperature[i] = np.polynomial.polynomial.polyval(v, fit)
        rate[i] = np.polynomial.polynomial.polyval(v, np.polynomial.polynomial.polyder(fit)) / half_s
    return temperature, rate
