"""The low-pass of the sensors."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray


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
            from scipy.signal import butter, sosfilt_zi  # takes 0.3 s, and not every unit has a filter

            self._sections = butter(2, cutoff_hz, fs=rate_hz, output="sos")
            self._carried = sosfilt_zi(self._sections)[:, :, np.newaxis] * start

    def process(self, values: FloatArray) -> FloatArray:
        """Return the next samples, filtered; both of shape (n, k)."""
        if self._sections is None:
            return values
        from scipy.signal import sosfilt

        out, self._carried = sosfilt(self._sections, values, axis=0, zi=self._carried)
        return np.asarray(out)
