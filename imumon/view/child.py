"""The view process: takes items from the measuring process and serves the stream that viewers read.

It may hang, be killed or die without the measuring process noticing more than a word in the status line.
Viewers come and go as they like: the server keeps the latest part of the stream for them.
Run as ``python -m imumon.view.child`` by `imumon.view.publisher`.
"""

import gc
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import rerun as rr

from .fed import batches, serve
from .items import ViewSetup
from .logger import StreamLogger
from .publisher import Report, Start
from .viewer import LIVE_APPLICATION, PAGE_MEMORY, SERVER_MEMORY, probe, proxy_url, start_viewer, viewer_port
from .web import WebServer, serve_stream

POLL_S = 0.25
LINGER_S = 3.0
"""So long a native viewer may read what came last, unless the measuring process ends this one sooner."""
REPEAT_S = 2.0
"""How often it is looked whether the viewer is open, and states and the log are logged again: viewers take
the newest first, and the server forgets the oldest.  Until a repetition arrives their panes are empty."""


def serve_viewers(start: Start, rec: rr.RecordingStream) -> Callable[[], Report]:
    """Serve the stream; return what finds out how that goes, and where to find what."""
    if start.mode == "web":
        page = WebServer(serve_stream(rec, PAGE_MEMORY), start.port, start.bind)
        return lambda: Report("serving the web viewer", page.url, page.port)
    address, served = serve_stream(rec, SERVER_MEMORY)
    url, port = proxy_url(served, address), viewer_port(start.port)
    # One that is open goes on with this stream, as after a restart; one that was closed stays closed.
    viewer = start_viewer(port, url) if start.open_viewer or probe(port) else None

    def poll() -> Report:
        code = None if viewer is None else viewer.poll()
        text = "viewer open" if viewer is not None else f"`rerun {url}` opens a viewer"
        if code:
            text = f"the viewer could not start or go on (exit code {code}); try --view web"
        elif code == 0 and not probe(port):  # nor did it pass the stream on
            text = f"viewer closed; `rerun {url}` brings it back"
        return Report(text, url, port)

    return poll


def run(
    stream: Connection, out: Connection, make_logger: Callable[[rr.RecordingStream, ViewSetup], Any]
) -> None:
    """Take lists of items until the stream ends; what is made logs them as a `StreamLogger` does."""
    start: Start = stream.recv()
    rec = rr.RecordingStream(LIVE_APPLICATION, recording_id=start.setup.recording_id)
    poll = serve_viewers(start, rec)
    logger = make_logger(rec, start.setup)
    logger.begin()
    logger.log(start.lasting)
    gc.freeze()  # or the circles of pictures wait until they are a quarter of all that was loaded
    repeated_s = time.monotonic()
    out.send(poll())
    for items in batches(stream, POLL_S):
        if time.monotonic() - repeated_s > REPEAT_S:
            repeated_s = time.monotonic()
            out.send(poll())
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
