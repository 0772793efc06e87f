"""Finite-impulse-response exponential regression on updates.

After Kozlov and Tarygin, "Real-Time Estimation of Temperature Time Derivative in Inertial Measurement Unit by
Finite-Impulse-Response Exponential Regression on Updates", Sensors 2020, 20(5), 1299.  Equation numbers are
those of the paper.

A measurement exists when the reading changes level (4), or when the model has left the reading (15).  In
between, and until the oldest measurement expires, state and outputs are functions of time alone; so whole
stretches of samples are evaluated at once, and what happens at a sample is written per event.

The paper adds and removes measurements by recursion.  Here the buffer is fitted anew at each event: the same
least squares, without the digits that a removal cancels.  The covariance is P = S Sᵀ with S upper triangular.
"""

import math
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.temperature_rate.stage import RateEstimate, TemperatureRate
from imumon.filters.slots import ENDLESS_NS, SlotGatherer

ORDER = 3
"""Coefficients of the model α + βu + γe^(-u) (13)."""
START_SD = 1e6
"""Standard deviation of each coefficient without a measurement."""
START_SPACING_S = 60.0
"""The virtual start measurements lie a minute apart."""
STRETCH = 64
"""Samples that are evaluated at once at first; twice as many each time nothing happens."""


class Params(NamedTuple):
    """What a user may set; the paper has 300 or 180 s, 180 or 120 s, and 90 measurements."""

    step: float = 0.05  # quantization step δτ of the sensor in °C
    window_s: float = 300.0  # least length T_w of the window in s
    time_constant_s: float = 180.0  # time constant T0 in s
    buffer_size: int = 90  # N > 2 `ORDER`; when so many measurements are in the buffer, the oldest goes

    @property
    def sigma(self) -> float:
        """σ0 of a measurement, °C."""
        return self.step / 4.0


@dataclass
class State:
    """What the filter carries from sample to sample."""

    buffer: FloatArray  # measurements in use, oldest first, °C and s, (m, 2); the oldest is at t0
    last_reading: float
    temperature: float  # of the last sample, °C
    x: FloatArray  # α, β and γ, °C, (3,)
    s: FloatArray  # upper triangular, S Sᵀ the covariance, (3, 3)

    @classmethod
    def start(cls, params: Params, reading: float) -> "State":
        """Listing 1: 2n virtual measurements of the first reading, one a minute into the past."""
        times = -START_SPACING_S * np.arange(2 * ORDER, 0, -1)
        buffer = np.column_stack([np.full(2 * ORDER, reading), times])
        return cls(buffer, reading, reading, *fit(buffer, params))


def fit(buffer: FloatArray, params: Params) -> tuple[FloatArray, FloatArray]:
    """Return x and S of the model (13), h = (1, u, e^-u), by QR of [h z]: no squares are formed."""
    u = (buffer[:, 1] - buffer[0, 1]) / params.time_constant_s
    rows = np.column_stack([np.ones_like(u), u, np.exp(-u), buffer[:, 0]])
    _, r = np.linalg.qr(np.vstack([np.eye(ORDER, ORDER + 1) / START_SD, rows / params.sigma]))
    solved = np.linalg.solve(r[:ORDER, :ORDER], np.column_stack([r[:ORDER, ORDER], np.eye(ORDER)]))
    return solved[:, 0], solved[:, 1:] * np.sign(np.diag(r)[:ORDER])


def expires_s(state: State, params: Params) -> float:
    """Return when the oldest measurement expires (section 3.3), infinity if not before another comes."""
    buffer = state.buffer
    if len(buffer) == params.buffer_size:
        return -math.inf
    # As in listing 2 the newest and the second oldest must be T_w apart, and 2 n measurements remain.
    if len(buffer) <= 2 * ORDER or buffer[-1, 1] - buffer[1, 1] < params.window_s:
        return math.inf
    return float(buffer[0, 1]) + params.window_s


def evaluate(state: State, params: Params, seconds: FloatArray) -> FloatArray:
    """Return temperature, rate and their standard deviations (13, 17) at these times, (4, n).

    Written out, not as a product of matrices: the same sample must give the same bits in any block.
    """
    x, s, constant = state.x, state.s, params.time_constant_s
    u = (seconds - state.buffer[0, 1]) / constant
    t1 = s[0, 1] + u * s[1, 1]
    decay = np.exp(-u)
    t2 = s[0, 2] + u * s[1, 2] + decay * s[2, 2]
    r2 = s[1, 2] - decay * s[2, 2]
    temperature, rate = x[0] + u * x[1] + decay * x[2], (x[1] - decay * x[2]) / constant
    temperature_sd, rate_sd = np.sqrt(s[0, 0] ** 2 + t1**2 + t2**2), np.sqrt(s[1, 1] ** 2 + r2**2) / constant
    return np.array([temperature, rate, temperature_sd, rate_sd])


class FirRate:
    """Least squares of a short-term model over the level changes of the last few minutes."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self.state: State | None = None
        self._runs = SlotGatherer(0, ENDLESS_NS)
        self._origin_ns = 0

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call.

        `time_ns`, `segment` (n,): device time and the number of its segment; a new segment starts the filter
            anew.
        `reading` (n,): °C; a sample whose reading is not finite is passed over.
        """
        n = len(reading)
        out = np.full((4, n), np.nan)
        breaks = self._runs.process(time_ns, segment, np.empty((n, 0))).row.tolist()
        for begin, end in pairwise(sorted({0, *breaks, n})):
            if begin in breaks:
                self.state = None
            if self.state is None:
                valid = np.flatnonzero(np.isfinite(reading[begin:end]))
                if not len(valid):
                    continue
                begin += valid[0]
                self._origin_ns = time_ns[begin]
                self.state = State.start(self.params, reading[begin])
            seconds = (time_ns[begin:end] - self._origin_ns).astype(np.float64) * 1e-9
            self._run(self.state, seconds, reading[begin:end], out[:, begin:end])
        return RateEstimate(*out)

    def _run(self, state: State, seconds: FloatArray, reading: FloatArray, out: FloatArray) -> None:
        """Fill (4, n): listing 2 at each sample at which something happens, its outputs at the others."""
        params, at, length = self.params, 0, STRETCH
        n = len(seconds)
        while at < n:
            part = slice(at, min(at + length, n))
            values = evaluate(state, params, seconds[part])
            stop = at + self._quiet(state, seconds[part], reading[part], values[0])
            out[:, at:stop] = values[:, : stop - at]
            if stop > at:
                state.temperature = out[0, stop - 1]
            at, length = stop, 2 * length
            if stop < part.stop:
                self._event(state, seconds[at], reading[at], out[:, at])
                at, length = at + 1, STRETCH

    def _quiet(self, state: State, seconds: FloatArray, reading: FloatArray, temperature: FloatArray) -> int:
        """Return how many samples pass until something happens."""
        params, last = self.params, state.last_reading
        before = np.concatenate([[state.temperature], temperature[:-1]])
        happens = np.isfinite(reading) & ((reading != last) | (np.abs(before - last) > params.step))
        happens |= seconds > expires_s(state, params)
        return int(np.argmax(happens)) if happens.any() else len(happens)

    def _event(self, state: State, t: float, reading: float, out: FloatArray) -> None:
        """Go through listing 2 at one sample, and fill its outputs, (4,)."""
        params, last, before = self.params, state.last_reading, state.buffer
        if math.isfinite(reading):
            if abs(reading - last) > params.step / 2 or abs(state.temperature - last) > params.step:
                state.buffer = np.vstack([before, [(reading + last) / 2.0, t]])
            state.last_reading = reading
        while t > expires_s(state, params):
            state.buffer = state.buffer[1:]
        if state.buffer is not before:
            state.x, state.s = fit(state.buffer, params)
        out[:] = evaluate(state, params, np.array([t]))[:, 0]
        state.temperature = out[0]


class FirStage(TemperatureRate):
    """The paper's filter as a stage, one for each temperature of the block."""

    prefix, title = "fir_", "FIR-estimated"

    def __init__(self, params: Params) -> None:
        super().__init__(new_method=partial(FirRate, params))
