"""What decoders and encoders of all families have in common: timing, groups of columns, packets."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from imumon.blocks import IntArray, SampleBlock
from imumon.errors import bad_config

T = TypeVar("T")

MAIN = "imu"
"""Name of the stream of the inertial sensors."""
OTHER = "other"
"""Group of packets that have nothing but fields of no group, where these are not of the main one."""
NO_GROUP = ""
"""Group of times and counters."""
COMMON = ("arrival_time_ns", "device_ticks", "packet_counter")
"""Columns of a packet that every stream of its fields has."""

ByteArray = npt.NDArray[np.uint8]

CHUNK = 1 << 16
"""Bytes that wait at the most until they are searched; assumed."""
LONGEST_PACKET = 4096
"""Bytes that a packet may have, so also the most that can be pending; assumed."""


class Timing(NamedTuple):
    """How a device counts time."""

    counter_bits: int | None = None
    """``packet_counter`` wraps at 2**counter_bits and rises by one a packet; None: there is none."""
    tick_ns: Fraction | None = None
    """Nanoseconds per count of ``device_ticks``; None when the device sends no time."""
    tick_bits: int = 0
    """``device_ticks`` wraps at 2**tick_bits; 0 when it never wraps."""
    rate_hz: float | None = None
    """Nominal packet rate, which dates packets of a device that sends no time; decoders do not know it."""


class Groups(NamedTuple):
    """Which columns belong together."""

    names: tuple[str, ...]
    """Groups in the order of their bits; the first is `MAIN`."""
    number_of: Mapping[str, int]
    """Number of the group of each column; a column that is not here goes with every row of its packet."""
    apart: tuple[bool, ...]
    """Groups that never join the main stream."""
    layouts: Mapping[str, tuple[int, ...]]
    """Numbers of the layouts that have each column: columns with the same numbers come together."""

    @classmethod
    def of(
        cls, layouts: Iterable[Mapping[str, str]], names: Sequence[str] = (), apart: Sequence[str] = ()
    ) -> "Groups":
        """Return the groups of layouts, of which the group of each column is given; the first counts.

        `names`: groups that come first, behind the main one; `OTHER`: there is a stream of what has no group.
        `apart`: groups that never join the rows of the main one.
        """
        number_of, having = dict[str, int](), dict[str, tuple[int, ...]]()
        there = {name: number for number, name in enumerate((MAIN, *names))}
        for number, layout in enumerate(layouts):
            for column, group in layout.items():
                # A group may stay without columns, where others had them all before; packets have its bit.
                number_of.setdefault(column, there.setdefault(group, len(there)))
                having[column] = (*having.get(column, ()), number)
        return cls(tuple(there), number_of, tuple(name in apart for name in there), having)

    def bits(self, groups: Collection[str]) -> int:
        """Return the bits of groups; without any, that of `OTHER`, or else of the main one."""
        there = groups or ({OTHER} & {*self.names}) or {MAIN}
        return sum(1 << self.names.index(group) for group in there)


class Packets(NamedTuple):
    """Decoded packets in order of arrival."""

    block: SampleBlock
    """One row each."""
    groups: IntArray
    """Bits of the groups of which the packet has fields, (n,)."""


class Encoder:
    """Makes the bytes that a device would send, for tests, the virtual device and benchmarks.

    `kinds`: each makes one packet of every row; those of a row are sent one after the other.
    """

    def __init__(self, *kinds: Callable[[SampleBlock], list[bytes]]) -> None:
        self._kinds = kinds

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the bytes of each row; what is missing is sent as NaN, or else as zero.

        Raises BAD_DATA when a value does not fit the field that carries it.
        """
        return [b"".join(row) for row in zip(*(make(block) for make in self._kinds), strict=True)]


def chosen(names: Sequence[str], there: Mapping[str, T], what: str) -> list[T]:
    """Return what is sent, by its names; raises BAD_CONFIG where there is no such, or nothing to send."""
    for name in names:
        if name not in there:
            known = ", ".join(sorted(there))
            raise bad_config(f"no {what} {name!r}", f"there are: {known}")
    if not names:
        raise bad_config("there is nothing to send")
    return [there[name] for name in names]
