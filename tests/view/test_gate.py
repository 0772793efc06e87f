from __future__ import annotations

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.view.gate import Gate, refusal
from imumon.view.viewer import listen
from tests.transport.helpers import tcp_server
from tests.waiting import LIMIT_S


@pytest.mark.parametrize(
    ("host", "origin", "answered"),
    [
        ("127.0.0.1:9876", "", True),
        ("127.0.0.1:9876", "http://127.0.0.1:9090", True),
        ("[::1]:9876", "http://[::1]:9090", True),
        ("10.0.0.5:9876", "http://10.0.0.5:9090", True),
        ("BENCH-PC:9876", "http://bench-pc:9090", True),
        ("bench-pc.local", "", True),
        ("127.0.0.1:9876", "http://evil.example", False),
        ("127.0.0.1:9876", "null", False),
        ("evil.example:9876", "http://evil.example:9876", False),
        ("127.0.0.1.evil.example", "", False),
        ("127.0.0.1, evil.example", "", False),
        ("", "", False),
    ],
)
def test_addresses_and_this_computer_are_answered(
    host: str, origin: str, answered: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "bench-pc")
    assert (refusal(host, origin) == "") == answered


@given(st.text(), st.text())
def test_any_header_is_judged(host: str, origin: str) -> None:
    refusal(host, origin)


def asked(port: int, head: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S) as client:
        client.sendall(head)
        return client.recv(1000)


def test_what_is_allowed_reaches_the_server_and_nothing_else_does() -> None:
    reached: list[bytes] = []

    def serve(client: socket.socket) -> None:
        reached.append(client.recv(1000))
        client.sendall(b"data")

    door = listen(28000)
    port = door.getsockname()[1]
    with tcp_server(serve) as behind:
        gate = Gate(door, ("127.0.0.1", behind))
        good = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nmore"
        assert asked(port, good) == b"data"
        assert asked(port, b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n") == b"data"
        for bad in (b"Host: evil.example", b"Host: 127.0.0.1\r\nHost: evil.example", b"X: y"):
            assert asked(port, b"GET / HTTP/1.1\r\n" + bad + b"\r\n\r\n").startswith(b"HTTP/1.1 403 ")
        gate.close()
    assert reached == [good, b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"]
