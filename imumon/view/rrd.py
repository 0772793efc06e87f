"""The messages of which a file of Rerun consists, as far as arrangements are told from the rest."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

LIVE_APPLICATION, APPLICATION = "imumon-live", "imumon"
"""Of live views, whose arrangement viewers keep until the next time; of recordings, which bring one."""
RECORDING, BLUEPRINT = 1, 2
"""Kinds of stores."""
HEAD_BYTES, FRAME = 12, struct.Struct("<QQ")
"""Bytes before the first message; kind and size before each."""
END, PART, ACTIVATION = 0, 2, 3
"""Kinds of messages: the end with its index, a part of a store, that an arrangement is to be shown."""
NAMED_WITHIN = 256
"""Bytes of a message that say which store it is for."""


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


def copy_latest(source: Path, copy: Path) -> None:
    """Copy a recording without the arrangements that a later one has replaced, and without its index."""
    with source.open("rb") as written, copy.open("wb") as out:
        shown = [_arrangement(message) for kind, message in messages(written) if kind == ACTIVATION]
        old = set(shown) - set(shown[-1:])
        written.seek(0)
        out.write(written.read(HEAD_BYTES))
        for _, message in messages(written):
            if not any(one in message[:NAMED_WITHIN] for one in old):
                out.write(message)
        out.write(FRAME.pack(END, 0))


def _arrangement(activation: bytes) -> bytes:
    """Return kind and name of the store that is to be shown."""
    begin = activation.index(bytes([0x08, BLUEPRINT, 0x12]))
    return activation[begin : begin + 4 + activation[begin + 3]]


def _text(text: str) -> bytes:
    return bytes([len(text)]) + text.encode()
