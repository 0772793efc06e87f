"""Encoder of fixed-length packets, the inverse of the decoder, from the same device file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import SampleBlock
from imumon.protocols.base import Encoder
from imumon.protocols.fixed.description import Packet
from imumon.protocols.numbers import write


class FixedEncoder(Encoder):
    """Makes the packets that a device file describes, one after the other for each row."""

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
