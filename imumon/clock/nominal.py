"""Whether a nominal rate is true: a device that sends no time is dated by it, and may send at another."""

from __future__ import annotations

import numpy as np

from imumon.blocks import NO_INT, IntArray
from imumon.clock.device import RATE_STEADINESS

MEASURED_S = 10.0
"""Arrivals scatter by 0.1 s and more; over so long they tell a rate to a few percent."""
SILENT_NS = 3_000_000_000
"""After a longer silence nobody knows how many packets there would have been."""
SETTLE_NS = 1_000_000_000
"""What comes so soon after a silence, or first of all, may have been sent long before: it is not counted."""


class NominalRate:
    """Compares the time that a nominal rate gives with the times of arrival.

    Parameters
    ----------
    rate_hz : float or None
        Packets per second; None where nothing is dated by it.
    given : bool
        Whether a person gave it for this stream, and not the device file for all.
    """

    def __init__(self, rate_hz: float | None, given: bool) -> None:
        self._rate_hz, self._given = rate_hz, given
        self._last: tuple[int, int, int] | None = None
        self._device_s = self._arrived_s = self._latest_s = 0.0
        self._since_ns = 0
        self._reported = False

    @property
    def measured_hz(self) -> float | None:
        """The rate by the times of arrival; None before there is enough of them."""
        if self._rate_hz is None or self._arrived_s < MEASURED_S:
            return None
        return self._rate_hz * self._device_s / self._arrived_s

    def add(self, time_ns: IntArray, segment: IntArray, arrival_ns: IntArray) -> None:
        """Take rows that were dated by the rate, (n,) each, behind those of the last call."""
        known = arrival_ns != NO_INT
        rows = np.column_stack([time_ns[known], segment[known], arrival_ns[known]])
        if not len(rows):
            return
        if self._last is not None:
            rows = np.vstack([self._last, rows])
        else:
            self._since_ns = int(rows[0, 2])
        self._last = int(rows[-1, 0]), int(rows[-1, 1]), int(rows[-1, 2])
        step, change, arrived = np.diff(rows, axis=0).T
        since = np.where(arrived >= SILENT_NS, rows[1:, 2], self._since_ns)
        since = np.maximum.accumulate(np.append(self._since_ns, since))
        self._since_ns = int(since[-1])
        settled = rows[:-1, 2] - since[:-1] > SETTLE_NS
        known = (arrived >= 0) & (arrived < SILENT_NS)
        near = settled & known & (change == 0)
        self._latest_s = max(self._latest_s, float(arrived[known].max(initial=0)) * 1e-9)
        self._device_s += float(step[near].sum()) * 1e-9
        self._arrived_s += float(arrived[near].sum()) * 1e-9

    def notices(self, ended: bool) -> list[str]:
        """Return, once, that the rate is contradicted, or at the end that it is only assumed."""
        rate, measured = self._rate_hz, self.measured_hz
        if rate is None or self._reported:
            return []
        whose = "the given" if self._given else "the device file's nominal"
        spaced = f"no packet says when it was measured: the rows are spaced at {whose} {rate:g} Hz"
        if measured is not None:
            # The packets at either end may have waited for as long as the longest time without a read.
            late_s = 2.0 * self._latest_s
            if abs(self._device_s - self._arrived_s) <= self._arrived_s / RATE_STEADINESS + late_s:
                return []
            self._reported = True
            found = f"{float(f'{measured:.3g}'):g}"
            advice = f"replay with --rate {found}, or say rate_hz: {found} in the device file"
            return [f"{spaced}, but they arrive at {found} Hz: {advice}"]
        if not ended or self._given:
            return []
        self._reported = True
        return [f"{spaced}, and nothing shows whether they came at it: if they did not, give --rate HZ"]
