"""Finite-impulse-response exponential regression on updates.

After Kozlov and Tarygin, "Real-Time Estimation of Temperature Time Derivative in Inertial Measurement Unit by
Finite-Impulse-Response Exponential Regression on Updates", Sensors 2020, 20(5), 1299.  Equation numbers are
those of the paper.

A measurement exists when the reading changes level (4), or when the model has left the reading (15).  In
between, and until the oldest measurement expires, state and outputs are functions of time alone; so whole
stretches of samples are evaluated at once, and what happens at a sample is written per event.

The recursion is the paper's, with two safeguards that keep it a least-squares fit of its buffer.  The state
is fitted anew from the buffer (a) when taking out a measurement would cost too many digits, and (b) every
`REFIT_SPAN` time constants: moving t0 shrinks the covariance of γ by e^(-s) each time, and with it what is
left of the start's 10⁶ °C, which after an hour would hold γ at zero as firmly as a measurement does.

Least squares are in square-root form after Carlson and Potter, in the notation of the paper's appendices A to
D, derived anew because signs are lost there.  The covariance is
P = S Sᵀ with S upper triangular.

For the update write P⁺ = S (E - f fᵀ / (σ² + fᵀf)) Sᵀ with f = Sᵀhᵀ, and d_j = σ² + Σ_{k≤j} f_k².
The upper triangular B with B Bᵀ = E - f fᵀ/d_n has B_jj = √(d_{j-1}/d_j) and, for i < j,
B_ij = -f_i f_j / √(d_{j-1} d_j).  Then S⁺ = S B: its column j is
S_j √(d_{j-1}/d_j) - K_j f_j / √(d_{j-1} d_j) with K_j = Σ_{k<j} S_k f_k.
The removal has P⁻ = S (E + f fᵀ / (σ² - fᵀf)) Sᵀ, that is the same with f² counted negatively:
d_j = σ² - Σ_{k≤j} f_k², and B_ij = +f_i f_j / √(d_{j-1} d_j).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_triangular

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.temperature_rate.stage import RateEstimate, TemperatureRate
from imumon.filters.slots import Breaks

ORDER = 3
"""Coefficients of the model α + βu + γe^(-u) (13)."""
START_SD = 1e6
"""Standard deviation of each coefficient before the first measurement."""
START_SPACING_S = 60.0
"""The virtual start measurements lie a minute apart."""
REFIT_SPAN = 2.0
"""Time constants by which t0 may move before the state is fitted anew."""
LEAST_SHARE = 1e-4
"""A measurement is pulled back only when the others leave this share of its variance to it."""
STRETCH = 64
"""Samples that are evaluated at once at first; twice as many each time nothing happens."""


@dataclass(frozen=True, slots=True)
class Params:
    """What a user may set; the paper has 300 or 180 s, 180 or 120 s, and 90 measurements.

    Raises ValueError when they are out of range.
    """

    step: float = 0.05
    """Quantization step δτ of the sensor in °C."""
    window_s: float = 300.0
    """Least length T_w of the window in s."""
    time_constant_s: float = 180.0
    """Time constant T0 in s."""
    buffer_size: int = 90
    """N > 2 `ORDER`; when so many measurements are in the buffer, the oldest goes."""

    def __post_init__(self) -> None:
        positive = self.step > 0 and self.window_s > 0 and self.time_constant_s > 0
        if not (positive and self.buffer_size > 2 * ORDER):
            raise ValueError("step, window and time constant must be positive, and the buffer exceed 6")

    @property
    def sigma(self) -> float:
        """σ0 of a measurement, °C."""
        return self.step / 4.0


@dataclass
class State:
    """What the filter carries from sample to sample."""

    x: FloatArray
    """α, β and γ, °C, (3,)."""
    s: FloatArray
    """Upper triangular, S Sᵀ the covariance, (3, 3)."""
    t0: float
    """Time bias, s."""
    last_reading: float
    temperature: float
    """Of the last sample, °C."""
    buffer: deque[tuple[float, float]] = field(default_factory=deque)
    """Measurements in use, oldest first, °C and s."""
    shift: float = 0.0
    """Time constants by which t0 moved since the last fit."""


def model_row(u: float) -> FloatArray:
    """Return h (13) at u = (t - t0)/T0, (3,)."""
    return np.array([1.0, u, math.exp(-u)])


def start(params: Params, t: float, reading: float) -> State:
    """Listing 1: 2n virtual measurements of the first reading, one a minute into the past."""
    begin = t - 2 * ORDER * START_SPACING_S
    state = State(np.zeros(ORDER), START_SD * np.eye(ORDER), begin, reading, reading)
    for k in range(2 * ORDER, 0, -1):
        measure(state, params, t - k * START_SPACING_S, reading)
    return state


def measure(state: State, params: Params, t: float, z: float) -> None:
    """Store a measurement (4, 15) and take it into the state (9, 11)."""
    state.buffer.append((z, t))
    u = (t - state.t0) / params.time_constant_s
    state.x, state.s = update(state.x, state.s, z, model_row(u), params.sigma)


def expires_s(state: State, params: Params) -> float:
    """Return when the oldest measurement expires (section 3.3), infinity if not before another comes."""
    buffer = state.buffer
    if len(buffer) == params.buffer_size:
        return -math.inf
    # As in listing 2 the newest and the second oldest must be T_w apart, and 2 n measurements remain.
    if len(buffer) <= 2 * ORDER or buffer[-1][1] - buffer[1][1] < params.window_s:
        return math.inf
    return buffer[0][1] + params.window_s


def expire(state: State, params: Params, t: float) -> None:
    """Pull back what has expired or overflows the buffer (12), and move t0 (section 3.4)."""
    sound = True
    while t > expires_s(state, params):
        z, time = state.buffer.popleft()
        if sound:
            h = model_row((time - state.t0) / params.time_constant_s)
            pulled = pull_back(state.x, state.s, z, h, params.sigma, LEAST_SHARE)
            sound = pulled is not None
            state.x, state.s = pulled or (state.x, state.s)
    oldest = state.buffer[0][1]
    shift = (oldest - state.t0) / params.time_constant_s
    state.t0, state.shift = oldest, state.shift + shift
    if sound and state.shift <= REFIT_SPAN:
        state.x, state.s = move_bias(state.x, state.s, shift)
    else:
        refit(state, params)


def move_bias(x: FloatArray, s: FloatArray, shift: float) -> tuple[FloatArray, FloatArray]:
    """Move t0 by `shift` time constants (16): x ← C x, S ← C S.

    C and S are upper triangular with positive diagonals, so C S is the Cholesky factor of C S Sᵀ Cᵀ; to form
    that product first would square the condition number.
    """
    c = np.array([[1.0, shift, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, math.exp(-shift)]])
    return c @ x, c @ s


def refit(state: State, params: Params) -> None:
    """Fit the measurements of the buffer from scratch."""
    data = np.array(state.buffer)
    rows = np.array([model_row(u) for u in (data[:, 1] - state.t0) / params.time_constant_s])
    state.x, state.s = fit(rows, data[:, 0], params.sigma, START_SD)
    state.shift = 0.0


def evaluate(state: State, params: Params, seconds: FloatArray) -> FloatArray:
    """Return temperature, rate and their standard deviations (13, 17) at these times, (4, n).

    Written out, not as a product of matrices: the same sample must give the same bits in any block.
    """
    x, s, constant = state.x, state.s, params.time_constant_s
    u = (seconds - state.t0) / constant
    t1 = s[0, 1] + u * s[1, 1]
    decay = np.exp(-u)
    t2 = s[0, 2] + u * s[1, 2] + decay * s[2, 2]
    r2 = s[1, 2] - decay * s[2, 2]
    temperature, rate = x[0] + u * x[1] + decay * x[2], (x[1] - decay * x[2]) / constant
    temperature_sd, rate_sd = np.sqrt(s[0, 0] ** 2 + t1**2 + t2**2), np.sqrt(s[1, 1] ** 2 + r2**2) / constant
    return np.array([temperature, rate, temperature_sd, rate_sd])


def update(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float
) -> tuple[FloatArray, FloatArray]:
    """Return x, (n,), and S, (n, n), with the measurement z = h x + noise taken in (eqs. 9 and 11)."""
    return _change(x, s, z, h, sigma, 1.0)


def pull_back(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float, least_share: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return x and S with a measurement taken out again (eq. 12), or None if it cannot be.

    The share of the measurement's variance that the others leave, 1 - h P hᵀ/σ², must exceed `least_share`:
    below it they do not determine the state (share 0), or cancellation eats up the digits.
    """
    f = h @ s
    if not sigma**2 - float(f @ f) > least_share * sigma**2:
        return None
    return _change(x, s, z, h, sigma, -1.0)


def _change(
    x: FloatArray, s: FloatArray, z: float, h: FloatArray, sigma: float, sign: float
) -> tuple[FloatArray, FloatArray]:
    """Take in (sign 1) or out (sign -1), column by column: B_ij = ∓f_i f_j / √(d_j-1 d_j)."""
    f, changed, gain, before = h @ s, np.empty_like(s), np.zeros(len(x)), sigma**2
    for j, f_j in enumerate(f.tolist()):
        after = before + sign * f_j * f_j
        changed[:, j] = math.sqrt(before / after) * s[:, j] - sign * f_j / math.sqrt(before * after) * gain
        gain += f_j * s[:, j]
        before = after
    return x + sign * gain / before * (z - float(h @ x)), changed


def fit(rows: FloatArray, z: FloatArray, sigma: float, start_sd: float) -> tuple[FloatArray, FloatArray]:
    """Return x and S of a fit from scratch, by QR: no squares are formed, half of the condition is spared.

    Parameters
    ----------
    rows : array (m, n)
        h of each measurement.
    z : array (m,)
    sigma, start_sd : float
        Standard deviation of a measurement, and of each element of x before.
    """
    n = rows.shape[1]
    system = np.vstack([np.eye(n) / start_sd, rows / sigma])
    q, r = np.linalg.qr(system)
    x = solve_triangular(r, q.T @ np.concatenate([np.zeros(n), z / sigma]))
    # R⁻¹ with a positive diagonal.
    s = solve_triangular(r, np.eye(n))
    return x, s * np.sign(np.diag(s))


class FirRate:
    """Least squares of a short-term model over the level changes of the last few minutes."""

    def __init__(self, params: Params) -> None:
        self.params = params
        self.state: State | None = None
        self._breaks = Breaks()
        self._origin_ns = 0

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call.

        Parameters
        ----------
        time_ns, segment : array, (n,)
            Device time and the number of its segment; a new segment starts the filter anew.
        reading : array, (n,)
            °C; a sample whose reading is not finite is passed over.
        """
        n = len(reading)
        out = np.full((4, n), np.nan)
        if not n:
            return RateEstimate(*out)
        breaks = self._breaks.rows(time_ns, segment)
        for begin, end in pairwise(sorted({0, *breaks, n})):
            if begin in breaks:
                self.state = None
            if self.state is None:
                valid = np.flatnonzero(np.isfinite(reading[begin:end]))
                if not len(valid):
                    continue
                begin += int(valid[0])
                self._origin_ns = int(time_ns[begin])
                self.state = start(self.params, 0.0, float(reading[begin]))
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
                state.temperature = float(out[0, stop - 1])
            at, length = stop, 2 * length
            if stop < part.stop:
                self._event(state, float(seconds[at]), float(reading[at]), out[:, at])
                at, length = at + 1, STRETCH

    def _quiet(self, state: State, seconds: FloatArray, reading: FloatArray, temperature: FloatArray) -> int:
        """Return how many samples pass until something happens."""
        params, last = self.params, state.last_reading
        before = np.concatenate([[state.temperature], temperature[:-1]])
        with np.errstate(invalid="ignore"):
            happens = np.abs(reading - last) > params.step / 2
            happens |= np.isfinite(reading) & (np.abs(before - last) > params.step)
            happens |= np.isfinite(reading) & (reading != last)
        happens |= seconds > expires_s(state, params)
        return int(np.argmax(happens)) if happens.any() else len(happens)

    def _event(self, state: State, t: float, reading: float, out: FloatArray) -> None:
        """Go through listing 2 at one sample, and fill its outputs, (4,)."""
        params, last = self.params, state.last_reading
        if math.isfinite(reading):
            if abs(reading - last) > params.step / 2 or abs(state.temperature - last) > params.step:
                measure(state, params, t, (reading + last) / 2.0)
            state.last_reading = reading
        if t > expires_s(state, params):
            expire(state, params, t)
        out[:] = evaluate(state, params, np.array([t]))[:, 0]
        state.temperature = float(out[0])


class FirStage(TemperatureRate):
    """The paper's filter as a stage, one for each temperature of the block.

    `retired` is whether the retired key ``method`` of a device file requested it.
    """

    prefix, title = "fir_", "FIR-estimated"

    def __init__(self, params: Params, retired: bool = False) -> None:
        super().__init__(new_method=partial(FirRate, params))
        if retired:
            text = "temperature: method is not used any more, it is as published: [fir]"
            self._notices[text] = False
