"""The messages of which a file of Rerun consists, as far as arrangements are told from the rest."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import BinaryIO

LIVE_APPLICATION, APPLICATION = "imumon-live", "imumon"
"""Of live views, whose arrangement viewers keep until the next time; of recordings, which bring one."""
RECORDING, BLUEPRINT = 1, 2
"""Kinds of stores."""
HEAD_BYTES, FRAME = 12, struct.Struct("<QQ")
"""Bytes before the first message; kind and size before each."""
END, PART = 0, 2
"""Kinds of messages: the end with its index, a part of a store."""


def messages(written: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield kind and bytes of each message, with its frame, up to the end or where it was cut."""
    written.seek(HEAD_BYTES)
    while len(frame := written.read(FRAME.size)) == FRAME.size:
        kind, size = FRAME.unpack(frame)
        if kind == END or len(body := written.read(size)) < size:
            return
        yield kind, frame + body


def store_id(kind: int, name: str, application: str) -> bytes:
    """Return how Rerun writes of which store a message is."""
    return bytes([0x08, kind, 0x12, *_text(name), 0x1A, len(application) + 2, 0x0A, *_text(application)])


def _text(text: str) -> bytes:
    return bytes([len(text)]) + text.encode()
