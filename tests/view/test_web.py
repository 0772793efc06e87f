from __future__ import annotations

import http.client
import re
import socket
import urllib.request
from collections.abc import Iterator
from urllib.parse import parse_qs, urlsplit

import pytest

from imumon.view.viewer import free_port
from imumon.view.web import WebServer, page, policy

HTML = """<html><head><link rel="preconnect" href="https://fonts.example" />
<link
  href="https://fonts.example/css2" rel="stylesheet" />
<link rel="icon" href="favicon.ico" /></head><body></body></html>"""


@pytest.fixture(scope="module")
def server() -> Iterator[WebServer]:
    site = WebServer("127.0.0.1", free_port(29090), 29876)
    yield site
    site.close()


def test_bare_address_leads_to_the_stream_on_the_host_that_was_asked(
    server: WebServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: "bench-pc")
    for asked in ("127.0.0.1", "bench-pc.local"):
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        connection.request("GET", "/", headers={"Host": f"{asked}:{server.port}"})
        response = connection.getresponse()
        location = response.getheader("Location") or ""
        connection.close()
        assert response.status == 302
        assert parse_qs(urlsplit(location).query)["url"] == [f"rerun+http://{asked}:29876/proxy"]


def test_page_and_program_are_served_and_may_speak_to_this_machine_only(server: WebServer) -> None:
    with urllib.request.urlopen(server.url) as response:
        html = response.read().decode()
        allowed = response.headers["Content-Security-Policy"]
    assert "re_viewer.js" in html
    assert '<link rel="preconnect" href="https://' not in html
    assert set(re.findall(r"https?://[^\s;]+", allowed)) == {"http://127.0.0.1:29876"}
    with urllib.request.urlopen(f"{server.url}re_viewer_bg.wasm") as response:
        assert response.read(4) == b"\0asm"
        assert response.headers["Content-Type"] == "application/wasm"


def test_another_site_gets_no_page(server: WebServer) -> None:
    for headers in ({"Host": f"evil.example:{server.port}"}, {"Origin": "https://evil.example"}):
        connection = http.client.HTTPConnection("127.0.0.1", server.port)
        connection.request("GET", "/alive", headers=headers)
        with connection.getresponse() as response:
            assert response.status == 403
        connection.close()


def test_other_paths_do_not_exist(server: WebServer) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port)
    connection.request("GET", "/../pyproject.toml")
    assert connection.getresponse().status == 404
    connection.close()


def test_name_tells_a_restarted_server(server: WebServer) -> None:
    with urllib.request.urlopen(f"{server.url}alive") as response:
        name = response.read().decode()
    with urllib.request.urlopen(server.url) as response:
        assert name in response.read().decode()


def test_page_loads_nothing_from_elsewhere() -> None:
    text = page(HTML, "name")
    assert "https://" not in text
    assert "favicon.ico" in text
    assert text.index("<script>") < text.index("favicon.ico")


def test_policy_names_this_host_and_the_stream() -> None:
    assert "connect-src 'self' http://10.0.0.5:9876 " in policy("10.0.0.5", 9876)
