"""Decoder of packets of fixed lengths that a device file describes (`imumon.protocols.fixed.description`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray
from imumon.protocols.fixed.description import Packet
from imumon.protocols.frame_checks import rearranged
from imumon.protocols.framing import IMPOSSIBLE, Check, Found, Frame, unchecked
from imumon.protocols.layouts import LayoutDecoder, Record, groups_of
from imumon.protocols.stream import ByteArray


class DescribedLayout(Record):
    """What a described packet carries; a field that is not there at its turn is missing."""

    def __init__(self, packet: Packet) -> None:
        super().__init__(packet.placed())
        self._turns = packet.turns()

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        columns = super().read(found)
        for name, when in self._turns.items():
            absent = columns[when.column] % when.modulo != when.equals
            columns[name][absent] = NO_INT if columns[name].dtype == np.int64 else np.nan
        return columns


class FixedDecoder(LayoutDecoder):
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
        self._packets = [DescribedLayout(packet) for packet in packets]
        groups = groups_of(self._packets) if len(packets) > 1 else None
        super().__init__([_frame(packet, name) for packet in packets], timing, groups, ())
        for layout in self._packets:
            self._add(layout)

    def _layout_numbers(self, found: Found) -> IntArray:
        return found.frame


def _frame(packet: Packet, name: str) -> Frame:
    return Frame(
        packet.name or name, bytes(packet.sync), partial(_length, packet), _check(packet), bytes(packet.tail)
    )


def _length(packet: Packet, held: ByteArray, at: IntArray) -> IntArray:
    result = np.full(len(at), packet.length, np.int64)
    for place, byte in packet.length_bytes():
        agrees = held[np.minimum(at + place, len(held) - 1)] == byte
        result[(at + place < len(held)) & ~agrees] = IMPOSSIBLE
    return result


def _check(packet: Packet) -> Check:
    field, check = packet.checksum, packet.check()
    if check is None:
        return unchecked
    if field.last + 1 == field.at and field.at + check.size == packet.length:
        return packet.check(field.first) or unchecked
    places = [*range(field.first, field.last + 1), *range(field.at, field.at + check.size)]
    return rearranged(check, partial(_always, places))


def _always(places: list[int], size: int) -> list[int]:
    del size
    return places
