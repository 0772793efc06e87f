"""Who may read the live view: a door before Rerun's server, which answers whoever reaches its port.

A page of another site that is open in the same browser can send requests to this computer.  Its own name is
then in ``Origin``, or in ``Host`` when that name was made to lead here (DNS rebinding), and is refused.
Rerun's server listens on an address of the loopback that is drawn at random, which only this door
and the page's server know, and both judge by `refusal`.
"""

from __future__ import annotations

import contextlib
import ipaddress
import re
import secrets
import socket
import sys
import threading
from http import HTTPStatus
from urllib.parse import urlsplit

from imumon.view.viewer import LOCALHOST, free_port

HOST = re.compile(r"([\w.-]+|\[[0-9a-fA-F:]+\])(?::\d+)?$")
LONGEST_HEAD = 1 << 14
HEAD_S = 10.0
CHUNK = 1 << 16
HTTP_2 = b"PRI * HTTP/2.0"
"""What native clients begin with, and no browser over a connection that is not encrypted."""


def refusal(host: str, origin: str = "") -> str:
    """Return why a request with these headers is not answered; empty when it is.

    A name can be made to lead anywhere by who owns it; an address, and this computer's name, cannot.
    """
    requested = HOST.match(host)
    name = requested.group(1).lower() if requested else ""
    if not _is_here(name):
        return f"Host {host!r} is neither an address nor the name of this computer: open it by its address"
    if origin and (urlsplit(origin).hostname or "") != name.strip("[]"):
        return f"Origin {origin!r} is another site"
    return ""


def _is_here(name: str) -> bool:
    own = socket.gethostname().lower()
    if name in ("localhost", own, f"{own}.local"):
        return True
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def hidden_address() -> tuple[str, int]:
    """Return a free port of an address of the loopback; only Linux has more than one."""
    if sys.platform != "linux":
        return LOCALHOST, free_port(20000 + secrets.randbelow(20000))
    drawn = [1 + secrets.randbelow(254) for _ in range(3)]
    address = "127." + ".".join(map(str, drawn))
    return address, free_port(20000 + secrets.randbelow(20000), address)


class Gate:
    """Listens on a port, and leads connections that may read on to the server behind it.

    Parameters
    ----------
    door : socket
        Listens where clients come to; see `imumon.view.viewer.listen`.
    behind : (str, int)
        Address and port of the server.
    """

    def __init__(self, door: socket.socket, behind: tuple[str, int]) -> None:
        self._behind = behind
        self._server = door
        threading.Thread(target=self._accept, name="view gate", daemon=True).start()

    def close(self) -> None:
        """Let nobody in any more."""
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                threading.Thread(target=self._lead, args=[client], name="view client", daemon=True).start()

    def _lead(self, client: socket.socket) -> None:
        """Look at the first request, then carry bytes both ways: a browser uses a connection for one host."""
        with client, contextlib.suppress(OSError):
            client.settimeout(HEAD_S)
            head = _head(client)
            reason = "" if head.startswith(HTTP_2) else refusal(_field(head, "host"), _field(head, "origin"))
            if reason:
                client.sendall(_answer(reason))
                return
            client.settimeout(None)
            with socket.create_connection(self._behind) as server:
                server.sendall(head)
                back = threading.Thread(target=_carry, args=[server, client], daemon=True)
                back.start()
                _carry(client, server)
                back.join()


def _head(client: socket.socket) -> bytes:
    """Return what comes, up to the end of the headers at least."""
    head = b""
    while b"\r\n\r\n" not in head and not head.startswith(HTTP_2) and len(head) < LONGEST_HEAD:
        data = client.recv(CHUNK)
        if not data:
            break
        head += data
    return head


def _field(head: bytes, name: str) -> str:
    """Return a header field; of one that comes twice, what no rule allows."""
    lines = head.partition(b"\r\n\r\n")[0].decode("latin-1").split("\r\n")[1:]
    fields = [line.partition(":") for line in lines]
    return ", ".join(value.strip() for key, _, value in fields if key.lower() == name)


def _answer(reason: str) -> bytes:
    body, status = f"{reason}\n".encode(), HTTPStatus.FORBIDDEN
    head = f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: text/plain; charset=utf-8\r\n"
    return head.encode() + f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n".encode() + body


def _carry(source: socket.socket, sink: socket.socket) -> None:
    """Carry bytes one way until either end closes; then both ways end."""
    try:
        while data := source.recv(CHUNK):
            sink.sendall(data)
    except OSError:
        pass
    for end in (source, sink):
        with contextlib.suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
