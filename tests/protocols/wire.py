"""Xbus and MIP packets made by hand from the vendors' documents, apart from the encoders of the package."""

from __future__ import annotations

import struct
from collections.abc import Sequence

PVT_BYTES = 94


def xbus(*items: tuple[int, bytes]) -> bytes:
    """Return an MTData2 message of these data items."""
    payload = b"".join(struct.pack(">HB", code, len(data)) + data for code, data in items)
    size = bytes([len(payload)]) if len(payload) < 255 else b"\xff" + struct.pack(">H", len(payload))
    body = b"\xff\x36" + size + payload
    return b"\xfa" + body + bytes([-sum(body) & 0xFF])


def mtdata2_inertial(counter: int | None, ticks: int, value: float) -> bytes:
    """Return a message with time, acceleration and rate of turn."""
    head = [] if counter is None else [(0x1020, struct.pack(">H", counter % 65536))]
    vector = struct.pack(">3f", value, 0.0, 9.81)
    return xbus(*head, (0x1060, struct.pack(">I", ticks % 2**32)), (0x4020, vector), (0x8020, vector))


def mtdata2_gnss(counter: int | None, ticks: int, time_of_week_ms: int) -> bytes:
    """Return a message with GnssPvtData, dated as the vendor's devices do: by its own, older time."""
    head = [] if counter is None else [(0x1020, struct.pack(">H", counter % 65536))]
    pvt = struct.pack(">I", time_of_week_ms) + bytes(PVT_BYTES - 4)
    return xbus((0x7010, pvt), (0x1060, struct.pack(">I", ticks % 2**32)), *head)


def mip(descriptor_set: int, *fields: tuple[int, bytes]) -> bytes:
    """Return a MIP packet of these fields."""
    payload = b"".join(bytes([len(data) + 2, code]) + data for code, data in fields)
    body = bytes([0x75, 0x65, descriptor_set, len(payload)]) + payload
    first = second = 0
    for byte in body:
        first = (first + byte) & 0xFF
        second = (second + first) & 0xFF
    return body + bytes([first, second])


def mip_time(time_ns: int) -> tuple[int, bytes]:
    """Return the reference-time field."""
    return 0xD5, struct.pack(">Q", time_ns)


def mip_vector(code: int, values: Sequence[float]) -> tuple[int, bytes]:
    """Return a field of floats."""
    return code, struct.pack(f">{len(values)}f", *values)
