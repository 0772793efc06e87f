"""The noise of a record as an autoregressive process: the filter that makes it white weighs a mean rightly.

Sway is a peak of the spectrum, and a filter that removes it is what a taper does, but fitted to the sway that
is there; white noise needs no filter, and then the weights are uniform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import ColumnArray, FloatArray

LARGEST_ORDER = 64
"""16 s of slots: three periods of sway of 0.2 Hz."""
VALUES_PER_ORDER = 4
"""An order of n/4 costs an eighth of the degrees of freedom of two axes."""

LARGEST_LINES = 3
LEAST_FOR_LINES = 48
"""Twelve seconds: a line needs some periods."""
LOWEST_CYCLES = 3
"""A line of fewer periods in the record is no line, but a drift."""
PADDED = 4
TAPERED = 35.0 / 18.0
"""A Hann taper makes coefficients scatter as n 18/35 values would: n Σ h⁴ / (Σ h²)²."""
FINEST = 1e-12
"""A series that is predicted to this share of its power is predicted to the last digit."""
SPECTRUM = 256
"""Frequencies at which a fitted spectrum is looked at; the hole of a fit is below a 16th of them."""
OUTSTANDING = 30.0
"""Power of a line over the median: exp(-30 ln 2 / 2) of four values per cell in 1024 cells is 0.1 %."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Autoregressive noise, e_k = r_k + a_1 r_{k-1} + ... + a_p r_{k-p}.

    Parameters
    ----------
    predictors : tuple of array
        Coefficients 1, a_1 ... a_m for each order m = 0 ... p.
    variances : array, (p + 1,)
        Of the errors of each order, relative to that of order p.
    variance : float
        Of e_k, of each axis.
    """

    predictors: tuple[FloatArray, ...]
    variances: FloatArray
    variance: float

    def white(self, columns: ColumnArray) -> ColumnArray:
        """Return columns (n, k) filtered so that the noise is white and of unit variance.

        The first rows use the predictors of lower order, as the Cholesky factor of the inverse covariance has
        it (Levinson's recursion).
        """
        if len(self.predictors) == 1:
            return np.asarray(columns / np.sqrt(self.variance))
        filtered = np.asarray(lfilter(self.predictors[-1], [1.0], columns, axis=0))
        for k in range(min(len(self.predictors) - 1, len(columns))):
            filtered[k] = self.predictors[k][::-1] @ columns[: k + 1] / np.sqrt(self.variances[k])
        return np.asarray(filtered / np.sqrt(self.variance))

    def filled(self, residual: ColumnArray, valid: ColumnArray) -> ColumnArray:
        """Return residuals (n,) whose invalid ones are predicted by those before them."""
        values, a = residual.copy(), self.predictors[-1][1:]
        values[~valid] = 0.0
        for k in np.flatnonzero(~valid).tolist():
            m = min(k, len(a))
            if m:
                values[k] = -(a[:m] @ values[k - m : k][::-1])
        return values


def lines(residual: ColumnArray, time_s: FloatArray) -> FloatArray:
    """Return sines and cosines of the narrow lines of a series, (n, 4 m), each also growing with time.

    A line stands out of the median of the spectrum (Hann taper) by more than noise does once in a thousand
    records; the growing parts bear a frequency that is a little off, and a sway that swells or fades.
    """
    found: list[FloatArray] = []
    n, left = len(residual), residual
    grow = np.linspace(-1.0, 1.0, n)
    step = (time_s[-1] - time_s[0]) / (n - 1)
    size = PADDED * n
    for _ in range(LARGEST_LINES if n >= LEAST_FOR_LINES else 0):
        spectrum = np.abs(np.fft.fft(np.hanning(n) * left, size)) ** 2
        power = spectrum[1 : size // 2] + spectrum[: size // 2 : -1][: size // 2 - 1]
        power[: LOWEST_CYCLES * PADDED] = 0.0
        k = int(np.argmax(power))
        if not 0 < k < len(power) - 1 or power[k] < OUTSTANDING * np.median(power):
            break
        below, peak, above = np.log(power[k - 1 : k + 2] + 1e-300).tolist()
        curve = below - 2.0 * peak + above
        offset = 0.5 * (below - above) / curve if curve < 0.0 else 0.0
        phase = 2.0 * np.pi * (k + 1 + min(max(offset, -1.0), 1.0)) / size / step * time_s
        wave = np.column_stack([np.cos(phase), np.sin(phase)])
        found += [wave, grow[:, None] * wave]
        columns = np.hstack(found)
        left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    return np.hstack(found) if found else np.zeros((n, 0))


def fitted(residual: ColumnArray, valid: ColumnArray, removed: int) -> Noise:
    """Return the noise of residuals, by Levinson's recursion on the autocovariance of the tapered series.

    The order is that of the least information criterion (Hurvich and Tsai 1989, Biometrika 76(2)).

    Parameters
    ----------
    residual : array of float or complex, (n,)
        A complex series is two axes with the same noise.
    valid : array of bool, (n,)
        Others are predicted by those before them.
    removed : int
        Parameters that were fitted to each axis.
    """
    count = int(valid.sum())
    axes = 2 if np.iscomplexobj(residual) else 1
    order = min(LARGEST_ORDER, count // VALUES_PER_ORDER)
    noise = _levinson(np.where(valid, residual, 0.0), order, axes * count)
    if len(noise.variances) > 1 and not valid.all():
        noise = _levinson(noise.filled(residual, valid), order, axes * count)
    order = len(noise.variances) - 1
    white = noise.white(noise.filled(residual, valid))[valid]
    free = max(count - removed - order / axes, 1.0)
    variance = float(np.sum(np.abs(white) ** 2)) / (axes * free)
    # A trend that was fitted leaves a hole at frequency zero, which is not in the noise.
    density = np.abs(np.fft.rfft(noise.predictors[-1], SPECTRUM)) ** -2.0
    hole = max(float(np.min(density[SPECTRUM // 16 :]) / density[0]), 1.0)
    return Noise(noise.predictors, noise.variances, max(hole * variance, 1e-40))


def _levinson(series: ColumnArray, order: int, values: int) -> Noise:
    """Return predictors of all orders up to the best, and their relative variances; its own stays at 1.

    From the autocovariance under a Hann taper, so that a peak does not leak to frequency zero, where a sway's
    spectrum has a hole: the angle is bounded, the rate is its derivative (Percival and Walden 1993, 9.4).
    """
    n = len(series)
    spectrum = np.abs(np.fft.fft(np.hanning(n + 2)[1:-1] * series, 2 * n)) ** 2
    covariance = np.fft.ifft(spectrum).real[: order + 1]
    a, error = np.ones(1), float(covariance[0])
    predictors, variances = [a], [error]
    for m in range(1, order + 1):
        if not error > FINEST * covariance[0]:
            break
        reflection = -float(a @ covariance[m:0:-1]) / error
        a = np.append(a, 0.0)
        a = a + reflection * a[::-1]
        error *= 1.0 - reflection**2
        predictors.append(a)
        variances.append(error)
    orders = np.arange(len(variances))
    relative = np.maximum(np.array(variances), 1e-300)
    relative = relative / relative[0]
    free = np.maximum(values - orders - 2, 1)
    information = values / TAPERED * np.log(relative) + 2.0 * (orders + 1) * values / free
    best = int(np.argmin(information)) + 1
    return Noise(tuple(predictors[:best]), relative[:best] / relative[best - 1], 1.0)
