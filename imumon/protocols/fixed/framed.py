"""Decoder of described packets beyond the compiled search: several kinds, tails, zeros, fields by turns.

The description is the same (`imumon.protocols.fixed.description`); the frames are found in plain NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray
from imumon.protocols.base import COMMON, MAIN
from imumon.protocols.fixed.decoder import column_values, record_type
from imumon.protocols.fixed.description import Packet
from imumon.protocols.frame_checks import rearranged, trailing, unchecked
from imumon.protocols.framing import IMPOSSIBLE, Check, Found, Frame, Lengths
from imumon.protocols.numbers import NUMBER_TYPES
from imumon.protocols.payload import LayoutDecoder
from imumon.protocols.stream import ByteArray


class DescribedLayout:
    """What a described packet carries; a field that is not there at its turn is missing."""

    def __init__(self, packet: Packet) -> None:
        self._placed = packet.placed()
        self._length = packet.length
        self._type = record_type(self._placed, packet.length)
        self.columns = tuple(item.column for item in self._placed)
        self.of_column = {c.name: MAIN for c in self.columns if c.name not in COMMON}

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        records = found.bytes(self._length).view(self._type)[:, 0]
        columns = {item.column.name: column_values(records[item.column.name], item) for item in self._placed}
        for item in self._placed:
            if item.when is not None:
                absent = columns[item.when.column] % item.when.modulo != item.when.equals
                columns[item.column.name][absent] = NO_INT if item.column.dtype == "int64" else np.nan
        return columns


class FramedFixedDecoder(LayoutDecoder):
    """Decodes packets of described kinds, a row for each, or for those of one moment.

    Parameters
    ----------
    name : str
        What a packet without a name is called in the counters.
    packets : sequence of Packet
        Of several that begin at the same place the first that is valid counts.
    rate_hz : float or None
        Nominal packet rate.
    """

    def __init__(self, name: str, packets: Sequence[Packet], rate_hz: float | None) -> None:
        timings = [packet.timing(rate_hz) for packet in packets]
        counted = next((t for t in timings if t.counter_bits is not None), timings[0])
        timed = next((t for t in timings if t.tick_ns is not None), timings[0])
        timing = replace(timed, counter_bits=counted.counter_bits)
        super().__init__([_frame(packet, name) for packet in packets], timing)
        for packet in packets:
            self._add(DescribedLayout(packet))

    def _layout_numbers(self, found: Found) -> IntArray:
        return found.frame


def _frame(packet: Packet, name: str) -> Frame:
    return Frame(
        packet.name or name, bytes(packet.sync), _lengths(packet), _check(packet), bytes(packet.tail)
    )


def _lengths(packet: Packet) -> Lengths:
    field = packet.length_field

    def lengths(held: ByteArray, at: IntArray) -> IntArray:
        result = np.full(len(at), packet.length, np.int64)
        if field is not None:
            order = field.byte_order or packet.byte_order
            for k, byte in enumerate(field.value.to_bytes(NUMBER_TYPES[field.type].size, order)):
                place = at + field.at + k
                agrees = held[np.minimum(place, len(held) - 1)] == byte
                result[(place < len(held)) & ~agrees] = IMPOSSIBLE
        return result

    return lengths


def _check(packet: Packet) -> Check:
    field = packet.checksum
    if field.type == "none":
        return unchecked
    check = trailing(field.type, big=(field.byte_order or packet.byte_order) == "big", zeros=field.zeros)
    places = [*range(field.first, field.last + 1), *range(field.at, field.at + check.size)]
    return rearranged(check, lambda _: places)
