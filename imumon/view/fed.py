"""A process that is supplied with items through a bounded queue, kept alive, and can do no harm.

The measuring process puts items in and goes on (`FedProcess`); the process that takes them (`serve`) may
hang, be killed or die, and is started again.
"""

import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, Self

import psutil

from imumon.errors import ImumonError
from imumon.heap import prepare_heap, trim_heap

from .items import DropOldestQueue, ViewItem, merge
from .viewer import quiet_environment

BATCH_S = 0.05
"""Batches are sent as they come, and so far apart: what comes faster, as in a replay, is joined."""
PROTOCOL = 5
"""Of pickle, which writes arrays as they are from here on."""
QUEUE_BYTES = 32 << 20
BACKOFF_S = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""A process that ended is started again after the first, the next time after the second, and so on."""
STUCK_S = 30.0
"""A process that does not take a frame in this time is killed and started again.  (A server whose browser
hangs stalls for 16 s and then goes on.)"""
LOOK_S = 0.5
"""How often it is looked whether it does."""
GOODBYE_S = 4.0
TRIM_S = 30.0
SWITCH_S = 0.0005
"""While one thread is busy, another waits so long for the interpreter at each of ten steps (usual: 5 ms)."""
MAX_BYTES = 1024 << 20
"""More memory (a viewer that takes nothing for half an hour) ends the process; it is started anew."""


class FedProcess:
    """Feeds a process that runs a `module`, which calls `serve`, with batches so far apart.

    Nothing there delays the caller.
    """

    def __init__(self, module: str, apart_s: float = BATCH_S) -> None:
        self._module, self._apart_s = module, apart_s
        self._queue = DropOldestQueue(QUEUE_BYTES)
        self._sending_s = math.inf  # since when
        self.restarts = 0  # how often the process was started again
        self._process: subprocess.Popen[bytes] | None = None
        self._supervisor = threading.Thread(target=self._supervise, name=f"feeds {module}", daemon=True)

    def _first(self) -> object:
        """Return the first message to a process that starts."""
        raise NotImplementedError

    def _handed(self, items: Sequence[ViewItem]) -> None:
        """Note what left the queue for the process."""

    def _received(self, message: Any) -> None:
        """Take a message of the process."""

    def _gone(self) -> None:
        """Note that the process has ended, and was read to its end."""

    @property
    def dropped(self) -> int:
        """Samples and events that the queue was full for."""
        return self._queue.dropped

    def start(self) -> Self:
        """Start the process and return at once."""
        self._supervisor.start()
        return self

    def publish(self, item: ViewItem) -> None:
        """Queue an item; takes microseconds, whatever state the process is in."""
        self._queue.put(item)

    def close(self, timeout_s: float = 1.5) -> None:
        """Send what is left and end the process, within `timeout_s` whatever its state.

        The servers of the web viewer end with it.  A native window stays open, so that one can go on looking.
        """
        self._queue.close()
        self._supervisor.join(max(0.0, timeout_s - 0.3))
        if self._process is not None and self._process.poll() is None:
            _kill(self._process)
        self._supervisor.join(0.3)

    def _supervise(self) -> None:
        """Keep a process alive and supplied until closed."""
        while True:
            self._run_process()
            if self._queue.closed.wait(BACKOFF_S[min(self.restarts, len(BACKOFF_S) - 1)]):
                return
            self.restarts += 1

    def _run_process(self) -> None:
        stdin, to_process = Pipe(duplex=False)
        from_process, stdout = Pipe(duplex=False)
        with stdin, stdout:
            process = subprocess.Popen(
                [sys.executable, "-m", self._module],
                stdin=stdin.fileno(),
                stdout=stdout.fileno(),
                stderr=subprocess.DEVNULL,
                env=quiet_environment(),
                start_new_session=True,  # Ctrl-C is for the measuring process, which then closes this one
            )
        self._process = process
        listener = threading.Thread(target=self._listen, args=[from_process, process], daemon=True)
        listener.start()
        try:
            with to_process:
                self._feed(process, to_process)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GOODBYE_S)
        finally:
            _kill(process)
            process.wait()
            listener.join()
            from_process.close()
        self._gone()

    def _feed(self, process: subprocess.Popen[bytes], pipe: Connection) -> None:
        """Send items until the process is gone or everything is sent and the queue closed."""
        closing = False
        with contextlib.suppress(OSError):  # it is gone, maybe since it was killed for taking nothing
            self._send(pipe, self._first())
            while not closing and process.poll() is None:
                closing = self._queue.closed.is_set()
                items = merge(self._queue.take(self._apart_s, wait_s=0.25))
                self._handed(items)
                if items:
                    self._send(pipe, items)

    def _send(self, pipe: Connection, frame: object) -> None:
        try:
            self._sending_s = time.monotonic()
            pipe.send_bytes(pickle.dumps(frame, PROTOCOL))
        finally:
            self._sending_s = math.inf

    def _listen(self, messages: Connection, process: subprocess.Popen[bytes]) -> None:
        """Take messages of the process until it ends; kill it when it does not take a frame."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                if messages.poll(LOOK_S):
                    self._received(messages.recv())
                elif time.monotonic() - self._sending_s > STUCK_S:
                    _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the process and what it started for itself; a native viewer has a session of its own."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def serve(run: Callable[[Connection, Connection], None], problem: Callable[[ImumonError], object]) -> None:
    """Run what a `FedProcess` feeds, given where frames come from and where messages go; does not return.

    An `ImumonError` is sent as the message that `problem` makes of it.  The process leaves without the
    clean-up of libraries: Rerun's waits for a stuck viewer without end.
    """
    prepare_heap()
    sys.setswitchinterval(SWITCH_S)
    threading.Thread(target=watch, args=(os.getppid(),), daemon=True).start()
    stream = Connection(os.dup(sys.stdin.fileno()), writable=False)
    out = Connection(os.dup(sys.stdout.fileno()), readable=False)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # a library that prints must not disturb the frames
    code = 1
    try:
        run(stream, out)
        code = 0
    except ImumonError as error:
        out.send(problem(error))
    finally:
        os._exit(code)


def batches(stream: Connection, wait_s: float) -> Iterator[list[Any]]:
    """Yield items as they come, and none after `wait_s` without any, until the stream ends."""
    with contextlib.suppress(EOFError):
        while True:
            yield stream.recv() if stream.poll(wait_s) else []


def watch(parent: int) -> None:
    """End the process when the measuring process is gone or the memory grows too far, whatever blocks."""
    process, trimmed_s = psutil.Process(), time.monotonic()
    while os.getppid() == parent and process.memory_info().rss < MAX_BYTES:
        time.sleep(1.0)
        if time.monotonic() - trimmed_s > TRIM_S:
            trim_heap()
            trimmed_s = time.monotonic()
    if os.getpgrp() == os.getpid():  # with what was started for this process alone
        os.killpg(os.getpid(), signal.SIGKILL)
    os._exit(1)
