from __future__ import annotations

import http.client
import re
import socket
import threading
import urllib.request
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.view.web import WebServer, refusal


@pytest.fixture(scope="module")
def server() -> Iterator[WebServer]:
    site = WebServer(("127.0.0.1", 29876), 29090)
    yield site
    site.shutdown()
    site.server_close()


def test_page_and_program_are_served_and_may_speak_to_this_machine_only(server: WebServer) -> None:
    with urllib.request.urlopen(server.url) as response:
        html = response.read().decode()
        allowed = response.headers["Content-Security-Policy"]
    assert response.headers["Content-Type"] == "text/html; charset=utf-8"
    assert response.url.endswith(f"%3A{server.port}%2Fproxy&hide_welcome_screen=1")
    assert not re.findall(r"https?://", allowed)
    assert "re_viewer.js" in html
    assert not re.search(r"<link\b[^>]*https://", html)
    with urllib.request.urlopen(f"{server.url}re_viewer_bg.wasm") as response:
        assert response.read(4) == b"\0asm"
        assert response.headers["Content-Type"] == "application/wasm"


def test_another_site_gets_no_page(server: WebServer) -> None:
    for headers in ({"Host": f"evil.example:{server.port}"}, {"Origin": "https://evil.example"}):
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        connection.request("GET", "/", headers=headers)
        with connection.getresponse() as response:
            assert response.status == 403
        connection.close()


def test_other_paths_do_not_exist(server: WebServer) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    connection.request("GET", "/../pyproject.toml")
    assert connection.getresponse().status == 404
    connection.close()


def test_a_page_for_all_addresses_names_this_computer() -> None:
    site = WebServer(("127.0.0.1", 29876), 29190, "0.0.0.0")
    site.shutdown()
    site.server_close()
    assert site.url == f"http://{socket.gethostname()}:{site.port}/"


def test_the_stream_comes_through_the_same_port(server: WebServer) -> None:
    with socket.create_server(server.stream) as stream:
        heard: list[bytes] = []

        def answer() -> None:
            connection, _ = stream.accept()
            with connection:
                heard.append(connection.recv(4096))
                head = b"HTTP/1.1 200 OK\r\ngrpc-status: 0\r\nTransfer-Encoding: chunked\r\n\r\n"
                connection.sendall(head + b"3\r\nabc\r\n2\r\nde\r\n0\r\n\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        connection.request("POST", "/rerun.x/Read", b"body", {"Content-Type": "application/grpc-web+proto"})
        response = connection.getresponse()
        assert (response.status, response.getheader("grpc-status"), response.read()) == (200, "0", b"abcde")
        connection.close()
        thread.join()
    assert heard[0].startswith(b"POST /rerun.x/Read ")
    assert b"application/grpc-web+proto" in heard[0]


def test_nothing_else_is_passed_on_and_a_stream_that_is_away_is_reported(server: WebServer) -> None:
    for path, status in (("/other", 404), ("/rerun.x/Read", 502)):
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        connection.request("POST", path, b"body")
        assert connection.getresponse().status == status
        connection.close()


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
def test_any_header_is_evaluated(host: str, origin: str) -> None:
    refusal(host, origin)
