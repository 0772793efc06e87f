"""What speaks against the device file in a capture that was decoded with it: nothing else would say so."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from imumon.blocks import SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.intake import GRAVITIES, RANGES
from imumon.pipeline import PipelineCounters

LEAST_ROWS = 50
"""Fewer say nothing of a device file: the unit may have been dropped."""
SKIPPED = 0.25
"""Share of the bytes in no packet.  A length that is wrong by a byte loses every second packet."""

LIMITS = {
    "gyro": (*RANGES["gyro_"], 0.1, "byte order, type and place of its fields"),
    "accel": (*RANGES["accel_"], 0.1, "byte order, type and place of its fields"),
    "specific force": (*GRAVITIES, "times gravity", 0.5, "byte order, scale and unit"),
}
"""Least and greatest reading, the unit, the share beyond that is too much (of floats with swapped bytes
nearly half are), and what in the device file that speaks against."""


class Doubts:
    """Counts readings that no unit has, while the samples go by.

    `described` is whether the device file states how long a packet is and where its checksum stands.
    """

    def __init__(self, described: bool) -> None:
        self._described = described
        self._counts = {name: np.zeros(2, np.int64) for name in LIMITS}
        """Readings beyond the limits, and all of them."""

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks as they are."""
        for block in blocks:
            readings = {"gyro": block.gyro, "accel": block.accel}
            if (force := block.accel) is not None:
                with np.errstate(over="ignore"):
                    readings["specific force"] = np.sqrt((force**2).sum(axis=1)) / STANDARD_GRAVITY
            for name, values in readings.items():
                if values is not None:
                    low, high = LIMITS[name][:2]
                    beyond = (values < low) | (values > high)
                    self._counts[name] += [beyond.sum(), (~np.isnan(values)).sum()]
            yield block

    def found(self, counters: PipelineCounters) -> list[str]:
        """Return the warnings, each with its likely cause; nothing where all fits the device file."""
        texts = []
        skipped, received = counters.bytes_skipped, counters.bytes_received
        if self._described and skipped > SKIPPED * received:
            cause = "length of the packet (a wrong one swallows the beginning of the next)"
            if counters.checksum_errors > counters.packets:
                cause = "checksum, with its place and byte order,"
            texts.append(
                f"{skipped / received:.0%} of the bytes are in no packet: is the {cause} right in the device"
                " file?  Else the line is damaged, or something else sends on it"
            )
        for name, (low, high, unit, share, cause) in LIMITS.items():
            beyond, count = self._counts[name]
            if count >= LEAST_ROWS and beyond > share * count:
                texts.append(
                    f"{beyond / count:.0%} of the {name} readings are not within {low:g} to {high:g} {unit},"
                    f" as they must be: are {cause} right in the device file?"
                )
        return texts
