"""The web viewer on 127.0.0.1: Rerun's own page, kept from calling home, and the stream to it."""

import http.client
import ipaddress
import re
import socket
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import closing
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingTCPServer
from typing import Any
from urllib.error import URLError
from urllib.parse import quote, urlsplit
from urllib.request import urlopen

import rerun as rr

from imumon.errors import ImumonError, Reason

from . import viewer

ASSETS = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
"""What the viewer needs, by content type.  The rest of what Rerun would serve is for other uses of it."""
FETCH_S = 10.0
STREAM_PATH = "/rerun."
"""How the paths of the stream begin; they are passed on, so that one port is enough."""
OURS = {"connection", "keep-alive", "transfer-encoding", "content-length", "host", "origin", "server", "date"}
"""Headers that each of two connections has of its own; ``Host`` and ``Origin`` were checked here."""


def refusal(host: str, origin: str = "") -> str:
    """Return why a request with these headers is not answered; empty when it is.

    A page of another site that is open in the same browser can send requests to this computer.  Its own name
    is then in ``Origin``, or in ``Host`` when that name was made to lead here (DNS rebinding).  A name can be
    made to lead anywhere by who owns it; an address, and this computer's name, cannot.
    """
    own = socket.gethostname().lower()
    try:
        name = urlsplit(f"//{host}").hostname or ""
        if name not in ("localhost", own, f"{own}.local"):
            ipaddress.ip_address(name)
        return f"Origin {origin!r} is another site" if origin and urlsplit(origin).hostname != name else ""
    except ValueError:
        return f"Host {host!r} is neither an address nor the name of this computer: open it by its address"


def bundled_assets() -> dict[str, bytes]:
    """Return the web viewer's files, which are inside the viewer's executable, by path.

    Raises NOT_FOUND when the executable is missing or does not hand them out within 10 s.
    """
    address, port = viewer.hidden_address()
    command = [str(viewer.viewer_binary()), viewer.proxy_url(1), "--serve-web", f"--bind={address}"]
    program = viewer.start_quietly([*command, f"--web-viewer-port={port}", "--port=auto"], own_session=False)
    try:
        deadline = time.monotonic() + FETCH_S
        while True:
            try:
                site = f"http://{address}:{port}"
                return {path: urlopen(site + path, timeout=FETCH_S).read() for path in ASSETS}
            except (URLError, ConnectionError, TimeoutError) as error:
                if time.monotonic() > deadline or program.poll() is not None:
                    raise ImumonError(
                        Reason.NOT_FOUND, f"no web viewer from {command[0]}: {error}", "use --view native"
                    ) from error
                time.sleep(0.05)
    finally:
        program.kill()
        program.wait()


def serve_stream(rec: rr.RecordingStream, memory: str) -> tuple[str, int]:
    """Let viewers read the latest `memory` of a stream, and return where."""
    address = viewer.hidden_address()
    rec.set_sinks(rr.GrpcServerSink(*address, server_memory_limit=memory, newest_first=True))
    return address


POLICY = (
    "default-src 'self' data: blob:; connect-src 'self' data: blob:; "
    "script-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:"
)
"""The content security policy: this server, nothing else.  The web viewer sends usage data whatever its
settings, requests updates and fonts; a browser that is given this policy refuses them."""


class WebServer(ThreadingTCPServer):
    """Serves the page from memory, in threads of its own, and passes the stream on.

    All comes from one address and port, so that it works as well through a tunnel (``ssh -L``): this port or
    the next one free.

    `stream` is address and port of the server that the stream comes from, which answers whoever reaches it.
    """

    allow_reuse_address = daemon_threads = True

    def __init__(
        self, stream: tuple[str, int], port: int = viewer.WEB_PORT, bind: str = viewer.LOCALHOST
    ) -> None:
        self.stream, self.files = stream, bundled_assets()
        # The policy does not keep a browser from connecting to the sites that the page names.
        self.files["/"] = re.sub(rb"<link\b[^>]*https://[^>]*>", b"", self.files["/"])
        self.port = viewer.free_port(port, bind)
        super().__init__((bind, self.port), _Handler)
        host = socket.gethostname() if bind == "0.0.0.0" else bind  # as others reach it
        self.url = f"http://{host}:{self.port}/"
        threading.Thread(target=self.serve_forever, name="web viewer", daemon=True).start()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that went away in the middle of an answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = 30
    server: WebServer

    def parse_request(self) -> bool:
        """Refuse the request of a page of another site; return whether there is something to answer."""
        if not super().parse_request():
            return False
        reason = refusal(self.headers.get("Host", ""), self.headers.get("Origin", ""))
        if reason:
            self.send_error(HTTPStatus.FORBIDDEN, explain=reason)
        return not reason

    def do_GET(self) -> None:
        """Answer with a file; a request for the page without a stream is sent to the one with ours."""
        path, _, query = self.path.partition("?")
        if path == "/" and not query:
            stream = quote(f"rerun+http://{self.headers['Host']}/proxy", safe="")
            self._answer(HTTPStatus.FOUND, b"", {"Location": f"/?url={stream}&hide_welcome_screen=1"})
        elif (body := self.server.files.get(path)) is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            headers = {
                "Content-Type": ASSETS[path],
                "Content-Security-Policy": POLICY,
                "rerun-final-length": str(len(body)),  # the page's progress bar needs it
            }
            self._answer(HTTPStatus.OK, body, headers)

    def _answer(self, status: HTTPStatus, body: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def do_POST(self) -> None:
        """Pass a request for the stream on, and what comes back as it comes."""
        if not self.path.startswith(STREAM_PATH):
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        with closing(http.client.HTTPConnection(*self.server.stream)) as stream:
            try:
                stream.request("POST", self.path, body, dict(_passed_on(self.headers.items())))
                answer = stream.getresponse()
            except (OSError, http.client.HTTPException):
                self.send_error(HTTPStatus.BAD_GATEWAY)
                return
            self.send_response(answer.status)
            for name, value in _passed_on(answer.getheaders()):
                self.send_header(name, value)
            self.send_header("Transfer-Encoding", "chunked")
            self.end_headers()
            while part := answer.read1(1 << 16):
                self.wfile.write(b"%x\r\n%b\r\n" % (len(part), part))
            self.wfile.write(b"0\r\n\r\n")

    def log_message(self, *_: object) -> None:
        """Stay silent; the terminal belongs to the status line."""


def _passed_on(headers: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    return ((name, value) for name, value in headers if name.lower() not in OURS)
