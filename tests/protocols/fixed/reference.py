"""A plain Python decoder of fixed packets, the twin that the compiled one is compared with."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

from imumon.protocols.fixed import FixedDevice
from imumon.protocols.framing import Checksum

CODES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "u64": "Q", "i64": "q",
         "f32": "f", "f64": "d"}  # fmt: skip


@dataclass
class Reference:
    """Rows of raw field values, and the accounting."""

    rows: list[dict[str, float | int]] = field(default_factory=list)
    offsets: list[int] = field(default_factory=list)
    checksum_errors: int = 0
    length_errors: int = 0
    pending: int = 0


def decode(device: FixedDevice, data: bytes, final: bool = True) -> Reference:
    """Scan byte by byte: at each place a whole packet, or one step on."""
    packet, out = device.packet, Reference()
    sync, at, unfinished = bytes(packet.sync), 0, -1
    while at < len(data):
        piece = data[at : at + packet.length]
        verdict = _judge(device, piece, sync)
        if verdict == "good":
            out.rows.append(_fields(device, piece))
            out.offsets.append(at)
            at, unfinished = at + packet.length, -1
            continue
        if verdict == "incomplete":
            if not final:
                unfinished = at
                break
            unfinished = at if unfinished < 0 else unfinished
        out.checksum_errors += verdict == "checksum"
        out.length_errors += verdict == "length"
        at += 1
    out.pending = len(data) - unfinished if unfinished >= 0 else 0
    return out


def _judge(device: FixedDevice, piece: bytes, sync: bytes) -> str:
    packet = device.packet
    if piece[: len(sync)] != sync[: len(piece)]:
        return "no sync"
    if packet.length_field is not None:
        spec = packet.length_field
        size = struct.calcsize(CODES[spec.type])
        want = spec.value.to_bytes(size, spec.byte_order or packet.byte_order)
        seen = piece[spec.at : spec.at + size]
        if seen != want[: len(seen)]:
            return "length"
    if len(piece) < packet.length:
        return "incomplete"
    if packet.checksum.type == "none":
        return "good"
    check = Checksum(packet.checksum.type)
    buf = np.frombuffer(piece, np.uint8)
    first, stop = np.array([packet.checksum.first]), np.array([packet.checksum.last + 1])
    computed = int(check.values(buf, first, stop)[0])
    at = packet.checksum.at
    order = packet.checksum.byte_order or packet.byte_order
    return "good" if computed == int.from_bytes(piece[at : at + check.size], order) else "checksum"


def _fields(device: FixedDevice, piece: bytes) -> dict[str, float | int]:
    row: dict[str, float | int] = {}
    for item in device.packet.numbers:
        value, kind = item, item.type
        if kind in ("u24", "i24"):
            raw: float | int = int.from_bytes(
                piece[item.at : item.at + 3], "big" if item.big else "little", signed=kind == "i24"
            )
        else:
            raw = struct.unpack_from((">" if item.big else "<") + CODES[kind], piece, item.at)[0]
        if value.mask:
            shift = (value.mask & -value.mask).bit_length() - 1
            raw = (int(raw) & value.mask) >> shift
        assert value.column is not None
        if value.column.dtype == "float64":
            raw = float(raw) * value.factor + value.offset
        elif kind in ("f32", "f64"):
            raw = round(float(raw) * value.factor)
        row[item.name] = raw
    return row
