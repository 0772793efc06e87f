"""Encoder of fixed-length packets, the inverse of the decoder, from the same device file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import SampleBlock
from imumon.protocols.base import Encoder
from imumon.protocols.fixed.description import Packet
from imumon.protocols.numbers import packed
from imumon.protocols.stream import ByteArray


class FixedEncoder(Encoder):
    """Makes the packets that a device file describes, one after the other for each row."""

    def __init__(self, packets: Sequence[Packet]) -> None:
        self._packets = packets

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the packets of each row; see `imumon.protocols.base.Encoder`."""
        parts = [_encoded(packet, block) for packet in self._packets]
        return [b"".join(row) for row in zip(*parts, strict=True)]


def _encoded(packet: Packet, block: SampleBlock) -> list[bytes]:
    sent: ByteArray = np.zeros((len(block), packet.length), np.uint8)
    sent[:, : len(packet.sync)] = packet.sync
    for at, byte in packet.length_bytes():
        sent[:, at] = byte
    turns, rows = packet.turns(), np.arange(len(block))
    for item in packet.placed():
        number = packed(packet.name or "packet", item.value, block.columns, rows)
        when = turns.get(item.name)
        if when is not None and when.column in block:
            number = number * (block[when.column] % when.modulo == when.equals)[:, np.newaxis]
        sent[:, item.at : item.end] |= number if item.big else number[:, ::-1]
    field, check = packet.checksum, packet.check()
    if check is not None:
        begin = np.arange(len(sent)) * packet.length
        sums = check.values(sent.reshape(-1), begin + field.first, begin + field.last + 1)
        sent[:, field.at : field.at + check.size] = check.stored(sums)
    return [row.tobytes() + bytes(packet.tail) for row in sent]
