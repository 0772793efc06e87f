"""Methods that the rate estimators are compared with; none of them is for use.

Equation numbers are those of Kozlov and Tarygin, Sensors 2020, 20(5), 1299.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from temperature_rate_records import Record

from imumon.blocks import FloatArray, IntArray
from imumon.filters.rates import RateEstimate
from imumon.papers.fir import model_row


class Method(Protocol):
    """What estimates the rate of temperature."""

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates at the samples."""


def estimate(method: Method, record: Record) -> RateEstimate:
    """Return the estimates of a record."""
    return method.process(record.time_ns, np.zeros(len(record.reading), np.int64), record.reading)


class DifferenceRate:
    """Moving-window numerical differentiator (eq. 3): the reading less that of a window ago.

    Needs the whole record at once.  The standard deviations are those of two roundings.

    Parameters
    ----------
    step : float
        Quantization step in °C.
    window_s : float
        Window T in s.
    """

    def __init__(self, step: float = 0.05, window_s: float = 180.0) -> None:
        self._step, self._window_s = step, window_s

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of a record in one segment, NaN in its first window."""
        del segment
        seconds = (time_ns - time_ns[0]) * 1e-9
        before = np.searchsorted(seconds, seconds - self._window_s - 1e-6)
        full = seconds >= self._window_s - 1e-6
        span = np.where(full, seconds - seconds[before], np.nan)
        rate = (reading - reading[before]) / span
        sd = self._step / math.sqrt(12.0)
        return RateEstimate(reading, rate, np.full(len(reading), sd), math.sqrt(2.0) * sd / span)


class KalmanRate:
    """Conventional Kalman filter of the same model and measurements, which forgets by process noise.

    The paper's section 4.1: α, β and γ walk at random; t0 follows every `RENEWAL_S`.  Takes the whole record,
    in one segment.

    Parameters
    ----------
    step : float
        Quantization step in °C.
    time_constant_s : float
        T0 in s.
    walk : tuple of float
        Random walk of α, β and γ in °C/√s; the default is the best of a search over self-heating, wobble and
        steady records, by the geometric mean of the rms errors.
    """

    def __init__(
        self,
        step: float = 0.05,
        time_constant_s: float = 180.0,
        walk: tuple[float, float, float] = (0.0, 5e-3, 0.0),
    ) -> None:
        self._step, self._constant, self._walk = step, time_constant_s, np.square(walk)

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of a record."""
        del segment
        seconds = ((time_ns - time_ns[0]) * 1e-9).tolist()
        x, p = np.array([reading[0], 0.0, 0.0]), np.eye(3)
        t0, before, last, temperature = 0.0, 0.0, float(reading[0]), float(reading[0])
        out = np.empty((4, len(seconds)))
        for i, (t, value) in enumerate(zip(seconds, reading.tolist(), strict=True)):
            p = p + np.diag(self._walk * (t - before))
            before = t
            if t - t0 > RENEWAL_S:
                shift = (t - t0) / self._constant
                c = np.array([[1.0, shift, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, math.exp(-shift)]])
                x, p = c @ x, c @ p @ c.T
                t0 = t
            h = model_row(3, (t - t0) / self._constant)
            if abs(value - last) > self._step / 2 or abs(temperature - last) > self._step:
                spread = p @ h
                gain = spread / (h @ spread + self._step**2 / 16.0)
                x, p = x + gain * ((value + last) / 2 - h @ x), p - np.outer(gain, spread)
            slope = np.array([0.0, 1.0, -h[2]]) / self._constant
            temperature, last = float(h @ x), value
            variance = [row @ p @ row for row in (h, slope)]
            out[:, i] = temperature, slope @ x, *np.sqrt(variance)
        return RateEstimate(*out)


RENEWAL_S = 1.0
"""s between renewals of t0."""


def reference_fit(
    time_ns: IntArray,
    reading: FloatArray,
    step: float,
    window_s: float = 240.0,
    time_constant_s: float = 1800.0,
    every_s: float = 10.0,
) -> RateEstimate:
    """Return the paper's reference (section 2.3, eqs. 4 to 7): local fits in a centred moving window.

    Four coefficients, (α0 + β0 t/T0) + (α1 + β1 t/T0) e^(-t/T0), fitted to the level changes within the
    window; at the ends the window stands still.  Where it holds fewer than eight, it is widened until it does
    not.  The fit is made every `every_s` seconds and interpolated.

    Parameters
    ----------
    time_ns, reading : array, (n,)
        A record in one segment; °C.
    step : float
        Quantization step in °C.
    window_s, time_constant_s, every_s : float
        T, T0 and the distance between fits in s.
    """
    seconds = (time_ns - time_ns[0]) * 1e-9
    at = np.flatnonzero(np.abs(np.diff(reading)) > step / 2) + 1
    times, values = seconds[at], 0.5 * (reading[at] + reading[at - 1])
    if len(times) < 8:
        return RateEstimate(*np.full((4, len(reading)), np.nan))
    knots = np.append(np.arange(0.0, seconds[-1], every_s), seconds[-1])
    fits = np.array(
        [_local_fit(t, times, values, step, window_s, time_constant_s, seconds[-1]) for t in knots]
    )
    return RateEstimate(*(np.interp(seconds, knots, column) for column in fits.T))


def _local_fit(
    t: float,
    times: FloatArray,
    values: FloatArray,
    step: float,
    window_s: float,
    time_constant_s: float,
    end: float,
) -> FloatArray:
    """Return temperature, rate and their standard deviations at t."""
    half = window_s / 2
    middle = min(max(t, half), max(end - half, half))
    while (np.abs(times - middle) <= half).sum() < 8:
        half *= 1.25
        middle = min(max(t, half), max(end - half, half))
    inside = np.abs(times - middle) <= half
    # Time from the window's middle: the span of the functions is the same, their numbers stay small.
    u = (times[inside] - middle) / time_constant_s
    v = (t - middle) / time_constant_s
    decay = math.exp(-v)
    h = np.column_stack([np.ones_like(u), u, np.exp(-u), u * np.exp(-u)])
    row = np.array([1.0, v, decay, v * decay])
    slope = np.array([0.0, 1.0, -decay, (1.0 - v) * decay]) / time_constant_s
    inverse = np.linalg.pinv(h, rcond=1e-9)
    x = inverse @ values[inside]
    sigma = step / 4
    return np.array(
        [row @ x, slope @ x, sigma * np.linalg.norm(row @ inverse), sigma * np.linalg.norm(slope @ inverse)]
    )
