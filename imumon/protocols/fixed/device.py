"""Devices that send packets of fixed lengths, as their files describe them: decoder and encoder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock
from imumon.protocols.base import Encoder
from imumon.protocols.device import DeviceFile
from imumon.protocols.fixed.description import Packet
from imumon.protocols.frame_checks import rearranged
from imumon.protocols.framing import IMPOSSIBLE, Check, Found, Frame, unchecked
from imumon.protocols.layouts import LayoutDecoder, Record, groups_of
from imumon.protocols.numbers import write
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
        layouts = [DescribedLayout(packet) for packet in packets]
        groups = groups_of(layouts) if len(packets) > 1 else None
        super().__init__([_frame(packet, name) for packet in packets], timing, groups, ())
        for layout in layouts:
            self._add(layout)

    def _layout_numbers(self, found: Found) -> IntArray:
        return found.frame


def _frame(packet: Packet, name: str) -> Frame:
    length, tail = partial(_length, packet), bytes(packet.tail)
    return Frame(packet.name or name, bytes(packet.sync), length, _check(packet), tail)


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


class FixedEncoder(Encoder):
    """Makes described packets, one after the other for each row."""

    def __init__(self, packets: Sequence[Packet]) -> None:
        self._packets = packets

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the packets of each row; see `imumon.protocols.base.Encoder`."""
        parts = [_encoded(packet, block) for packet in self._packets]
        return [b"".join(row) for row in zip(*parts, strict=True)]


def _encoded(packet: Packet, block: SampleBlock) -> list[bytes]:
    columns, numbers, turns = dict(block.columns), packet.placed(), packet.turns()
    for item in numbers:
        when = turns.get(item.name)
        if when is not None and item.name in block and when.column in block:
            there = block[when.column] % when.modulo == when.equals
            columns[item.name] = np.where(there, block[item.name], item.value.offset)  # a raw zero
    sent = write(packet.name or "packet", numbers, packet.length, columns, np.arange(len(block)))
    sent[:, : len(packet.sync)] = packet.sync
    for at, byte in packet.length_bytes():
        sent[:, at] = byte
    field, check = packet.checksum, packet.check()
    if check is not None:
        begin = np.arange(len(sent)) * packet.length
        sums = check.values(sent.reshape(-1), begin + field.first, begin + field.last + 1)
        sent[:, field.at : field.at + check.size] = check.stored(sums)
    return [row.tobytes() + bytes(packet.tail) for row in sent]


class FixedDevice(DeviceFile):
    """A device that sends packets of one fixed length."""

    protocol: Literal["fixed"]
    packet: Packet

    def decoder(self) -> FixedDecoder:
        """Make a decoder for this packet."""
        return FixedDecoder(self.name, [self.packet], self.rate_hz)

    def encoder(self) -> FixedEncoder:
        """Make an encoder for this packet."""
        return FixedEncoder([self.packet])


class SeveralDevice(DeviceFile):
    """A device that sends several kinds of packets of fixed lengths; `sends` is for its virtual twin."""

    protocol: Literal["fixed-several"]
    packets: list[Packet] = Field(min_length=1)
    sends: list[str] = Field(min_length=1)

    @model_validator(mode="after")
    def _named(self) -> Self:
        names = [packet.name for packet in self.packets]
        if "" in names or len({*names}) < len(names):
            raise ValueError("packets: each needs a name of its own")
        unknown = sorted({*self.sends} - {*names})
        if unknown:
            raise ValueError(f"sends: no packet {', '.join(unknown)}; there are: {', '.join(names)}")
        return self

    def decoder(self) -> FixedDecoder:
        """Make a decoder for these packets."""
        return FixedDecoder(self.name, self.packets, self.rate_hz)

    def encoder(self) -> FixedEncoder:
        """Make an encoder for those that are sent."""
        return FixedEncoder([packet for packet in self.packets if packet.name in self.sends])
