"""Live spectra of the gyros and accelerometers as a stage of the pipeline: no columns, but charts."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.columns import Column
from imumon.estimation.spectrum.welch import Spectrum, peaks, welch

TAB = "Spectrum"
SPAN_S = 30.0
"""Length of the window of samples, s, and the most samples in it: above 1.09 kHz it is shorter."""
MOST_SAMPLES = 32768
PARTS = 7
"""A segment is two of so many parts of the span, or a little less: six overlap by half."""
FEWEST = 256
"""Samples that are needed: with fewer a segment has too few bins for a floor beside a line."""
GAP = 20.0
"""A gap of more intervals is not bridged: the spectrum is that of what came after it."""
_GROUPS = {
    "gyro": ("Angular rate, last 30 s at most", "°/s", float(np.degrees(1.0))),
    "accel": ("Specific force, last 30 s at most", "m/s²", 1.0),
}
CHANNELS = tuple(f"{group}_{axis}" for group in _GROUPS for axis in AXIS_COLORS)


class LiveSpectrum:
    """Power spectral densities of the last seconds, up to half the rate, with their lines named."""

    columns: Sequence[Column] = ()
    """None: a spectrum is not a quantity of each sample."""

    def __init__(self) -> None:
        self._blocks: deque[tuple[IntArray, dict[str, FloatArray]]] = deque()
        self._held = 0
        self._segment: int | None = None

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Take the samples of a block; needs ``device_time_ns`` and ``segment``."""
        names = [name for name in CHANNELS if name in block]
        if not len(block) or not names:
            return {}
        segment = int(block["segment"][-1])
        rows = np.flatnonzero(block["segment"] == segment)
        if segment != self._segment or len(rows) < len(block):
            self._blocks.clear()
            self._held, self._segment = 0, segment
        times = np.asarray(block["device_time_ns"][rows], np.int64)
        self._blocks.append((times, {name: np.asarray(block[name][rows], np.float64) for name in names}))
        self._held += len(rows)
        while len(self._blocks) > 1:
            oldest = self._blocks[0][0]
            if times[-1] - oldest[-1] <= SPAN_S * 1e9 and self._held - len(oldest) <= MOST_SAMPLES:
                break
            self._held -= len(self._blocks.popleft()[0])
        return {}

    def notices(self) -> list[str]:
        """Return nothing."""
        return []

    def charts(self) -> Sequence[Chart]:
        """Return one chart per sensor; none while there are too few samples."""
        if self._held < FEWEST:
            return []
        times = np.concatenate([block for block, _ in self._blocks])
        interval = float(np.median(np.diff(times)))
        if interval <= 0:
            return []
        breaks = np.flatnonzero(np.diff(times) > GAP * interval)
        first = int(breaks[-1]) + 1 if len(breaks) else 0
        if len(times) - first < FEWEST:
            return []
        even = np.arange(times[first], times[-1], interval)
        found = {}
        for name in CHANNELS:
            if all(name in columns for _, columns in self._blocks):
                values = np.concatenate([columns[name] for _, columns in self._blocks])[first:]
                found[name] = _spectrum(even, times[first:], values, interval * 1e-9)
        return [chart for group in _GROUPS if (chart := _chart(group, found)) is not None]


def _spectrum(even: FloatArray, times: IntArray, values: FloatArray, interval_s: float) -> Spectrum | None:
    """Return the spectrum on an even grid: a lost packet is a straight line; None with few values."""
    known = np.isfinite(values)
    if known.mean() < 0.5:
        return None
    from scipy.fft import prev_fast_len  # 0.2 s, which no command spends before the first spectrum

    return welch(
        np.interp(even, times[known], values[known]),
        interval_s,
        2 * prev_fast_len(max(len(even) // PARTS, 1)),
    )


def _chart(group: str, found: Mapping[str, Spectrum | None]) -> Chart | None:
    title, unit, factor = _GROUPS[group]
    curves, notes = [], []
    for axis, color in AXIS_COLORS.items():
        spectrum = found.get(f"{group}_{axis}")
        if spectrum is None or not (spectrum.density[1:] > 0).any():
            continue
        density = factor * np.sqrt(spectrum.density[1:])
        curves.append(Curve(axis, spectrum.frequency_hz[1:], density, color, width=1.2))
        lines = [
            f"{line.frequency_hz:.4g} Hz: {factor * line.rms:.3g} {unit} rms" for line in peaks(spectrum)
        ]
        notes.append(f"{axis}  " + ("   ".join(lines) or "no line above the noise"))
    if not curves:
        return None
    x, y = Axis("frequency [Hz]", log=True), Axis(f"amplitude spectral density [{unit}/√Hz]", log=True)
    return Chart(f"spectrum_{group}", TAB, title, x, y, tuple(curves), notes=tuple(notes))
