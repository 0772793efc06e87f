"""Plain Python twin of the tagged decoder: the same rules, written to be read, byte by byte."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import NO_INT, SampleBlock
from imumon.protocols.messages import Message
from imumon.protocols.numbers import NUMBER_TYPES
from imumon.protocols.tagged import MIP, Form

MESSAGE, LIST, FIXED, COUNTED = range(4)
"""What a packet type is: a message, a list of fields, one field without header, or only counted."""


def candidate(data: bytes, at: int, framing: Form) -> int | str:
    """Length of the packet whose header stands at `at`, or "none", "cut" or "impossible"."""
    head = data[at : at + 6]
    if head[:1] != (b"\x75" if framing == MIP else b"\xfa"):
        return "none"
    if len(head) < 2:
        return "cut"
    if framing == MIP:
        if head[1] != 0x65:
            return "none"
        return head[3] + 6 if len(head) > 3 else "cut"
    if head[1] not in (0xFF, 0x01):
        return "none"
    if len(head) < 4:
        return "cut"
    if head[3] < 255:
        return head[3] + 5
    if len(head) < 6:
        return "cut"
    length = int.from_bytes(head[4:6], "big")
    return length + 7 if length <= 2048 else "impossible"


def checksum_right(packet: bytes, framing: Form) -> bool:
    if framing != MIP:
        return sum(packet[1:]) % 256 == 0
    first = second = 0
    for byte in packet[:-2]:
        first = (first + byte) % 256
        second = (second + first) % 256
    return packet[-2:] == bytes([first, second])


def payload_of(packet: bytes, framing: Form) -> bytes:
    if framing == MIP:
        return packet[4:-2]
    return packet[6:-1] if packet[3] == 255 else packet[4:-1]


def split_fields(kind: int, payload: bytes, framing: Form) -> list[tuple[int, bytes]] | None:
    """Identifier and data of each field; None when they do not fill the payload."""
    found = []
    while payload:
        if framing != MIP:
            if len(payload) < 3:
                return None
            key, header, end = int.from_bytes(payload[:2], "big"), 3, 3 + payload[2]
        else:
            if len(payload) < 2 or payload[0] < 2:
                return None
            key, header, end = kind << 8 | payload[1], 2, payload[0]
        if end > len(payload):
            return None
        found.append((key, payload[header:end]))
        payload = payload[end:]
    return found


def read_number(data: bytes, kind: str) -> float | int:
    if kind == "f32":
        return float(struct.unpack(">f", data)[0])
    if kind == "f64":
        return float(struct.unpack(">d", data)[0])
    if kind == "fp1632":
        return int.from_bytes(data[4:] + data[:4], "big", signed=True) / 2**32
    return int.from_bytes(data, "big", signed=NUMBER_TYPES[kind].signed)


def read_field(item: Message, data: bytes) -> dict[str, float | int]:
    found: dict[str, float | int] = {}
    for value in item.placed(0, len(data), True):
        number = read_number(data[value.at : value.end], value.type)
        if value.column is not None:
            integer = value.column.dtype == "int64"
            found[value.column.name] = number if integer else number * value.factor
    return found


@dataclass
class Twin:
    """What came out of a stream."""

    packets: list[tuple[int, bytes]] = field(default_factory=list)
    rows: list[dict[str, float | int]] = field(default_factory=list)
    in_packets: int = 0
    skipped: int = 0
    checksum_errors: int = 0
    length_errors: int = 0


def decode_plainly(
    data: bytes,
    arrival: Sequence[int],
    framing: Form,
    roles: Mapping[int, int],
    find: Callable[[int, int], Message | None],
) -> Twin:
    """Decode a whole stream as feed and finish do; `arrival` has the time of each byte."""
    twin = Twin()
    at = done = 0
    pending: int | None = None
    errors = [0, 0]
    while at < len(data):
        if at < done < len(data) and data[done] == (0x75 if framing == MIP else 0xFA):
            at = done
        length = candidate(data, at, framing)
        if length == "cut" or (isinstance(length, int) and at + length > len(data)):
            if pending is None:
                pending = at
                twin.checksum_errors += errors[0]
                twin.length_errors += errors[1]
                errors = [0, 0]
            at += 1
            continue
        if length == "impossible":
            errors[1] += at >= done
        if not isinstance(length, int) or at + length <= done:
            at += 1
            continue
        packet = data[at : at + length]
        if not checksum_right(packet, framing):
            errors[0] += at >= done
            at += 1
            continue
        kind, payload = packet[2], payload_of(packet, framing)
        role = roles.get(kind)
        listed = split_fields(kind, payload, framing) if role == LIST else [(0, payload)]
        if listed is None or (role == FIXED and find(0, len(payload)) is None):
            errors[1] += at >= done
            at += 1
            continue
        twin.checksum_errors += errors[0]
        twin.length_errors += errors[1]
        errors, pending = [0, 0], None
        twin.skipped += max(at - done, 0)
        twin.in_packets += at + length - max(at, done)
        twin.packets.append((kind, payload))
        done = at + length
        at += 1
        if role in (LIST, FIXED):
            row: dict[str, float | int] = {}
            for key, content in listed:
                match = find(key, len(content))
                if match is not None:
                    row.update(read_field(match, content))
            if row:
                twin.rows.append({**row, "arrival_time_ns": arrival[done - 1]})
    if pending is None:
        twin.checksum_errors += errors[0]
        twin.length_errors += errors[1]
        twin.skipped += len(data) - done
    else:
        twin.skipped += max(pending - done, 0)
    return twin


def assert_same(block: SampleBlock, rows: Sequence[Mapping[str, float | int]]) -> None:
    """Compare decoded rows with those of the twin, bit for bit (columns computed from others left out)."""
    assert len(block) == len(rows)
    for name in block.columns:
        values = block[name]
        missing = NO_INT if values.dtype == np.int64 else np.nan
        if any(name in row for row in rows):
            expected = np.array([row.get(name, missing) for row in rows], values.dtype)
            np.testing.assert_array_equal(values, expected, err_msg=name)
