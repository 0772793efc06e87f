"""Encoder of fixed-length packets, the inverse of the decoder, from the same device file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import Encoder
from imumon.protocols.fixed.description import Packet, PlacedColumn
from imumon.protocols.frame_checks import trailing
from imumon.protocols.numbers import NUMBER_TYPES
from imumon.protocols.stream import ByteArray


class FixedEncoder(Encoder):
    """Makes the packets that a device file describes, one after the other for each row."""

    def __init__(self, packets: Sequence[Packet]) -> None:
        self._encoders = [PacketEncoder(packet) for packet in packets]

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the packets of each row; see `PacketEncoder.encode`."""
        parts = [encoder.encode(block) for encoder in self._encoders]
        return [b"".join(row) for row in zip(*parts, strict=True)]


class PacketEncoder:
    """Makes one packet a row."""

    def __init__(self, packet: Packet) -> None:
        self._packet = packet
        self._placed = packet.placed()

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; columns that the block lacks are sent as zero.

        Counters and clocks wrap as in the device; NaN is sent as zero where the field is an integer.

        Raises
        ------
        ImumonError
            BAD_DATA when a value does not fit its field.
        """
        packets: ByteArray = np.zeros((len(block), self._packet.length), np.uint8)
        packets[:, : len(self._packet.sync)] = self._packet.sync
        length = self._packet.length_field
        if length is not None:
            self._put(packets, length.at, length.type, length.byte_order, np.uint64(length.value))
        for item in self._placed:
            if item.column.name in block:
                bits = _raw_bits(item, block[item.column.name])
                if item.when is not None and item.when.column in block:
                    chosen = block[item.when.column] % item.when.modulo == item.when.equals
                    bits = np.where(chosen, bits, np.uint64(0))
                self._put(packets, item.at, item.type, "big" if item.big else "little", bits)
        if self._packet.checksum.type != "none":
            self._seal(packets)
        tail = bytes(self._packet.tail)
        return [row.tobytes() + tail for row in packets]

    def _put(
        self, packets: ByteArray, at: int, number: str, order: str | None, bits: ColumnArray | np.uint64
    ) -> None:
        size = NUMBER_TYPES[number].size
        for i in range(size):
            place = size - 1 - i if (order or self._packet.byte_order) == "big" else i
            packets[:, at + place] |= ((bits >> np.uint64(8 * i)) & np.uint64(0xFF)).astype(np.uint8)

    def _seal(self, packets: ByteArray) -> None:
        field = self._packet.checksum
        check = trailing(field.type, zeros=field.zeros)
        begins = np.arange(len(packets)) * self._packet.length
        sums = check.values(packets.reshape(-1), begins + field.first, begins + field.last + 1)
        number = {1: "u8", 2: "u16", 4: "u32"}[check.size]
        self._put(packets, field.at, number, field.byte_order, sums.astype(np.uint64))


def _raw_bits(item: PlacedColumn, values: ColumnArray) -> ColumnArray:
    """Return what goes into the bytes, as uint64, for each row."""
    number = NUMBER_TYPES[item.type]
    raw = (values.astype(np.float64) - item.offset) / item.scale
    if item.type == "f32":
        return raw.astype(np.float32).view(np.uint32).astype(np.uint64)
    if item.type == "f64":
        return raw.view(np.uint64)
    # Integers that are columns of integers keep all their bits; the others are rounded.
    whole = values if item.column.dtype == "int64" else np.rint(np.nan_to_num(raw)).astype(np.int64)
    if item.mask:
        low_bit = (item.mask & -item.mask).bit_length() - 1
        return (whole.astype(np.uint64) << np.uint64(low_bit)) & np.uint64(item.mask)
    if item.column.name not in ("packet_counter", "device_ticks"):
        low = -(1 << (8 * number.size - 1)) if number.signed else 0
        high = low + (1 << (8 * number.size)) - 1
        if len(whole) and number.size < 8 and (whole.min() < low or whole.max() > high):
            raise ImumonError(
                Reason.BAD_DATA,
                f"{item.column.name}: {values.min()} to {values.max()} does not fit its field ({item.type})",
                "choose a larger scale in the device file, or smaller values",
            )
    return whole.astype(np.uint64) & np.uint64((1 << (8 * number.size)) - 1)
