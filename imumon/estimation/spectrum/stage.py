"""Live spectra of the gyros and accelerometers as a stage of the pipeline: no columns, but charts.

Welch, The use of fast Fourier transform for the estimation of power spectra, IEEE Trans. Audio
Electroacoust. 15 (1967): eq 1-4 with half-overlapping Hann windows.  scipy.signal takes 0.7 s to import.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock, join
from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.columns import Column

SPAN_S = 30.0  # length of the window of samples, s, and the most samples in it: above 1.09 kHz it is shorter
MOST_SAMPLES = 32768
PARTS = 7  # a segment is two of so many parts of the span: six overlap by half
FEWEST = 256  # samples that are needed: with fewer a segment has too few bins for a floor beside a line
GAP = 20.0  # a gap of more intervals is not bridged: the spectrum is that of what came after it
MOST_PEAKS = 3
FALSE_ALARM = 0.01  # chance that white noise shows a peak anywhere in a spectrum
FLOOR_BINS = 15  # the floor under a line is the median over so many bins on one side, beyond the bin itself
HALF_LINE = 2  # a line of a Hann window has its power in its bin and so many on either side
OVERLAP_COST = 19.0 / 18.0
"""Variance of half-overlapping Hann segments over that of as many independent ones, for many: Welch, section
on overlapped segments, 1 + 2 ρ² with ρ² = (1/6)²."""
_GROUPS = {
    "gyro": ("Angular rate, last 30 s at most", "°/s", float(np.degrees(1.0))),
    "accel": ("Specific force, last 30 s at most", "m/s²", 1.0),
}
KEPT = "device_time_ns", "segment", *(f"{group}_{axis}" for group in _GROUPS for axis in AXIS_COLORS)


class LiveSpectrum:
    """Power spectral densities of the last seconds, up to half the rate, with their lines named."""

    columns: Sequence[Column] = ()
    """None: a spectrum is not a quantity of each sample."""

    def __init__(self) -> None:
        self._blocks: deque[SampleBlock] = deque(maxlen=MOST_SAMPLES)
        """Of one segment: `KEPT` where they are sent."""

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Take the samples of a block; needs ``device_time_ns`` and ``segment``."""
        if not len(block):
            return {}
        segment = block["segment"]
        latest = SampleBlock({n: block[n][segment == segment[-1]] for n in KEPT if n in block})
        if len(latest) < len(block) or (self._blocks and self._blocks[-1]["segment"][-1] != segment[-1]):
            self._blocks.clear()
        self._blocks.append(latest)
        while self._blocks[0]["device_time_ns"][-1] < latest["device_time_ns"][-1] - SPAN_S * 1e9:
            self._blocks.popleft()
        return {}

    def charts(self) -> Sequence[Chart]:
        """Return one chart per sensor; none while there are too few samples."""
        if not self._blocks:
            return []
        kept = join([*self._blocks])
        kept = kept.rows(max(len(kept) - MOST_SAMPLES, 0), len(kept))
        intervals_ns = np.diff(kept["device_time_ns"])
        interval_ns = float(np.median(intervals_ns)) if len(kept) >= FEWEST else 0.0
        behind_gaps = np.flatnonzero(intervals_ns > GAP * interval_ns) + 1
        kept = kept.rows(int(behind_gaps.max(initial=0)), len(kept))
        if interval_ns <= 0.0 or len(kept) < FEWEST:
            return []
        found = [_chart(group, kept, interval_ns) for group in _GROUPS]
        return [chart for chart in found if chart.curves]


def _chart(group: str, block: SampleBlock, interval_ns: float) -> Chart:
    """Return the spectra of a sensor on an even grid, in which a lost packet is a straight line."""
    title, unit, factor = _GROUPS[group]
    curves, notes = [], []
    time_ns = block["device_time_ns"]
    even = np.arange(time_ns[0], time_ns[-1], interval_ns)
    readings = block.stacked([f"{group}_{axis}" for axis in AXIS_COLORS])
    for (axis, color), values in zip(AXIS_COLORS.items(), readings.T, strict=True):
        known = np.isfinite(values)
        if known.mean() < 0.5:
            continue
        filled = np.interp(even, time_ns[known], values[known])
        frequency, density, segments = welch(filled, interval_ns * 1e-9, 2 * (len(even) // PARTS))
        if not density[1:].any():
            continue
        curves.append(Curve(axis, frequency[1:], factor * np.sqrt(density[1:]), color, width=1.2))
        lines = [
            f"{at:.4g} Hz: {factor * rms:.3g} {unit} rms" for at, rms in peaks(frequency, density, segments)
        ]
        notes.append(f"{axis}  " + ("   ".join(lines) or "no line above the noise"))
    return Chart(
        f"spectrum_{group}",
        "Spectrum",
        title,
        Axis("frequency [Hz]", log=True),
        Axis(f"amplitude spectral density [{unit}/√Hz]", log=True),
        tuple(curves),
        notes=tuple(notes),
    )


def welch(values: FloatArray, interval_s: float, length: int) -> tuple[FloatArray, FloatArray, int]:
    """Return frequencies, Hz, the one-sided power spectral density, unit² per Hz, and the number of segments.

    The values, (n,), are evenly spaced; the segments have an even length, and overlap by half.
    """
    window = np.hanning(length + 1)[:-1]
    parts = np.lib.stride_tricks.sliding_window_view(values, length)[:: length // 2]
    parts = (parts - parts.mean(axis=1, keepdims=True)) * window
    power = np.abs(np.fft.rfft(parts, axis=1)) ** 2
    density = 2.0 * interval_s * power.mean(axis=0) / float(window @ window)
    density[[0, -1]] /= 2.0
    return np.arange(len(density)) / (length * interval_s), density, len(parts)


def peaks(frequency: FloatArray, density: FloatArray, segments: int) -> list[tuple[float, float]]:
    """Return frequency, Hz, and rms of the lines that no noise of this floor makes, the strongest first."""
    from scipy.special import gammaincinv  # 0.1 s, which no command spends before the first spectrum

    shape = segments / OVERLAP_COST  # of the gamma distribution of a mean of so many exponential variables
    # The first bins are left out: subtracting the mean of a segment has lowered them.
    padded = np.pad(density[HALF_LINE:], (HALF_LINE + FLOOR_BINS, FLOOR_BINS), "edge")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, FLOOR_BINS), axis=1)
    # The higher of the medians below and above each bin, so that the flank of a steep floor is no line.
    sides = np.maximum(medians[: len(density)], medians[-len(density) :])
    median, limit = gammaincinv(shape, [0.5, 1.0 - FALSE_ALARM / len(density)]) / shape
    floor = sides / median
    inner = np.arange(HALF_LINE + 1, len(density) - 1)
    top = (density[inner] >= density[inner - 1]) & (density[inner] > density[inner + 1])
    found = []
    for at in inner[top & (density[inner] > limit * floor[inner])].tolist():
        line = slice(at - HALF_LINE, at + HALF_LINE + 1)
        power = np.maximum(density[line] - floor[line], 0.0)
        middle = float(power @ frequency[line] / power.sum())
        found.append((middle, math.sqrt(power.sum() * frequency[1])))
    return sorted(found, key=lambda line: -line[1])[:MOST_PEAKS]
