"""The web viewer on 127.0.0.1: Rerun's own page, kept from calling home, and reloaded after a restart."""

from __future__ import annotations

import re
import subprocess
import threading
import time
import urllib.request
import uuid
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.error import URLError

from imumon.errors import ImumonError, Reason
from imumon.view.viewer import LOCALHOST, free_port, proxy_url, quiet_environment, viewer_binary

ASSETS = {
    "/": "text/html; charset=utf-8",
    "/re_viewer.js": "text/javascript",
    "/re_viewer_bg.wasm": "application/wasm",
    "/favicon.ico": "image/x-icon",
}
"""What the page needs, by content type.  The rest of what Rerun would serve is for other uses of it."""

FETCH_S = 10.0
ALIVE = "/alive"

SCRIPT = """
<script>
(() => {{
  const query = new URLSearchParams(window.location.search);
  if (!query.has("url")) {{
    const stream = `rerun+http://${{window.location.hostname}}:{port}/proxy`;
    window.location.replace(`/?url=${{encodeURIComponent(stream)}}&hide_welcome_screen=1`);
  }}
  // A restarted server has another name; the page then starts anew and gets the picture back.
  setInterval(async () => {{
    try {{
      const answer = await fetch("{alive}", {{ cache: "no-store" }});
      if (answer.ok && (await answer.text()) !== "{name}") window.location.reload();
    }} catch (error) {{ /* the server is away; ask again */ }}
  }}, 2000);
}})();
</script>
"""


def bundled_assets() -> dict[str, bytes]:
    """Return the web viewer's files, which are inside the viewer's executable, by path.

    Raises
    ------
    ImumonError
        NOT_FOUND when the executable is missing or does not hand them out within 10 s.
    """
    port = free_port(WEB_FETCH_PORT)
    command = [str(viewer_binary()), proxy_url(1), "--serve-web", f"--bind={LOCALHOST}"]
    program = subprocess.Popen(
        [*command, f"--web-viewer-port={port}", "--port=auto"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=quiet_environment(),
    )
    try:
        deadline = time.monotonic() + FETCH_S
        while True:
            try:
                return {path: _fetch(f"http://{LOCALHOST}:{port}{path}") for path in ASSETS}
            except (URLError, ConnectionError, TimeoutError) as error:
                if time.monotonic() > deadline or program.poll() is not None:
                    raise ImumonError(
                        Reason.NOT_FOUND, f"no web viewer from {command[0]}: {error}", "use --view native"
                    ) from error
                time.sleep(0.05)
    finally:
        program.kill()
        program.wait()


WEB_FETCH_PORT = 19090


def _fetch(url: str) -> bytes:
    with urllib.request.urlopen(url, timeout=FETCH_S) as response:
        data: bytes = response.read()
        return data


def page(html: str, stream_port: int, name: str) -> str:
    """Return Rerun's page with our script in front and without what it would load from elsewhere."""
    local = re.sub(r"<link\b[^>]*https://[^>]*>", "", html)
    script = SCRIPT.format(port=stream_port, alive=ALIVE, name=name)
    return local.replace("<head>", "<head>" + script, 1)


def policy(host: str, stream_port: int) -> str:
    """Return the content security policy: this server and the stream, nothing else.

    The web viewer sends usage data whatever its settings, asks for updates and for fonts; a browser that is
    told so refuses all of it.
    """
    local = f"'self' http://{host}:{stream_port}"
    return (
        f"default-src 'self' data: blob:; connect-src {local} data: blob:; "
        "script-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob:; "
        "style-src 'self' 'unsafe-inline'; worker-src 'self' blob:"
    )


class WebServer:
    """Serves the page from memory, in threads of its own, until the process ends.

    Parameters
    ----------
    bind : str
        Address to listen on.
    port : int
        Port to listen on; must be free.
    stream_port : int
        Port of the stream that the page opens.
    """

    def __init__(self, bind: str, port: int, stream_port: int) -> None:
        self.port = port
        host = LOCALHOST if bind in ("0.0.0.0", "::", "") else bind
        self.url = f"http://{host}:{port}/"
        name = uuid.uuid4().hex
        files = bundled_assets()
        files["/"] = page(files["/"].decode(), stream_port, name).encode()

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            timeout = 30

            def do_GET(self) -> None:
                path = self.path.partition("?")[0]
                body = name.encode() if path == ALIVE else files.get(path)
                if body is None:
                    self.send_error(HTTPStatus.NOT_FOUND)
                    return
                asked = self.headers.get("Host", host).rpartition(":")[0] or host
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", ASSETS.get(path, "text/plain"))
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Content-Security-Policy", policy(asked, stream_port))
                if path == "/re_viewer_bg.wasm":
                    self.send_header("rerun-final-length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Stay silent; the terminal belongs to the status line."""

        self._server = ThreadingHTTPServer((bind, port), Handler)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, name="web viewer", daemon=True).start()
