"""Encoder of packets that carry identified fields: the mirror of `tagged`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, ColumnArray, FloatArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import Encoder
from imumon.protocols.numbers import NUMBER_TYPES, NumberType
from imumon.protocols.stream import ByteArray
from imumon.protocols.tagged import Derived, Field, Value
from imumon.protocols.tagged_kernel import FIXED, LONGEST_XBUS_PAYLOAD, MIP, XBUS

WRAPPING = ("packet_counter", "device_ticks")
"""Columns of which only the low bits are sent."""

_FLOAT32_MAX = float(np.finfo(np.float32).max)


class TaggedEncoder(Encoder):
    """Makes one Xbus or MIP packet per row.

    Parameters
    ----------
    fields : sequence of Field
        What a packet carries, in this order.  In a list, a field of which a row has no value is left out.
    derived : sequence of Derived
        How columns that are not sent are turned into those that are.
    framing : int
        XBUS or MIP.
    kind : int
        Packet type.
    role : int
        LIST (each field has a header) or FIXED (none has).

    Raises
    ------
    ImumonError
        BAD_CONFIG when a field has no values to encode or the packet becomes too long.
    """

    def __init__(
        self, fields: Sequence[Field], derived: Sequence[Derived], framing: int, kind: int, role: int
    ) -> None:
        empty = [field.name for field in fields if not field.values]
        if empty:
            raise ImumonError(Reason.BAD_CONFIG, f"{', '.join(empty)}: carries nothing that can be encoded")
        header = 0 if role == FIXED else 3 if framing == XBUS else 2
        longest = sum(header + field.size for field in fields)
        if longest > (LONGEST_XBUS_PAYLOAD if framing == XBUS else 255):
            raise ImumonError(Reason.BAD_CONFIG, f"a packet with these fields has {longest} bytes, too many")
        self._fields = tuple(fields)
        self._derived = tuple(derived)
        self._framing, self._kind, self._role = framing, kind, role

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; columns that the block lacks are sent as zero.

        Counters and clocks wrap as in the device.  Where a value is missing but its field is sent, it is sent
        as NaN, or as zero where the number has no NaN.

        Raises
        ------
        ImumonError
            BAD_DATA when a value does not fit the field that carries it.
        """
        columns = self._sent_columns(block)
        present = np.column_stack([self._present(field, columns, len(block)) for field in self._fields])
        packets: list[bytes] = [b""] * len(block)
        patterns, which = np.unique(present, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            rows = np.flatnonzero(which.reshape(-1) == number)
            parts = [
                self._pack(field, columns, rows)
                for field, sent in zip(self._fields, pattern, strict=True)
                if sent
            ]
            payload = np.concatenate(parts, axis=1) if parts else np.zeros((len(rows), 0), np.uint8)
            for row, packet in zip(rows, self._wrap(payload), strict=True):
                packets[row] = packet.tobytes()
        return packets

    def _sent_columns(self, block: SampleBlock) -> dict[str, ColumnArray]:
        columns = dict(block.columns)
        wanted = {column.name for field in self._fields for column in field.columns}
        for derived in self._derived:
            results = [column.name for column in derived.results]
            if wanted.issuperset(derived.sources) and all(name in block for name in results):
                columns.update(zip(derived.sources, derived.encode(columns), strict=True))
        return columns

    def _present(self, field: Field, columns: Mapping[str, ColumnArray], n: int) -> npt.NDArray[np.bool_]:
        """Tell in which rows there is something to send; a field without any column is sent as zero."""
        found = [columns[column.name] for column in field.columns if column.name in columns]
        if self._role == FIXED or not found:
            return np.ones(n, np.bool_)
        present = np.zeros(n, np.bool_)
        for values in found:
            present |= ~_is_missing(values)
        return present

    def _pack(
        self, field: Field, columns: Mapping[str, ColumnArray], rows: npt.NDArray[np.intp]
    ) -> ByteArray:
        parts = [packed(field.name, value, columns, rows) for value in field.values]
        if self._role == FIXED:
            header: list[int] = []
        elif self._framing == XBUS:
            header = [field.key >> 8, field.key & 0xFF, field.size]
        else:
            header = [field.size + 2, field.key & 0xFF]
        parts.insert(0, np.tile(np.array(header, np.uint8), (len(rows), 1)))
        return np.concatenate(parts, axis=1)

    def _wrap(self, payload: ByteArray) -> ByteArray:
        """Put header and checksum around each row."""
        n, size = payload.shape
        if self._framing == MIP:
            header = [0x75, 0x65, self._kind, size]
        else:
            header = [0xFA, 0xFF, self._kind, *([size] if size < 255 else [255, size >> 8, size & 0xFF])]
        packet = np.concatenate([np.tile(np.array(header, np.uint8), (n, 1)), payload], axis=1)
        sums = np.cumsum(packet, axis=1, dtype=np.int64)
        if self._framing == MIP:
            checksum = np.column_stack([sums[:, -1], np.sum(sums, axis=1)]) & 0xFF
        else:
            checksum = (0xFA - sums[:, -1:]) & 0xFF
        return np.concatenate([packet, checksum.astype(np.uint8)], axis=1)


def _is_missing(values: ColumnArray) -> npt.NDArray[np.bool_]:
    return np.isnan(values) if values.dtype.kind == "f" else values == NO_INT


def packed(
    name: str, value: Value, columns: Mapping[str, ColumnArray], rows: npt.NDArray[np.intp]
) -> ByteArray:
    """Return the bytes of one number of a field of this name, most significant first, (n, size).

    Raises
    ------
    ImumonError
        BAD_DATA when a value does not fit.
    """
    kind = NUMBER_TYPES[value.type]
    if value.column is None or value.column.name not in columns:
        return np.zeros((len(rows), kind.size), np.uint8)
    numbers = columns[value.column.name][rows]
    where = f"{name}, column {value.column.name}"
    if value.type in ("f32", "f64"):
        return _pack_float(numbers / value.factor, kind, where)
    numbers = np.where(_is_missing(numbers), 0, numbers)
    if numbers.dtype.kind == "f" or value.factor != 1.0:
        scaled = numbers / value.factor * (2.0**32 if value.type == "fp1632" else 1.0)
        _refuse(~np.isfinite(scaled) | (np.abs(scaled) > 2.0**62), numbers, where)
        numbers = np.rint(scaled).astype(np.int64)
    elif value.type == "fp1632":
        numbers = numbers * (1 << 32)
    if value.column.name not in WRAPPING:
        _refuse_outside(numbers, kind, where)
    most_first = numbers.astype(">i8").view(np.uint8).reshape(-1, 8)[:, 8 - kind.size :]
    # The fraction of fp16.32 goes before the integer part.
    return most_first[:, [2, 3, 4, 5, 0, 1]] if value.type == "fp1632" else most_first


def _pack_float(numbers: FloatArray, kind: NumberType, where: str) -> ByteArray:
    if kind.size == 4:
        _refuse(np.isfinite(numbers) & (np.abs(numbers) > _FLOAT32_MAX), numbers, where)
    return numbers.astype(f">f{kind.size}").view(np.uint8).reshape(-1, kind.size)


def _refuse_outside(numbers: ColumnArray, kind: NumberType, where: str) -> None:
    if kind.size == 8:
        return
    bits = 8 * kind.size
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if kind.signed else (0, (1 << bits) - 1)
    _refuse((numbers < low) | (numbers > high), numbers, where)


def _refuse(bad: npt.NDArray[np.bool_], numbers: ColumnArray, where: str) -> None:
    if np.any(bad):
        first = int(np.argmax(bad))
        raise ImumonError(
            Reason.BAD_DATA,
            f"{where}: {numbers[first]} does not fit ({int(np.sum(bad))} of {len(bad)} values)",
            "choose a wider number format or leave the column out",
        )
