"""view.rrd: the view as a recording, in segments that open as one."""

import ctypes
import math
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import rerun as rr

from imumon.heap import trim_heap

from . import RECORDER
from .items import DropOldestQueue, ViewItem, ViewSetup, merge
from .logger import StreamLogger
from .viewer import APPLICATION

BATCH_S = 30.0
"""Items of this long become one chunk per panel.  A chunk costs about 1.4 kB beside its rows: with 80 panels
30 B a sample at 100 Hz."""
SEGMENT_S = 600.0
"""A segment ends with the first batch after it.  Until then Rerun keeps 2 kB of each chunk: 25 MB/h at
1 kHz."""
QUEUE_BYTES = 64 << 20
FLUSH_S = 60.0
"""A flush that takes longer means that the disk is full, which Rerun does not always report."""


class ViewRecorder:
    """Writes view items to ``view.rrd``, ``view.0001.rrd``, ...; never makes the caller wait.

    The wire recording is the truth; when the disk cannot follow, this one loses the oldest items, counted
    in `dropped`.  All segments together open as one recording; the first carries the arrangement, every one
    its own footer, names, styles and latest states.  A segment that was cut short by a crash opens as well.

    `path` is the first segment, in the folder of a new session; the others stand beside it.  `on_error` is
    called with `error` once, from the thread that writes.
    """

    def __init__(
        self,
        path: Path,
        setup: ViewSetup,
        on_error: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._path = path
        self._opened_s = -math.inf
        self._rec = rr.RecordingStream(APPLICATION, recording_id=setup.recording_id)
        self._logger = StreamLogger(self._rec, setup, live=False)
        self._queue = DropOldestQueue(QUEUE_BYTES)
        # Queue an item, and begin to write what is left; both return at once.
        self.publish, self.end = self._queue.put, self._queue.close
        self._refused = 0
        self._is_stuck = False
        self.error = ""  # why nothing is written any more (disk full, ...); empty while all is well
        self._on_error = on_error
        # The segments so far, in order; the last one is being written until `close`.
        self.files: list[Path] = []
        self._open_segment()
        self._thread = threading.Thread(target=self._run, name=RECORDER, daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Samples and events that are missing because the disk could not follow, or not take them at all."""
        return self._queue.dropped + self._refused

    def close(self, timeout_s: float = 10.0) -> None:
        """Write what is left and finish the file."""
        self.end()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        closing = False
        while not closing:
            closing = self._queue.closed.is_set()
            items = merge(self._queue.take(BATCH_S, BATCH_S))
            if self.error:
                self._refused += sum(item.rows for item in items)
            elif items:
                self._do(partial(self._write, items))
            trim_heap()
        if not self.error:
            self._do(self._logger.finish)
        if self._is_stuck:
            # After a failed write, whatever ends a stream of Rerun may wait for ever, so it is never ended.
            rr.unregister_shutdown()
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._rec))
        else:
            self._rec.disconnect()

    def _write(self, items: list[ViewItem]) -> None:
        if time.monotonic() - self._opened_s > SEGMENT_S:
            self._logger.end_file()
            self._open_segment()
        self._logger.log(items)

    def _do(self, write: Callable[[], None]) -> None:
        """Write and flush: Rerun reports what the disk did not take in its log only, or when flushed."""
        flush = partial(self._rec.flush, timeout_sec=FLUSH_S)
        for step in (write, flush):
            try:
                step()
            except Exception as error:  # noqa: BLE001 - what a plug-in shows may be anything
                self._is_stuck = step is flush
                self.error = f"{self.files[-1]} cannot be written any more: {error}"
        if self.error:
            self._on_error(self.error)

    def _open_segment(self) -> None:
        count = len(self.files)
        path = self._path if count == 0 else self._path.with_suffix(f".{count:04d}{self._path.suffix}")
        self._rec.set_sinks(rr.FileSink(path))
        self.files.append(path)
        self._opened_s = time.monotonic()
        self._logger.begin()
