"""The view process: takes items from the measuring process and serves the stream that viewers read.

It may hang, be killed or die without the measuring process noticing more than a word in the status line.
Viewers come and go as they like: the server keeps the latest `SERVER_MEMORY` of the stream for them.
Run as ``python -m imumon.view.child`` by `imumon.view.publisher`.
"""

import gc
import subprocess
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import rerun as rr

from imumon.view.fed import batches, serve
from imumon.view.items import ViewSetup
from imumon.view.logger import StreamLogger
from imumon.view.publisher import Report, Start
from imumon.view.viewer import LIVE_APPLICATION, probe, proxy_url, start_viewer, viewer_port
from imumon.view.web import WebServer, serve_stream

POLL_S = 0.25
LINGER_S = 3.0
"""So long a native viewer may read what came last, unless the measuring process ends this one sooner."""
REPEAT_S = 2.0
"""How often it is looked whether the viewer is open, and states and the log are logged again: viewers take
the newest first, and the server forgets the oldest.  Until a repetition arrives their panes are empty."""


class Viewers:
    """Serves the stream, and finds out how that goes."""

    def __init__(self, start: Start, rec: rr.RecordingStream) -> None:
        self._viewer: subprocess.Popen[bytes] | None = None
        if start.mode == "web":
            page = WebServer(serve_stream(rec), start.port, start.bind)
            self._serving = Report("serving the web viewer", page.url, page.port)
            return
        address, port = serve_stream(rec)
        url = proxy_url(port, address)
        self._port = viewer_port(start.port)
        text = f"`rerun {url}` opens a viewer"
        # One that is open goes on with this stream, as after a restart; one that was closed stays closed.
        if start.open_viewer or probe(self._port):
            self._viewer, text = start_viewer(self._port, url), "viewer open"
        self._serving = Report(text, url, self._port)

    def poll(self) -> Report:
        """Return whether the native viewer is still there, and where to find what."""
        serving, code = self._serving, None if self._viewer is None else self._viewer.poll()
        if code:
            text = f"the viewer could not start or go on (exit code {code}); try --view web"
            return serving._replace(text=text)
        if code == 0 and not probe(self._port):  # nor did it pass the stream on
            return serving._replace(text=f"viewer closed; `rerun {serving.url}` brings it back")
        return serving


def run(
    stream: Connection, out: Connection, make_logger: Callable[[rr.RecordingStream, ViewSetup], Any]
) -> None:
    """Take lists of items until the stream ends; what is made logs them as a `StreamLogger` does."""
    start: Start = stream.recv()
    rec = rr.RecordingStream(LIVE_APPLICATION, recording_id=start.setup.recording_id)
    viewers = Viewers(start, rec)
    logger = make_logger(rec, start.setup)
    logger.begin()
    logger.log(start.lasting)
    gc.freeze()  # or the circles of pictures wait until they are a quarter of all that was loaded
    repeated_s = time.monotonic()
    out.send(viewers.poll())
    for items in batches(stream, POLL_S):
        if time.monotonic() - repeated_s > REPEAT_S:
            repeated_s = time.monotonic()
            out.send(viewers.poll())
            logger.repeat()
        if items:
            logger.log(items)
    logger.finish()
    rec.flush()
    if start.mode == "native":
        time.sleep(LINGER_S)


if __name__ == "__main__":
    logged = partial(StreamLogger, live=True)
    serve(lambda stream, out: run(stream, out, logged), lambda error: Report(error.seen))
