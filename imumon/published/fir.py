"""Finite-impulse-response exponential regression on updates, and its linear variant.

After Kozlov and Tarygin, "Real-Time Estimation of Temperature Time Derivative in Inertial Measurement Unit by
Finite-Impulse-Response Exponential Regression on Updates", Sensors 2020, 20(5), 1299.  Equation numbers are
those of the paper.

The recursion is the paper's, with two safeguards that keep it a least-squares fit of its buffer.  The state
is fitted anew from the buffer (a) when taking out a measurement would cost too many digits, and (b) every
`REFIT_SPAN` time constants: moving t0 shrinks the covariance of γ by e^(-s) each time, and with it what is
left of the start's 10⁶ °C, which after an hour would hold γ at nought as firmly as a measurement does.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.estimation.temperature_rate.series import RateEstimate, Resumable
from imumon.published.square_root import pull_back, rotate_in, solve, update

START_SD = 1e6
"""Standard deviation of each coefficient before the first measurement."""
START_SPACING_S = 60.0
"""The virtual start measurements lie a minute apart."""
REFIT_SPAN = 2.0
"""Time constants by which t0 may move before the state is fitted anew."""
LEAST_SHARE = 1e-4
"""A measurement is pulled back only when the others leave this share of its variance to it."""

# Numbers of the state.
T0_BIAS, LAST_READING, LAST_TEMPERATURE, SHIFT = range(4)
# Integers of the state: oldest and number of measurements in the buffer, whether the filter has started, and
# how often it was fitted anew.
OLDEST, COUNT, STARTED, REFITS = range(4)
# Numbers of the parameters.
STEP, WINDOW, TIME_CONSTANT = range(3)


class FirRate(Resumable):
    """Least squares of a short-term model over the level changes of the last few minutes.

    Parameters
    ----------
    order : int
        3: α + βu + γe^(-u) (eq. 13); 2: α + βu, the paper's section 4.2.
    step : float
        Quantization step δτ of the sensor in °C.
    window_s : float
        Least length T_w of the window in s.
    time_constant_s : float
        Time constant T0 in s.
    buffer_size : int
        Measurements kept at most, N > 2 `order`.
    """

    def __init__(
        self, order: int, step: float, window_s: float, time_constant_s: float, buffer_size: int
    ) -> None:
        if not (step > 0 and window_s > 0 and time_constant_s > 0 and buffer_size > 2 * order):
            raise ValueError("step, window and time constant must be positive, and the buffer exceed 2 n")
        self._parameters = np.array([step, window_s, time_constant_s])
        self._x = np.zeros(order)
        self._s = np.zeros((order, order))
        self._buffer = np.zeros((buffer_size, 2))
        self._numbers = np.zeros(4)
        self._integers: IntArray = np.zeros(4, np.int64)
        super().__init__(
            x=self._x, s=self._s, buffer=self._buffer, numbers=self._numbers, integers=self._integers
        )

    @property
    def coefficients(self) -> FloatArray:
        """The state x: α, β (and γ) in °C, (n,)."""
        return self._x.copy()

    @property
    def root(self) -> FloatArray:
        """Upper-triangular square root S of the covariance, (n, n)."""
        return self._s.copy()

    @property
    def time_bias_s(self) -> float:
        """t0, seconds since the segment's start."""
        return float(self._numbers[T0_BIAS])

    @property
    def measurements(self) -> FloatArray:
        """The measurements in use, oldest first: value in °C and time in s, (m, 2)."""
        rows = (self._integers[OLDEST] + np.arange(self._integers[COUNT])) % len(self._buffer)
        return np.asarray(self._buffer[rows])

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call.

        Parameters
        ----------
        time_ns, segment : array, (n,)
            Device time and the number of its segment; a new segment starts the filter anew.
        reading : array, (n,)
            °C; a sample whose reading is not finite is passed over.
        """
        result = RateEstimate.empty(len(reading))
        for start, stop, begins, seconds in self.clock.runs(time_ns, segment):
            if begins:
                self._integers[STARTED] = 0
            out = result.rows(start, stop)
            _process(
                seconds,
                reading[start:stop],
                self._parameters,
                self._x,
                self._s,
                self._buffer,
                self._numbers,
                self._integers,
                out.temperature,
                out.rate,
                out.temperature_sd,
                out.rate_sd,
            )
        return result


class FirExponentialRate(FirRate):
    """The paper's filter: exponential model, three coefficients.

    Parameters
    ----------
    step, window_s, time_constant_s, buffer_size
        See `FirRate`; the paper's are 0.05 °C, 300 s or 180 s, 180 s or 120 s, and 90.
    """

    def __init__(
        self,
        step: float = 0.05,
        window_s: float = 300.0,
        time_constant_s: float = 180.0,
        buffer_size: int = 90,
    ) -> None:
        super().__init__(3, step, window_s, time_constant_s, buffer_size)


class FirLinearRate(FirRate):
    """The linear variant (section 4.2): two coefficients.

    Parameters
    ----------
    step, window_s, buffer_size
        See `FirRate`.
    """

    def __init__(self, step: float = 0.05, window_s: float = 300.0, buffer_size: int = 90) -> None:
        # The time constant only scales u; the window keeps it near 1.
        super().__init__(2, step, window_s, window_s, buffer_size)


@njit
def model_row(n: int, u: float) -> FloatArray:
    """Return h (eq. 13) at u = (t - t0)/T0."""
    h = np.empty(n)
    h[0] = 1.0
    h[1] = u
    if n == 3:
        h[2] = math.exp(-u)
    return h


@njit
def _process(
    seconds: FloatArray,
    readings: FloatArray,
    parameters: FloatArray,
    x: FloatArray,
    s: FloatArray,
    buffer: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
    temperature: FloatArray,
    rate: FloatArray,
    temperature_sd: FloatArray,
    rate_sd: FloatArray,
) -> None:
    """Listing 2 of the paper for each sample, with listing 1 at the first valid reading."""
    step = parameters[STEP]
    for i in range(seconds.size):
        t, reading = seconds[i], readings[i]
        if math.isfinite(reading):
            if not integers[STARTED]:
                _start(t, reading, parameters, x, s, buffer, numbers, integers)
            last = numbers[LAST_READING]
            if abs(reading - last) > step / 2 or abs(numbers[LAST_TEMPERATURE] - last) > step:
                _measure(t, (reading + last) / 2, parameters, x, s, buffer, numbers, integers)
            numbers[LAST_READING] = reading
        if integers[STARTED]:
            if integers[COUNT] > 2 * x.size:
                _expire(t, parameters, x, s, buffer, numbers, integers)
            _evaluate(
                i, (t - numbers[T0_BIAS]) / parameters[TIME_CONSTANT], parameters[TIME_CONSTANT],
                x, s, temperature, rate, temperature_sd, rate_sd,
            )  # fmt: skip
            numbers[LAST_TEMPERATURE] = temperature[i]


@njit
def _start(
    t: float,
    reading: float,
    parameters: FloatArray,
    x: FloatArray,
    s: FloatArray,
    buffer: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
) -> None:
    """Listing 1: 2n virtual measurements of the first reading, one a minute into the past."""
    n = x.size
    x[:] = 0.0
    s[:] = 0.0
    for j in range(n):
        s[j, j] = START_SD
    numbers[T0_BIAS] = t - 2 * n * START_SPACING_S
    numbers[LAST_READING] = numbers[LAST_TEMPERATURE] = reading
    numbers[SHIFT] = 0.0
    integers[OLDEST] = 0
    integers[COUNT] = 0
    integers[STARTED] = 1
    for k in range(2 * n):
        _measure(t - (2 * n - k) * START_SPACING_S, reading, parameters, x, s, buffer, numbers, integers)


@njit
def _measure(
    t: float,
    z: float,
    parameters: FloatArray,
    x: FloatArray,
    s: FloatArray,
    buffer: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
) -> None:
    """Store a measurement (eqs. 4 and 15) and take it into the state."""
    size = buffer.shape[0]
    slot = (integers[OLDEST] + integers[COUNT]) % size
    buffer[slot, 0] = z
    buffer[slot, 1] = t
    integers[COUNT] += 1
    h = model_row(x.size, (t - numbers[T0_BIAS]) / parameters[TIME_CONSTANT])
    update(x, s, z, h, parameters[STEP] / 4)


@njit
def _expire(
    t: float,
    parameters: FloatArray,
    x: FloatArray,
    s: FloatArray,
    buffer: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
) -> None:
    """Pull back what has expired (section 3.3) or overflows the buffer, and move t0 (section 3.4)."""
    size, window = buffer.shape[0], parameters[WINDOW]
    sound, expired = True, False
    while True:
        oldest, count = integers[OLDEST], integers[COUNT]
        newest_time = buffer[(oldest + count - 1) % size, 1]
        old = (
            t - buffer[oldest, 1] > window
            and newest_time - buffer[(oldest + 1) % size, 1] >= window
            and count > 2 * x.size
        )
        if not (old or count == size):
            break
        if sound:
            h = model_row(x.size, (buffer[oldest, 1] - numbers[T0_BIAS]) / parameters[TIME_CONSTANT])
            sound = pull_back(x, s, buffer[oldest, 0], h, parameters[STEP] / 4, LEAST_SHARE)
        integers[OLDEST] = (oldest + 1) % size
        integers[COUNT] -= 1
        expired = True
    if expired:
        shift = (buffer[integers[OLDEST], 1] - numbers[T0_BIAS]) / parameters[TIME_CONSTANT]
        numbers[T0_BIAS] = buffer[integers[OLDEST], 1]
        numbers[SHIFT] += shift
        if sound and numbers[SHIFT] <= REFIT_SPAN:
            move_bias(x, s, shift)
        else:
            _refit(parameters, x, s, buffer, numbers, integers)


@njit
def move_bias(x: FloatArray, s: FloatArray, shift: float) -> None:
    """Move t0 by `shift` time constants (eq. 16): x ← C x, S ← C S.

    C and S are upper triangular with positive diagonals, so C S is the Cholesky factor of C S Sᵀ Cᵀ; to form
    that product first would square the condition number.
    """
    x[0] += shift * x[1]
    for j in range(1, x.size):
        s[0, j] += shift * s[1, j]
    if x.size == 3:
        decay = math.exp(-shift)
        x[2] *= decay
        s[2, 2] *= decay


@njit
def _refit(
    parameters: FloatArray,
    x: FloatArray,
    s: FloatArray,
    buffer: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
) -> None:
    """Fit the measurements of the buffer from scratch."""
    n, sigma = x.size, parameters[STEP] / 4
    r = np.zeros((n, n + 1))
    for j in range(n):
        r[j, j] = 1.0 / START_SD
    row = np.empty(n + 1)
    for k in range(integers[COUNT]):
        slot = (integers[OLDEST] + k) % buffer.shape[0]
        row[:n] = model_row(n, (buffer[slot, 1] - numbers[T0_BIAS]) / parameters[TIME_CONSTANT])
        row[n] = buffer[slot, 0]
        row /= sigma
        rotate_in(r, row)
    solve(r, x, s)
    numbers[SHIFT] = 0.0
    integers[REFITS] += 1


@njit
def _evaluate(
    i: int,
    u: float,
    time_constant: float,
    x: FloatArray,
    s: FloatArray,
    temperature: FloatArray,
    rate: FloatArray,
    temperature_sd: FloatArray,
    rate_sd: FloatArray,
) -> None:
    """Write the four outputs (eqs. 13 and 17) of sample i."""
    if x.size == 3:
        decay = math.exp(-u)
        temperature[i] = x[0] + u * x[1] + decay * x[2]
        rate[i] = (x[1] - decay * x[2]) / time_constant
        t1, t2 = s[0, 1] + u * s[1, 1], s[0, 2] + u * s[1, 2] + decay * s[2, 2]
        r2 = s[1, 2] - decay * s[2, 2]
        temperature_sd[i] = math.sqrt(s[0, 0] * s[0, 0] + t1 * t1 + t2 * t2)
        rate_sd[i] = math.sqrt(s[1, 1] * s[1, 1] + r2 * r2) / time_constant
    else:
        temperature[i] = x[0] + u * x[1]
        rate[i] = x[1] / time_constant
        t1 = s[0, 1] + u * s[1, 1]
        temperature_sd[i] = math.sqrt(s[0, 0] * s[0, 0] + t1 * t1)
        rate_sd[i] = abs(s[1, 1]) / time_constant
