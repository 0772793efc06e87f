"""What the measuring process and the view process say to each other over two pipes."""

from __future__ import annotations

import pickle
import struct
from dataclasses import dataclass
from typing import BinaryIO

from imumon.view.items import ViewItem, ViewSetup
from imumon.view.viewer import LOCALHOST, VIEWER_PORT, WEB_PORT, Mode

HEADER = struct.Struct("<Q")


@dataclass(frozen=True, slots=True)
class Start:
    """The first frame: what to show and where.

    Parameters
    ----------
    open_viewer : bool
        Whether a native viewer may be started; False after a restart, so that a viewer that the user closed
        stays closed.
    """

    setup: ViewSetup
    mode: Mode
    port: int = VIEWER_PORT
    web_port: int = WEB_PORT
    bind: str = LOCALHOST
    open_viewer: bool = True


@dataclass(frozen=True, slots=True)
class Batch:
    """Items, numbered by the batch that they came in."""

    number: int
    items: list[ViewItem]


@dataclass(frozen=True, slots=True)
class Replay:
    """The history that request `request` asked for follows."""

    request: int


@dataclass(frozen=True, slots=True)
class Close:
    """Flush and end."""


Frame = Start | Batch | Replay | Close


@dataclass(frozen=True, slots=True)
class Report:
    """What the view process says of itself.

    Parameters
    ----------
    text : str
        One phrase for the status line.
    connected : bool
        Whether the items reach a viewer, or a server that viewers can open.
    port, web_port : int
        Ports in use.
    url : str
        What to open in a browser, or where the stream is.
    """

    text: str
    connected: bool
    port: int
    web_port: int
    url: str


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Please send all batches after `after` again, announced by a `Replay` of this number."""

    request: int
    after: int


Message = Report | ReplayRequest


def encode(value: Frame | Message) -> bytes:
    """Return a frame as bytes: length, then pickle."""
    body = pickle.dumps(value, protocol=5)
    return HEADER.pack(len(body)) + body


def read(stream: BinaryIO) -> Frame | Message | None:
    """Return the next frame, or None at the end of the stream.

    Both ends are this program, so what is read can be trusted.
    """
    header = _exactly(stream, HEADER.size)
    if header is None:
        return None
    body = _exactly(stream, HEADER.unpack(header)[0])
    if body is None:
        return None
    value: Frame | Message = pickle.loads(body)
    return value


def _exactly(stream: BinaryIO, size: int) -> bytearray | None:
    """Read from an unbuffered pipe, which hands out less than is asked for."""
    data = bytearray()
    while len(data) < size:
        part = stream.read(min(size - len(data), 1 << 20))
        if not part:
            return None
        data += part
    return data
