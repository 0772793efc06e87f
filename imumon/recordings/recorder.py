"""The recorder: gets what is read to the system within 0.2 s, and to the medium within 1 s."""

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import SimpleQueue

from imumon.errors import ImumonError
from imumon.transport.reader import Item

from .wire import WireCounters, WireWriter

FLUSH_PERIOD_S = 0.05
"""A quarter of what is promised: the import of a library can keep the interpreter for 0.1 s, and a wake-up is
late by that; a flush takes some 10 µs."""
SYNC_PERIOD_S = 0.3
"""A third of what is promised, 1 s; how long the medium takes comes on top, 0.3 s once on a busy disk."""
SAVE_PERIOD_S = 5.0
STOP_TIMEOUT_S = 10.0
"""How long `Recorder.stop` waits for a disk that does not answer."""


class Recorder:
    """Writes a wire file from a queue, in a thread of its own, and never stops because of the disk.

    What may take long, waiting for the medium and writing the metadata, is done by a second thread.

    While the disk is full or fails, items are kept up to a limit and then counted (`WireCounters`); the
    recording goes on as soon as writing works again.  Where its folder has vanished it goes on in a new one.

    `writer`: used by the recorder alone from `start` to the return of `stop`, which closes it.
    `on_problem`: called from the recorder's threads with one sentence when writing begins to fail, and with
        None when all works again.
    `save`: called from the second thread every 5 s, to write the session's metadata; an error from it is
        a problem like any other.
    """

    def __init__(
        self, writer: WireWriter, on_problem: Callable[[str | None], None], save: Callable[[], None]
    ) -> None:
        self._writer = writer
        self._on_problem = on_problem
        self._save = save
        self._items: SimpleQueue[Item] = SimpleQueue()
        self.put = self._items.put
        """Takes an item and returns at once: a sink for `imumon.transport.reader.Reader`."""
        self._problems: dict[str, str] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._next_save = 0.0
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._keeper = threading.Thread(target=self._keep, name="recorder, medium", daemon=True)

    @property
    def problem(self) -> str | None:
        """Why writing fails at present, or None."""
        return next(iter(self._problems.values()), None)

    def start(self) -> None:
        """Start the threads."""
        self._thread.start()
        self._keeper.start()

    def stop(self) -> WireCounters:
        """Write what was put, close the file, and return the counters.

        A disk that does not answer is waited for 10 s; then the thread is left, and `problem` reports it.
        """
        self._stopping.set()
        deadline = time.monotonic() + STOP_TIMEOUT_S
        for thread in (self._thread, self._keeper):
            thread.join(max(0.0, deadline - time.monotonic()))
        if self._thread.is_alive():
            text = f"the disk did not answer for {STOP_TIMEOUT_S:.0f} s; the recording was not closed"
            self._report(_WRITING, text)
        return self._writer.counters

    def _run(self) -> None:
        stopped = False
        while not stopped:
            # Slept through: to be woken by each read costs more than it.
            stopped = self._stopping.wait(FLUSH_PERIOD_S)
            for _ in range(self._items.qsize()):
                self._writer.write(self._items.get_nowait())
            self._try(self._writer.flush, _WRITING)
            gone = self._writer.has_vanished
            self._report(_GONE, f"{_GONE}: what it held is lost; a new file is begun" if gone else None)
            if gone:  # tried again until it works
                with suppress(OSError, ImumonError):
                    self._writer = self._writer.begun_again()
                    self._next_save = 0.0
        self._try(self._writer.close, "the recording could not be finished")

    def _keep(self) -> None:
        """Let the medium have what was written, and renew the metadata; either may take seconds."""
        self._next_save = time.monotonic() + SAVE_PERIOD_S
        while not self._stopping.wait(SYNC_PERIOD_S):
            self._try(self._writer.sync, "the disk does not keep the recording")
            if time.monotonic() >= self._next_save:
                self._next_save = time.monotonic() + SAVE_PERIOD_S
                self._try(self._save, "the session's metadata cannot be written")

    def _try(self, action: Callable[[], None], what: str) -> None:
        try:
            action()
        except Exception as error:  # noqa: BLE001 - whatever it is, both threads go on
            reason = getattr(error, "strerror", None) or str(error) or repr(error)
            self._report(what, f"{what}: {reason}")
        else:
            self._report(what, None)

    def _report(self, what: str, problem: str | None) -> None:
        """Note how one kind of work goes, and report when it begins to fail, or all works again."""
        with self._lock:
            before = self._problems.pop(what, None)
            if problem is not None:
                self._problems[what] = problem
            if problem != before and (problem is not None or not self._problems):
                self._on_problem(problem)


_WRITING = "the recording cannot be written"
_GONE = "the file of the recording has vanished from its folder"
