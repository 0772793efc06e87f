"""Linear filters that carry their state from block to block: thermal lags and the sensors' low-pass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi

from imumon.blocks import FloatArray


class Lag:
    """First-order filters in equilibrium at the start, exact for an input that is linear between samples.

    Parameters
    ----------
    tau_s : sequence of float
        Time constant of each column; 0 leaves it as it is.
    step_s : float
        Time between samples.
    start : array of shape (k,)
        Input before the first sample, for ever.
    """

    def __init__(self, tau_s: Sequence[float], step_s: float, start: FloatArray) -> None:
        self._filters: list[tuple[int, FloatArray, FloatArray]] = []
        self._carried: dict[int, FloatArray] = {}
        for column, tau in enumerate(tau_s):
            if tau > 0.0:
                ratio = step_s / tau
                decay, mean = np.exp(-ratio), -np.expm1(-ratio) / ratio
                # y_k = decay y_(k-1) + (mean - decay) u_(k-1) + (1 - mean) u_k, for u linear in between
                forward = np.array([1.0 - mean, mean - decay])
                self._filters.append((column, forward, np.array([1.0, -decay])))
                self._carried[column] = np.array([(mean - decay) * start[column] + decay * start[column]])

    def process(self, values: FloatArray) -> FloatArray:
        """Return the filtered values of the next samples; both of shape (n, k)."""
        if not self._filters:
            return values
        out = values.copy()
        for column, forward, backward in self._filters:
            out[:, column], self._carried[column] = lfilter(
                forward, backward, values[:, column], zi=self._carried[column]
            )
        return out


class LowPass:
    """Second-order Butterworth filter (bilinear) on each column, settled on the first deterministic sample.

    At packet rates up to twice its cut-off it does nothing: a unit that sends as slowly as that averages its
    samples over the packet's period, which leaves the density of the noise as it is.

    Parameters
    ----------
    cutoff_hz : float or None
    rate_hz : float
    start : array of shape (k,)
        The signal before the first sample, without noise.
    """

    def __init__(self, cutoff_hz: float | None, rate_hz: float, start: FloatArray) -> None:
        self._sections: FloatArray | None = None
        if cutoff_hz is not None and rate_hz > 2.0 * cutoff_hz:
            self._sections = butter(2, cutoff_hz, fs=rate_hz, output="sos")
            self._carried = sosfilt_zi(self._sections)[:, :, np.newaxis] * start

    def process(self, values: FloatArray) -> FloatArray:
        """Return the next samples, filtered; both of shape (n, k)."""
        if self._sections is None:
            return values
        out, self._carried = sosfilt(self._sections, values, axis=0, zi=self._carried)
        return np.asarray(out)
