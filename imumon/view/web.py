"""The web viewer on 127.0.0.1: a page with Rerun's own in a frame, kept from calling home, and the newest."""

from __future__ import annotations

import http.client
import json
import re
import socket
import sys
import threading
import time
import urllib.request
import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from functools import partial
from html import escape
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.error import URLError

from imumon.errors import ImumonError, Reason
from imumon.view.gate import hidden_address, refusal
from imumon.view.viewer import proxy_url, start_quietly, viewer_binary

ASSETS = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
"""What the viewer needs, by content type.  The rest of what Rerun would serve is for other uses of it."""
VIEWER = "/viewer"
"""Where Rerun's own page is; at ``/`` is ours, which shows it in a frame."""

FETCH_S = 10.0
ALIVE = "/alive"
STREAM_PATH = "/rerun."
"""How the paths of the stream begin; they are passed on, so that one port is enough."""
PART_BYTES = 1 << 16
OURS = {"connection", "keep-alive", "transfer-encoding", "content-length", "host", "origin", "server", "date"}
"""Headers that each of two connections has of its own; ``Host`` and ``Origin`` were judged here."""

PAGE = """<!doctype html>
<html>
<head>
<meta charset="utf-8">
<title>{title}</title>
<link rel="icon" href="favicon.ico">
<style>
  html, body {{ height: 100%; margin: 0; overflow: hidden; background: #0d1011; }}
  body {{ display: flex; flex-direction: column; }}
  iframe {{ flex: 1; border: 0; }}
  #newest {{
    max-height: {height}px; overflow: hidden; padding-left: 8px; color: #cad8de;
    font: 13px/18px monospace; white-space: pre-wrap;
  }}
</style>
</head>
<body>
<iframe id="picture" allow="clipboard-read; clipboard-write; fullscreen"></iframe>
<div id="newest"></div>
<script>
  // By another name of this computer the frame is another site, which has a process of its own: a browser
  // that draws by software has a turn or two in a second, and in a busy one none for half a minute.
  const names = {{"127.0.0.1": "localhost", "localhost": "127.0.0.1"}};
  const host = (names[location.hostname] || location.hostname) + ":" + (location.port || "80");
  const stream = encodeURIComponent("rerun+http://" + host + "/proxy");
  const picture = document.getElementById("picture");
  picture.src = "http://" + host + "{viewer}?url=" + stream + "&hide_welcome_screen=1";
  const say = (lines) => {{ document.getElementById("newest").textContent = lines.join("\\n"); }};
  const source = new EventSource("{alive}");
  source.onmessage = (message) => {{
    const told = JSON.parse(message.data);
    // A restarted server has another name; the page then starts anew and gets the picture back.
    if (told.name !== "{name}") window.location.reload();
    say(told.newest);
  }};
  source.onerror = () => {{ /* the browser asks again by itself */
    say(["no answer from imumon: it has ended, or cannot be reached"]);
  }};
</script>
</body>
</html>
"""
NEWEST_HEIGHT = 72
"""Pixels: four lines, two of which the states may take."""
PUSH_S = 5.0
"""So often the page is told what is newest when nothing has changed, so that who went away is noticed."""


def bundled_assets() -> dict[str, bytes]:
    """Return the web viewer's files, which are inside the viewer's executable, by path.

    Raises NOT_FOUND when the executable is missing or does not hand them out within 10 s.
    """
    address, port = hidden_address()
    command = [str(viewer_binary()), proxy_url(1), "--serve-web", f"--bind={address}"]
    program = start_quietly([*command, f"--web-viewer-port={port}", "--port=auto"], own_session=False)
    try:
        deadline = time.monotonic() + FETCH_S
        while True:
            try:
                return {path: _fetch(f"http://{address}:{port}{path}") for path in ASSETS}
            except (URLError, ConnectionError, TimeoutError) as error:
                if time.monotonic() > deadline or program.poll() is not None:
                    raise ImumonError(
                        Reason.NOT_FOUND, f"no web viewer from {command[0]}: {error}", "use --view native"
                    ) from error
                time.sleep(0.05)
    finally:
        program.kill()
        program.wait()


def _fetch(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=FETCH_S) as response:
        data: bytes = response.read()
        return data


def page(name: str, title: str) -> str:
    """Return our page, for the server of this name."""
    return PAGE.format(title=escape(title), name=name, viewer=VIEWER, alive=ALIVE, height=NEWEST_HEIGHT)


def without_elsewhere(html: str) -> str:
    """Return Rerun's page without what it would load from elsewhere."""
    return re.sub(r"<link\b[^>]*https://[^>]*>", "", html)


POLICY = (
    "default-src 'self' data: blob:; connect-src 'self' data: blob:; "
    "script-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob:; "
    "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:; "
    "frame-src 'self' http://127.0.0.1:* http://localhost:*"
)
"""The content security policy: this server, nothing else.  The web viewer sends usage data whatever its
settings, asks for updates and for fonts; a browser that is told so refuses all of it."""


class WebServer:
    """Serves the page from memory, in threads of its own, and passes the stream on.

    All comes from one address and port, so that it works as well through a tunnel (``ssh -L``).

    Parameters
    ----------
    door : socket
        Listens where browsers come to; see `imumon.view.viewer.listen`.
    stream : (str, int)
        Address and port of the server that the stream comes from; whoever reaches that one is answered.
    title : str
        Of the page.
    """

    def __init__(self, door: socket.socket, stream: tuple[str, int], title: str = "imumon") -> None:
        bind, self.port = door.getsockname()
        self.stream = stream
        self.host = socket.gethostname() if bind == "0.0.0.0" else bind  # as others reach it
        self.url = f"http://{self.host}:{self.port}/"
        self._name = uuid.uuid4().hex
        self.files = bundled_assets()
        self.files[VIEWER] = without_elsewhere(self.files["/"].decode()).encode()
        self.files["/"] = page(self._name, title).encode()
        self._newest = b""
        self._change, self._closed = threading.Condition(), False
        self.tell([])
        handler = partial(_Handler, self)
        self._server = _Server(door, handler)
        threading.Thread(target=self._server.serve_forever, name="web viewer", daemon=True).start()

    def tell(self, newest: Sequence[str]) -> None:
        """Let every page show these lines below the picture, at once."""
        told = json.dumps({"name": self._name, "newest": newest}).encode()
        if told != self._newest:
            with self._change:
                self._newest = told
                self._change.notify_all()

    def told(self) -> Iterator[bytes]:
        """Yield what pages are told, now and as it changes, until the server is closed."""
        seen = b""
        while True:
            with self._change:
                self._change.wait_for(partial(self._differs, seen), PUSH_S)
                if self._closed:
                    return
                seen = self._newest
            yield seen

    def _differs(self, seen: bytes) -> bool:
        return self._closed or self._newest is not seen

    def close(self) -> None:
        """Stop serving."""
        with self._change:
            self._closed = True
            self._change.notify_all()
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, door: socket.socket, handler: Callable[..., BaseHTTPRequestHandler]) -> None:
        super().__init__(door.getsockname(), handler, bind_and_activate=False)
        self.socket.close()
        self.socket = door

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a browser that went away in the middle of an answer."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = 30

    def __init__(self, site: WebServer, *arguments: Any) -> None:
        self._site = site
        super().__init__(*arguments)

    def do_GET(self) -> None:
        """Answer with a file, or tell what is newest."""
        site = self._site
        if self._refuses():
            return
        path = self.path.partition("?")[0]
        if path == ALIVE:
            self._push()
            return
        body = site.files.get(path)
        if body is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", ASSETS.get(path, ASSETS["/"]))
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("rerun-final-length", str(len(body)))  # the page's progress bar asks for it
        self.end_headers()
        self.wfile.write(body)

    def _push(self) -> None:
        """Tell the page what is newest for as long as it listens."""
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", "text/event-stream")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Connection", "close")
        self.end_headers()
        for newest in self._site.told():
            self.wfile.write(b"data: %b\n\n" % newest)

    def do_POST(self) -> None:
        """Pass a request for the stream on, and what comes back as it comes."""
        if self._refuses():
            return
        if not self.path.startswith(STREAM_PATH):
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        with closing(http.client.HTTPConnection(*self._site.stream)) as stream:
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
            while part := answer.read1(PART_BYTES):
                self.wfile.write(b"%x\r\n%b\r\n" % (len(part), part))
            self.wfile.write(b"0\r\n\r\n")

    def _refuses(self) -> bool:
        """Tell a page of another site that it may not read; return whether this is one."""
        said = refusal(self.headers.get("Host", ""), self.headers.get("Origin", ""))
        if said:
            self.send_error(HTTPStatus.FORBIDDEN, explain=said)
        return bool(said)

    def log_message(self, *_: object) -> None:
        """Stay silent; the terminal belongs to the status line."""


def _passed_on(headers: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    return ((name, value) for name, value in headers if name.lower() not in OURS)
