"""What speaks against the device file in a capture that was decoded with it: nothing else would say so."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.intake import RANGES
from imumon.magnitudes import GRAVITIES
from imumon.pipeline import PipelineCounters

LEAST_ROWS = 50
"""Fewer say nothing of a device file: the unit may have been dropped."""
SKIPPED = 0.25
"""Share of the bytes in no packet.  A length that is wrong by a byte loses every second packet."""
IMPOSSIBLE = 0.1
"""Share of the readings of a sensor that none can have: of floats with swapped bytes nearly half are."""


class Doubts:
    """Counts readings that no unit has, while the samples go by.

    Parameters
    ----------
    described : bool
        Whether the device file states how long a packet is and where its checksum stands.
    """

    def __init__(self, described: bool) -> None:
        self._described = described
        self._counts = {name: np.zeros(2, np.int64) for name in ("gyro", "accel", "force")}
        """Readings that no sensor has, specific forces beyond `GRAVITIES`; and all of them."""

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks as they are."""
        for block in blocks:
            for sensor in ("gyro", "accel"):
                if (values := block.vector(sensor)) is not None:
                    self._count(sensor, values, *RANGES[f"{sensor}_"][:2])
            if (force := block.accel) is not None:
                with np.errstate(over="ignore"):
                    size = np.sqrt((force**2).sum(axis=1)) / STANDARD_GRAVITY
                self._count("force", size, *GRAVITIES)
            yield block

    def _count(self, name: str, values: FloatArray, low: float, high: float) -> None:
        self._counts[name] += [((values < low) | (values > high)).sum(), (~np.isnan(values)).sum()]

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
        for sensor in ("gyro", "accel"):
            bad, count = self._counts[sensor]
            if count >= 3 * LEAST_ROWS and bad > IMPOSSIBLE * count:
                _, most, unit = RANGES[f"{sensor}_"]
                texts.append(
                    f"{bad / count:.0%} of the {sensor} readings are beyond {most:g} {unit}, as none can be:"
                    " are byte order, type and place of its fields right in the device file?"
                )
        beyond, forces = self._counts["force"]
        if forces >= LEAST_ROWS and beyond > 0.5 * forces:
            texts.append(
                f"{beyond / forces:.0%} of the specific forces are below {GRAVITIES[0]} or above"
                f" {GRAVITIES[1]:g} times gravity: are byte order, scale and unit right in the device file?"
            )
        return texts
