"""Encoder of packets that carry identified fields: the mirror of `tagged`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, ColumnArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import Encoder
from imumon.protocols.numbers import Derived, is_missing, packed
from imumon.protocols.stream import ByteArray
from imumon.protocols.tagged import FIXED, XBUS, Field, Form


class TaggedEncoder(Encoder):
    """Makes one Xbus or MIP packet per row.

    Raises BAD_CONFIG when a field has no values to encode or the packet becomes too long.

    Parameters
    ----------
    fields : sequence of Field
        What a packet carries, in this order.  In a list, a field of which a row has no value is left out.
    derived : sequence of Derived
        How columns that are not sent are turned into those that are.
    form : Form
        XBUS or MIP.
    kind : int
        Packet type.
    role : int
        LIST (each field has a header) or FIXED (none has).
    """

    def __init__(
        self, fields: Sequence[Field], derived: Sequence[Derived], form: Form, kind: int, role: int
    ) -> None:
        empty = [field.name for field in fields if not field.values]
        if empty:
            raise ImumonError(Reason.BAD_CONFIG, f"{', '.join(empty)}: carries nothing that can be encoded")
        header = 0 if role == FIXED else form.header
        longest = sum(header + field.size for field in fields)
        if longest > form.longest:
            raise ImumonError(Reason.BAD_CONFIG, f"a packet with these fields has {longest} bytes, too many")
        self._fields = tuple(fields)
        self._derived = tuple(derived)
        self._form, self._kind, self._role = form, kind, role

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return a packet for each row, of fields that have a value; see `imumon.protocols.base.Encoder`."""
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

    def _present(self, field: Field, columns: Mapping[str, ColumnArray], n: int) -> BoolArray:
        """Tell in which rows there is something to send; a field without any column is sent as zero."""
        found = [columns[column.name] for column in field.columns if column.name in columns]
        if self._role == FIXED or not found:
            return np.ones(n, np.bool_)
        present = np.zeros(n, np.bool_)
        for values in found:
            present |= ~is_missing(values)
        return present

    def _pack(
        self, field: Field, columns: Mapping[str, ColumnArray], rows: npt.NDArray[np.intp]
    ) -> ByteArray:
        parts = [packed(field.name, value, columns, rows) for value in field.values]
        if self._role == FIXED:
            header: list[int] = []
        elif self._form is XBUS:
            header = [field.key >> 8, field.key & 0xFF, field.size]
        else:
            header = [field.size + 2, field.key & 0xFF]
        parts.insert(0, np.tile(np.array(header, np.uint8), (len(rows), 1)))
        return np.concatenate(parts, axis=1)

    def _wrap(self, payload: ByteArray) -> ByteArray:
        """Put header and checksum around each row."""
        n, size = payload.shape
        extended = self._form is XBUS and size >= 255
        header = [*self._form.start, self._kind, *([255, size >> 8, size & 0xFF] if extended else [size])]
        headers = np.tile(np.array(header, np.uint8), (n, 1))
        return self._form.check.sealed_rows(np.concatenate([headers, payload], axis=1))
