"""What a device really sends: its columns and its rate, measured for a moment."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.configure.command_link import CommandLink
from imumon.protocols.device import DeviceFile
from imumon.protocols.numbers import is_missing

LEAST_S, MOST_S = 1.5, 5.0
"""Shortest and longest time for `PACKETS`; what comes once a second is received in the shortest."""
PACKETS = 20
"""With so many packets, delays of a USB adapter (16 ms) move the rate by less than `TOLERANCE`."""
TOLERANCE = 0.1
"""Difference of rates that no clock explains; the next whole divisor differs by less only above ten."""
PERIODS = 2.5
"""At any rate so many samples are waited for."""
SETTLE_S = 0.3
"""Time after a change of which nothing is measured: what was kept back comes at once."""
FEWEST = 4
"""A rate is determined by two intervals behind a first packet that may have waited."""
MAIN_COLUMNS = ("gyro_x", "accel_x", "delta_velocity_x", "q_w", "roll", "mag_x", "temperature", "pressure")
"""What the rate is measured on: the first of them that comes."""


@dataclass(frozen=True, slots=True)
class Stream:
    """What came within a time."""

    seconds: float
    """Time listened."""
    columns: tuple[str, ...]
    """Columns with values."""
    samples: int
    """Of the first of `MAIN_COLUMNS` that came."""
    rate_hz: float | None
    """Their rate; None when they were too few for a rate."""
    warnings: tuple[str, ...]
    """Why the numbers are not fit for an estimate, as the decoder has it."""

    def problem(self, wanted: Sequence[tuple[str, ...]], rate_hz: float | None) -> str:
        """Return why this is not what was requested; empty when it is.

        Of each group of `wanted` one column must have come.
        """
        if not self.columns:
            return f"no data came within {self.seconds:.1f} s"
        missing = [group[0] for group in wanted if not set(group) & set(self.columns)]
        if missing:
            return f"{', '.join(missing)} did not come within {self.seconds:.1f} s"
        due = (rate_hz or 0.0) * (1 - TOLERANCE) * self.seconds
        if self.samples and self.rate_hz is None and due >= FEWEST:
            return f"{self.samples} samples came within {self.seconds:.1f} s, not at {rate_hz:.6g} Hz"
        if rate_hz and self.rate_hz and abs(self.rate_hz / rate_hz - 1) > TOLERANCE:
            return f"data come at {self.rate_hz:.4g} Hz, not at {rate_hz:.6g} Hz"
        return ""


def measure(link: CommandLink, device: DeviceFile, rate_hz: float | None) -> Stream:
    """Listen to a device and return what it sends.

    Raises LOST when the port failed.
    """
    decoder, times = device.decoder(), dict[str, list[np.ndarray]]()
    seconds = max(min(max(PACKETS / rate_hz, LEAST_S), MOST_S), PERIODS / rate_hz) if rate_hz else LEAST_S
    link.discard(SETTLE_S)
    start = time.monotonic()
    while (left := start + seconds - time.monotonic()) > 0:
        decoder.feed(link.port.read(min(left, 0.05)), time.time_ns())
        block = decoder.take()
        for name, values in block.columns.items():
            if name != "arrival_time_ns":
                times.setdefault(name, []).append(block["arrival_time_ns"][~is_missing(values)])
    received = {name: np.concatenate(parts) for name, parts in times.items()}
    columns = tuple(name for name, arrivals in received.items() if len(arrivals))
    main = next((received[name] for name in MAIN_COLUMNS if name in columns), np.zeros(0, np.int64))
    after = main[main > main[0]] if len(main) else main  # the first may have waited together
    rate = len(after) * 1e9 / float(after[-1] - main[0]) if len(after) >= 2 else None
    return Stream(seconds, columns, len(main), rate, tuple(decoder.warnings()))
