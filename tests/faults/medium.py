"""What it costs that the medium has what is recorded: how long it takes, and how late the bytes get."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from imumon.recordings.recorder import FLUSH_PERIOD_S, Recorder
from imumon.recordings.wire import WireWriter
from imumon.transport.reader import Bytes
from tests.faults.killed import WAITS, Machine
from tests.faults.rows import Row

PROMISED_S = 1.0
PACKET = 41


class Watched(WireWriter):
    """A writer that notes how long the medium takes, and how long bytes wait for it."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, {})
        self.took_s: list[float] = []
        self.waited_s: list[float] = []
        """From the begin of the sync before to the end of this one: what came meanwhile is in doubt."""
        self._began = time.monotonic()

    def sync(self) -> None:
        """Wait for the medium, and note it."""
        began = time.monotonic()
        super().sync()
        now = time.monotonic()
        self.took_s.append(now - began)
        self.waited_s.append(now - self._began)
        self._began = began  # what comes while it waits is for the next


def measure(folder: Path, rate_hz: float, seconds: float) -> Row:
    """Record at this rate, and measure."""
    writer = Watched(folder / f"{rate_hz:g}.mcap")
    recorder = Recorder(writer, lambda _: None, lambda: None)
    with Machine() as machine:
        recorder.start()
        start, data, sent = time.monotonic(), bytes(PACKET), 0
        cpu = time.process_time()
        while (now := time.monotonic() - start) < seconds:
            for _ in range(int(now * rate_hz) - sent):
                recorder.put(Bytes(data, time.time_ns()))
                sent += 1
            time.sleep(0.005)
        cpu = time.process_time() - cpu
        recorder.stop()
    took, latest = np.array(writer.took_s), max(writer.waited_s) + FLUSH_PERIOD_S
    return Row(
        f"power cut while {rate_hz:g} reads/s of {PACKET} bytes are recorded",
        len(took),
        f"a sync takes {1e3 * np.median(took):.1f} ms, at most {1e3 * took.max():.0f} ms;"
        f" a read is on the medium after {latest:.2f} s at most; {100 * cpu / seconds:.1f} % of a processor",
        held=latest <= PROMISED_S + WAITS * machine.late_s,
    )
