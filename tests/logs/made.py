"""Logs as the autopilots write them, made by their published layouts."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

DATAFLASH = {
    "IMU": (129, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "MAG": (130, "QBhhh", "TimeUS,I,MagX,MagY,MagZ"),
    "BARO": (131, "QBff", "TimeUS,I,Alt,Press"),
}
"""Messages of a log of 4.1 and later: number, types and names of the fields."""


def dataflash(
    path: Path,
    rows: Sequence[tuple[str, Sequence[Any]]],
    kinds: Mapping[str, tuple[int, str, str]] = DATAFLASH,
) -> None:
    """Write a DataFlash log."""
    out = bytearray()
    formats = {}
    for name, (number, layout, columns) in {"FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns")}.items():
        out += _format(number, 89, name, layout, columns)
    for name, (number, layout, columns) in kinds.items():
        formats[name] = number, struct.Struct("<" + layout)
        out += _format(number, 3 + formats[name][1].size, name, layout, columns)
    for name, values in rows:
        number, packed = formats[name]
        out += b"\xa3\x95" + bytes([number]) + packed.pack(*values)
    path.write_bytes(out)


def _format(number: int, length: int, name: str, layout: str, columns: str) -> bytes:
    text = struct.pack("<BB4s16s64s", number, length, name.encode(), layout.encode(), columns.encode())
    return b"\xa3\x95\x80" + text


def ulog(path: Path, topics: Mapping[str, tuple[str, list[tuple[Any, ...]]]]) -> None:
    """Write a ULog; topics by name and number, each with its fields and rows."""
    out = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
    out += _message("B", bytes(40))
    names = {topic.partition(".")[0]: fields for topic, (fields, _) in topics.items()}
    for name, fields in names.items():
        out += _message("F", f"{name}:{fields}".encode())
    for number, topic in enumerate(topics):
        name, _, instance = topic.partition(".")
        out += _message("A", struct.pack("<BH", int(instance), number) + name.encode())
    for number, (fields, rows) in enumerate(topics.values()):
        codes = {"uint64_t": "Q", "uint32_t": "I", "float": "f"}
        packed = struct.Struct(
            "<" + "".join(codes[field.split()[0]] for field in fields.strip(";").split(";"))
        )
        for row in rows:
            out += _message("D", struct.pack("<H", number) + packed.pack(*row))
    path.write_bytes(out)


def _message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content
